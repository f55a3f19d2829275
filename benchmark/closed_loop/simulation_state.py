"""Interface shared by all engines: the motion so far, a contact, and the simulation state as one Protocol."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.adversary import AdversaryTrack
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.interactions.contacts import ContactPairs, is_agent_category
from benchmark.planning import Command, EgoState, Plan
from benchmark.records.drive_schema import NeuroncapScore
from benchmark.scene import Scene

SUBSTEP_S: Final = 0.1
"""Between the instants of a motion that was driven."""
SUBSTEPS: Final = 5
"""Instants in a tick."""
TICK_US: Final = 500_000
GRAVITY: Final = 9.81
"""In the accelerations of a CAN bus at rest, upwards."""
X, Y, YAW, SPEED, ACCELERATION, YAW_RATE, STEERING = range(7)
"""Columns of the ego in a motion: rear axle, global; m/s, m/s^2 and rad/s along and about the body; road wheels."""
EGO_COLUMNS: Final = 7


@dataclass(frozen=True, slots=True)
class EpisodeMotion:
    """All that has happened since the first planning instant; nothing later. F instants, N agents.

    Attributes:
        times_us: (F,) microseconds; 0.1 s apart where the ego drives, those of the recording where it is primed.
        ego: (F, 7) x, y, yaw, speed, acceleration, yaw rate and angle of the road wheels.
        position: (N, F, 3) box centres of the scene's agents, in its order; where one is not there, any finite values.
        yaw: (N, F) radians.
        present: (N, F) which agents are there.
        ticks: (K,) planning instants among the F.
    """

    times_us: NDArray[np.int64]
    ego: Floats
    position: Floats
    yaw: Floats
    present: Bools
    ticks: NDArray[np.int64]

    @property
    def seconds(self) -> Floats:
        """(F,) since the first instant."""
        return np.asarray((self.times_us - self.times_us[0]) * 1e-6)

    def boxes(self, size: Floats) -> Floats:
        """(N, F, 5) boxes of agents with (N, 3) sizes."""
        sizes = np.broadcast_to(size[:, None, :2], (*self.yaw.shape, 2))
        return np.concatenate([self.position[..., :2], sizes, self.yaw[..., None]], axis=-1)

    def at(self, time_us: int) -> Floats:
        """(7,) the ego at a time between two instants, or at one: linear, headings by the shortest turn."""
        after = int(np.clip(np.searchsorted(self.times_us, time_us), 1, max(len(self.times_us) - 1, 1)))
        if len(self.times_us) == 1:
            return np.array(self.ego[0])
        first, second = self.ego[after - 1], self.ego[after]
        share = (time_us - int(self.times_us[after - 1])) / int(self.times_us[after] - self.times_us[after - 1])
        step = second - first
        step[YAW] = wrap_angle(step[YAW])
        return np.asarray(first + np.clip(share, 0.0, 1.0) * step)

    def then(self, later: "EpisodeMotion") -> Self:
        """The motion gone on with: the ticks of ``later`` are counted from its own first instant."""
        return replace(
            self,
            times_us=np.concatenate([self.times_us, later.times_us]),
            ego=np.concatenate([self.ego, later.ego]),
            position=np.concatenate([self.position, later.position], axis=1),
            yaw=np.concatenate([self.yaw, later.yaw], axis=1),
            present=np.concatenate([self.present, later.present], axis=1),
            ticks=np.concatenate([self.ticks, later.ticks + len(self.times_us)]),
        )


@dataclass(frozen=True, slots=True)
class CollisionEvent:
    """Contact of a drive with the agent of an index; boxes are (5,), the ego's as the engine has it.

    ``ego_speed`` is along the heading, m/s; ``other_velocity`` (2,) m/s.
    """

    agent: int
    uuid: str
    category: str
    time_us: int
    ego: Floats
    ego_speed: float
    other: Floats
    other_velocity: Floats

    @property
    def pair(self) -> ContactPairs:
        """As `benchmark.interactions.contacts` judges it: kind, blame, impact speed, change of velocity."""
        return ContactPairs(
            ego=self.ego[None],
            ego_speed=np.array([self.ego_speed]),
            other=self.other[None],
            other_velocity=self.other_velocity[None],
            is_agent=np.array([is_agent_category(self.category)]),
        )


class RejectedPlanError(ValueError):
    """A plan that an engine cannot drive: the planner failed."""


class SimulationState(Protocol):
    """A drive at a planning instant: a value; `after` gives another one and changes nothing."""

    @property
    def motion(self) -> EpisodeMotion:
        """Everything so far, ending with now."""

    @property
    def start(self) -> int:
        """Keyframe of the first planning instant."""

    @property
    def primed(self) -> int:
        """Planning instants at which the ego is the recorded one; from the last of them on plans are driven."""

    @property
    def is_running(self) -> bool:
        """Whether a plan is wanted."""

    @property
    def command(self) -> Command | None:
        """The command, of engines that have a rule of their own; ``None``: as the data set's, by the route."""

    @property
    def can(self) -> Floats | None:
        """(9,) velocity, acceleration and rotation rate now, of engines that report such a row of their own."""

    @property
    def touch(self) -> CollisionEvent | None:
        """The contact that ends it, once the engine knows of it."""

    @property
    def passed(self) -> tuple[CollisionEvent, ...]:
        """Contacts before it that do not end it; none where every contact does."""

    @property
    def adversary(self) -> AdversaryTrack | None:
        """Where an adversary went, planned while the ego drove or on a stored track; ``None`` without one."""

    def after(self, plan: Plan) -> "SimulationState":
        """Half a second later.

        Args:
            plan: The planner's.

        Raises:
            UndrivablePlanError: If the engine cannot drive it; nothing is scored then.
        """

    def finished(self) -> "SimulationState":
        """The same with everything that the engine checks at the end."""

    def neuroncap_score(self) -> NeuroncapScore | None:
        """The engine's own score of a finished ride, if it has one."""


class SimulatorBackend(Protocol):
    """Begins rides of one engine, one policy of agents and one latency. Picklable."""

    @property
    def draws(self) -> bool:
        """Whether two runs of a scene can differ."""

    def families(self, read: "Callable[[], tuple[Scene, RecordedCan]]") -> tuple[str, ...]:
        """Scenarios that a scene is driven with, by family; one without a name where it is driven as it is.

        Args:
            read: Gives the scene and what its car measured; not called where that does not matter.
        """

    def advance_together(
        self, rides: Sequence[SimulationState], plans: Sequence[Plan]
    ) -> "list[SimulationState | RejectedPlanError]":
        """Half a second of several states at once: to the last bit what `advance` gives for each alone.

        Args:
            rides: R of them.
            plans: R of them.

        Returns:
            R rides, or why the engine cannot drive its plan.
        """

    def begin(self, scene: Scene, run: int, can: "RecordedCan", family: str = "") -> SimulationState:
        """The ride at its first planning instant.

        Args:
            scene: The recorded or generated scene.
            run: Index of the run, from which alone anything is drawn.
            can: What the recorded car measured at the keyframes.
            family: Which scenario.

        Raises:
            InputError: If the scene is too short to be driven.
        """


class ReplanningBackend(SimulatorBackend, Protocol):
    """An engine in which planners can be asked ten times a second."""

    def advance_replanning(
        self, ride: SimulationState, plan: Plan, replan: Callable[[SimulationState], Plan]
    ) -> SimulationState | RejectedPlanError:
        """Half a second with a plan every 0.1 s: the first, and those that ``replan`` gives at the instants between.

        While the ego is the recorded one, they are frames of the recording, and no plan is driven.
        """


@dataclass(frozen=True, slots=True)
class RecordedCan:
    """Measurements of the recorded car at its K keyframes; derived from poses where it measured nothing.

    Attributes:
        motion: (K, 9) velocity, acceleration, rotation rate, x, y and z each.
        steering_wheel_rad: (K,) radians; 0 where it was not measured.
        measured: Whether there is a CAN bus.
        root: Of the data set, where NeuroNCAP's engine finds the messages that it reads.
    """

    motion: Floats
    steering_wheel_rad: Floats
    measured: bool
    root: Path | None = None

    @classmethod
    def of(cls, states: Iterable[EgoState], root: Path | None = None) -> Self:
        """Observation metadata of a scene in a data set with a root."""
        ego_states = list(states)
        motion = np.array([build_can_row(state) for state in ego_states]).reshape(-1, 9)
        wheel = np.array([state.steering_angle or 0.0 for state in ego_states], np.float64)
        return cls(motion, wheel, all(state.source == "can_bus" for state in ego_states), root)

    def at(self, keyframes: slice) -> Self:
        """The same of some keyframes alone."""
        return type(self)(self.motion[keyframes].copy(), self.steering_wheel_rad[keyframes].copy(), self.measured)


def require_enough_keyframes(scene: Scene, ticks: int) -> None:
    """Refuse a scene with fewer keyframes than a drive of so many ticks needs to begin."""
    if len(scene.keyframes) < ticks:
        raise InputError(
            f"scene {scene.name} has {len(scene.keyframes)} keyframes, and a drive needs at least {ticks} to start; "
            "leave it out with --scenes"
        )


def build_can_row(state: EgoState) -> Floats:
    """(9,) what a car measured: velocity, acceleration, rotation rate; or its derived motion in that form."""
    if state.can_motion is not None:
        return state.can_motion
    return np.array([*state.velocity, 0.0, *state.acceleration, GRAVITY, 0.0, 0.0, state.yaw_rate])
