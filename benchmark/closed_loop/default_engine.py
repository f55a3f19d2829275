"""The `default` engine as a ride: a scene of any split, driven after a second of priming to its end.

The part of a drive in which the ego is still the recorded one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.adversary import ADVERSARY, AdversaryMaker, AdversaryTrack, DrivesAdversary
from benchmark.closed_loop.contract import AgentPolicy
from benchmark.closed_loop.courses import course_of, recorded_ego, replay_of
from benchmark.closed_loop.following import INSTANTS, SUBSTEP_US, Ego
from benchmark.closed_loop.idm import Idm
from benchmark.closed_loop.riding import (
    Motion,
    RecordedCan,
    Ride,
    RideMaker,
    Touch,
    UndrivablePlanError,
    require_room,
)
from benchmark.closed_loop.scoring import Blame
from benchmark.closed_loop.stepping import UndrivablePlanError as UndrivableWaypointsError
from benchmark.closed_loop.stepping import begin, drivable, goes_on, step_together
from benchmark.closed_loop.world import Course, Trace, World
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.last_made import LastMade
from benchmark.pdm.motion import headed
from benchmark.planning import Plan
from benchmark.records.drive_schema import NeuroncapScore, UntilName
from benchmark.scene import Scene


def recorded_motion(scene: Scene, first: int, last: int) -> Motion:
    """Recorded frames from the first to the last as motion; the last one, a keyframe, is a planning instant."""
    frames = slice(first, last + 1)
    times = scene.timestamps_us[frames]
    ego = np.array([ego_columns(recorded_ego(scene, time)) for time in times.tolist()])
    agents = scene.agents
    tick: NDArray[np.int64] = np.array([last - first])
    return Motion(times, ego, agents.position[:, frames], agents.yaw[:, frames], agents.valid[:, frames], tick)


def ego_columns(ego: Ego) -> Floats:
    """(7,) an ego of the default engine in the columns of a motion."""
    return np.array([ego.x, ego.y, ego.yaw, ego.speed, ego.acceleration, ego.yaw_rate, ego.steering])


PRIMING_STEPS: Final = 2
"""Steps in which the ego is the recorded one, so that a planner with a memory has one (NeuroNCAP primes as long)."""


_REPLAYED: Final = "movable_object.debris"


def _replay(scene: Scene, start_us: int, end_us: int) -> AgentPolicy[Any]:
    return replay_of(scene, start_us, end_us)


def _idm(scene: Scene, start_us: int, end_us: int) -> AgentPolicy[Any]:
    return Idm.of(replay_of(scene, start_us, end_us), scene.agents.categories, scene.road_map)


def _policy(scene: Scene, agents: str, start_us: int, end_us: int, adversary: int | None = None) -> AgentPolicy[Any]:
    return POLICIES[agents](scene if adversary is None else _that_replays(scene, adversary), start_us, end_us)


def _that_replays(scene: Scene, agent: int) -> Scene:
    """The scene with a vehicle that no policy drives: until its hand-over an adversary does what its track says."""
    names = list(scene.agents.categories)
    names[agent] = _REPLAYED
    return replace(scene, agents=replace(scene.agents, categories=tuple(names)))


_policy_of: Final = LastMade[Scene, AgentPolicy[Any]](_policy, kept=4)
"""Policies are values: drives of one scene share one."""
POLICIES: Final[dict[str, Callable[[Scene, int, int], AgentPolicy[Any]]]] = {"replay": _replay, "idm": _idm}
"""How the others behave, by the name that ``--agents`` takes; an adversary is among one of them."""
AGENTS: Final = (*POLICIES, ADVERSARY)


@dataclass(frozen=True, slots=True)
class DefaultRides:
    """Maker of rides of the default engine.

    A plan takes effect ``latency_us`` later than it was made for; the adversary is only put among the agents where
    their policy is `ADVERSARY`; a drive ends at any contact, or at one that is the ego's fault.
    """

    agents: str = "replay"
    latency_us: int = 0
    adversary: AdversaryMaker | None = None
    until: UntilName = "contact"

    @property
    def draws(self) -> bool:
        """An adversary draws, no other agent does."""
        return self.agents == ADVERSARY

    def families(self, read: Callable[[], tuple[Scene, RecordedCan]]) -> tuple[str, ...]:
        """A scene is driven as it is; not at all where no vehicle in it can become the adversary."""
        return ("",) if self.adversary is None or self.adversary.possible(read()[0]) else ()

    def after_together(self, rides: Sequence[Ride], plans: Sequence[Plan]) -> list[Ride | UndrivablePlanError]:
        """Half a second of several rides; those past priming are stepped together."""
        return [*_after_together([cast(DefaultRide, ride) for ride in rides], plans)]

    def begin(self, scene: Scene, run: int, can: RecordedCan, family: str = "") -> "DefaultRide":
        """The ride at its first planning instant.

        Raises:
            InputError: If the scene is too short, or there is no such policy or latency.
        """
        course = self.course(scene, run)
        first = int(scene.keyframes[0])
        return DefaultRide(scene, course, begin(course), recorded_motion(scene, first, first))

    def course(self, scene: Scene, run: int) -> Course:
        """The course of a run; raises `InputError` as `begin` does."""
        require_room(scene, PRIMING_STEPS + 2)
        if self.agents not in AGENTS:
            raise InputError(f"there are no agents {self.agents!r}; there are {', '.join(AGENTS)}")
        start_us, end_us = (int(scene.timestamps_us[scene.keyframes[at]]) for at in (PRIMING_STEPS, -1))
        return course_of(
            scene,
            policy=self._agents(scene, run, start_us, end_us),
            keyframe=PRIMING_STEPS,
            seed=run,
            latency_us=self.latency_us,
            blamed=Blame(scene) if self.until == "fault" else None,
        )

    def _agents(self, scene: Scene, run: int, start_us: int, end_us: int) -> AgentPolicy[Any]:
        if self.agents != ADVERSARY:
            return _policy_of(scene, self.agents, start_us, end_us)
        if self.adversary is None:
            raise InputError(
                "nobody says who the adversary is; drive with --agents adversary, or with its stored tracks"
            )
        others = self.adversary.others
        return self.adversary.policy(
            scene, run, start_us, lambda agent: _policy_of(scene, others, start_us, end_us, agent)
        )


@dataclass(frozen=True, slots=True)
class DefaultRide:
    """Ride of the default engine: see `benchmark.closed_loop.riding.Ride`.

    ``world`` is that where driving starts, then now; ``motion`` is everything so far.
    """

    scene: Scene
    course: Course
    world: World
    motion: Motion

    @property
    def start(self) -> int:
        """Keyframe of the first planning instant."""
        return 0

    @property
    def primed(self) -> int:
        """Planning instants at which the ego is the recorded one."""
        return PRIMING_STEPS + 1

    @property
    def goes_on(self) -> bool:
        """Whether a plan is wanted."""
        return goes_on(self.course, self.world)

    @property
    def command(self) -> None:
        """By the route, as data sets have it."""
        return

    @property
    def can(self) -> None:
        """No row of its own."""
        return

    @property
    def touch(self) -> Touch | None:
        """The contact that ends it."""
        return self.world.contact

    @property
    def passed(self) -> tuple[Touch, ...]:
        """Contacts before it that do not."""
        return self.world.passed

    @property
    def adversary(self) -> AdversaryTrack | None:
        """Where an adversary went, if there is one."""
        policy = self.course.policy
        return policy.adversary(self.world.memory) if isinstance(policy, DrivesAdversary) else None

    def after(self, plan: Plan) -> "DefaultRide":
        """Half a second later; raises `UndrivablePlanError`."""
        (advanced,) = _after_together([self], [plan])
        if isinstance(advanced, UndrivablePlanError):
            raise advanced
        return advanced

    def primed_on(self) -> "DefaultRide | None":
        """Half a second later where that is still recorded; whatever was planned for it."""
        ticks = len(self.motion.ticks)
        if ticks > PRIMING_STEPS:
            return None
        frames = self.scene.keyframes
        later = recorded_motion(self.scene, int(frames[ticks - 1]) + 1, int(frames[ticks]))
        return replace(self, motion=self.motion.then(later))

    def arrived(self, world: World) -> "DefaultRide":
        """In the world half a second later."""
        assert world.trace is not None
        return replace(self, world=world, motion=self.motion.then(self._traced(self.world.time_us, world.trace)))

    def finished(self) -> "DefaultRide":
        """The same: every instant has been checked."""
        return self

    def neuroncap_score(self) -> NeuroncapScore | None:
        """None: NNS is NeuroNCAP's."""
        return None

    def _traced(self, before_us: int, trace: Trace) -> Motion:
        """The sub-steps of a step."""
        rows = slice(INSTANTS - 1, None, INSTANTS)
        boxes = trace.boxes[rows].transpose(1, 0, 2)
        times = before_us + SUBSTEP_US * np.arange(1, boxes.shape[1] + 1)
        frames = np.clip(np.searchsorted(self.scene.timestamps_us, times), 0, len(self.scene.timestamps_us) - 1)
        heights = self.scene.agents.position[:, frames, 2:]
        ego = np.array([ego_columns(Ego.of_row(row)) for row in trace.egos[INSTANTS::INSTANTS]])
        return Motion(
            times_us=times,
            ego=ego,
            position=np.concatenate([boxes[..., :2], heights], axis=-1),
            yaw=boxes[..., 4],
            present=trace.present[rows].T,
            ticks=np.array([len(times) - 1]),
        )


def _after_together(rides: "Sequence[DefaultRide]", plans: Sequence[Plan]) -> "list[DefaultRide | UndrivablePlanError]":
    """Each half a second later, or why its plan cannot be driven."""
    later: dict[int, DefaultRide | UndrivablePlanError] = {}
    driving: dict[int, Floats] = {}
    for place, (ride, plan) in enumerate(zip(rides, plans, strict=True)):
        primed = ride.primed_on()
        if primed is not None:
            later[place] = primed
            continue
        try:
            waypoints = rear_axle_waypoints(plan, float(ride.scene.lidar.translation[0]))
            driving[place] = drivable(ride.course, waypoints)
        except UndrivableWaypointsError as error:
            later[place] = UndrivablePlanError(str(error))
    moving = [rides[place] for place in driving]
    worlds = step_together([ride.course for ride in moving], [ride.world for ride in moving], [*driving.values()])
    later |= {place: ride.arrived(world) for place, ride, world in zip(driving, moving, worlds, strict=True)}
    return [later[place] for place in range(len(rides))]


def rear_axle_waypoints(plan: Plan, lidar_ahead_m: float) -> Floats:
    """(6, 2) a plan's first 3 s as positions of the rear axle, x forward, y left, metres."""
    return np.asarray(headed(plan, lidar_ahead_m)[:, :2])


def agents_facts(maker: RideMaker) -> dict[str, Any]:
    """What the agents of an engine depend on besides the name of their policy."""
    adversary = maker.adversary if isinstance(maker, DefaultRides) else None
    return {} if adversary is None else dict(adversary.facts)


def until_of(maker: RideMaker) -> UntilName:
    """What ends rides before their time; runs of other engines end at any contact."""
    return maker.until if isinstance(maker, DefaultRides) else "contact"
