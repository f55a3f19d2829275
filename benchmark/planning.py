"""The contract of a planner under test: observation in, three-second plan out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Any, Literal, Protocol, TypeGuard, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FARTHEST_WAYPOINT_M, LIDAR_FROM_REAR_AXLE_M, LONGEST_PLAN_STEPS, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.scene import Camera, LidarMount, Scene
from benchmark.waypoints import waypoints_in_lidar


class Command(IntEnum):
    """Driving command, coded as in UniAD, VAD, SparseDrive and DiffusionDrive."""

    RIGHT = 0
    LEFT = 1
    STRAIGHT = 2


@dataclass(frozen=True, slots=True)
class CameraView:
    """One image that a planner may look at.

    Attributes:
        camera: Calibration.
        path: Image file.
        timestamp_us: Exposure time.
        global_T_ego: (4, 4) pose of the rear axle at the exposure: ego frame to global frame.
        load: Reads the file; returns (height, width, 3) uint8 RGB; raises `InputError` if it is missing or broken.
    """

    camera: Camera
    path: Path
    timestamp_us: int
    global_T_ego: Floats
    load: Callable[[], NDArray[np.uint8]]


class NoViews(dict[str, CameraView]):
    """Images of a world without cameras: none; ``looked`` says whether a planner has looked for some."""

    looked: bool = False


def _note_look(name: str) -> Callable[..., Any]:
    def looking(self: NoViews, *given: Any) -> Any:
        self.looked = True
        return getattr(dict, name)(self, *given)

    return looking


for _name in ("__getitem__", "__iter__", "__len__", "__contains__", "get", "items", "keys", "values"):
    setattr(NoViews, _name, _note_look(_name))


@dataclass(frozen=True, slots=True)
class EgoState:
    """Ego motion at the sample, in the ego frame (x forward, y left).

    Attributes:
        pose: (3,) planar x, y, yaw of the rear axle, global.
        position: (3,) rear axle, global, metres.
        rotation: (4,) quaternion, global.
        velocity: (2,) m/s.
        acceleration: (2,) m/s^2.
        yaw_rate: rad/s.
        steering_angle: Steering wheel angle in radians, or ``None`` where nothing measures it.
        source: Whether the motion was measured (CAN bus) or derived from past poses.
        can_motion: (9,) velocity, acceleration and rotation rate (x, y, z each) as the CAN bus has them, or ``None``
            where it has none. Networks that were trained on the raw message want it; others want the fields above. At
            the start of a scene whose messages begin milliseconds later it is the first message, as in training.
        can_motion_after: The same of the first message after the sample, of the last one where none comes after, some
            20 ms of the future: the code of published UniAD and VAD runs reads it by a slip. Only planners that say
            ``reads_message_after`` are given it.
    """

    pose: Floats
    position: Floats
    rotation: Floats
    velocity: Floats
    acceleration: Floats
    yaw_rate: float
    steering_angle: float | None
    source: Literal["can_bus", "derived"]
    can_motion: Floats | None = None
    can_motion_after: Floats | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """Input of a planner at one sample; nothing of the future but the command.

    Attributes:
        scene: Scene name.
        sample_token: Sample token.
        index: Number of the sample in its scene, from 0.
        timestamp_us: Keyframe time.
        views: Images by camera name; empty where the data set has none.
        lidar: Where LIDAR_TOP sits; `Plan` has a frame of that name.
        ego: Ego motion now.
        past_poses: (H, 3) planar rear-axle poses at the last H keyframes, oldest first, ending with now; global.
        past_valid: (H,) False before the scene began.
        command: Where the route goes.
    """

    scene: str
    sample_token: str
    index: int
    timestamp_us: int
    views: dict[str, CameraView]
    lidar: LidarMount
    ego: EgoState
    past_poses: Floats
    past_valid: Bools
    command: Command


class PlanFrame(StrEnum):
    """Frame of a plan.

    ``lidar``: x right, y forward, positions of the lidar origin (the convention of the four models and their
    metrics). ``ego``: x forward, y left, positions of the rear axle.
    """

    LIDAR = "lidar"
    EGO = "ego"


@dataclass(frozen=True, slots=True)
class Forecasts:
    """A planner's own expectation of the others, in the frame of its plan.

    Attributes:
        boxes: (A, 5) present boxes x, y, length, width, yaw.
        trajectories: (A, M, 6, 2) box centres at the plan's steps, M modes.
        scores: (A, M) mode probabilities.
    """

    boxes: Floats
    trajectories: Floats
    scores: Floats


@dataclass(frozen=True, slots=True)
class Plan:
    """Where a planner wants to be.

    Attributes:
        waypoints: (N, 2) metres at 0.5 s steps, 6 (3 s) to 16 (8 s) of them, in ``frame`` at the sample's time.
        frame: See `PlanFrame`; its value, ``"ego"`` or ``"lidar"``, will do.
        modes: (M, 6, 2) or (M, N, 2) all alternatives, or ``None``.
        mode_scores: (M,) their scores, or ``None``.
        forecasts: Expected motion of others, or ``None``.

    Raises:
        InputError: If the waypoints are not (6 to 16, 2) finite numbers within 10 km, or there is no such frame.
    """

    waypoints: Floats
    frame: PlanFrame
    modes: Floats | None = None
    mode_scores: Floats | None = None
    forecasts: Forecasts | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.frame, PlanFrame):
            object.__setattr__(self, "frame", _find_frame(self.frame))
        shape = self.waypoints.shape
        if len(shape) != 2 or shape[1] != 2 or not PLAN_STEPS <= shape[0] <= LONGEST_PLAN_STEPS:
            raise InputError(
                f"a plan needs {PLAN_STEPS} to {LONGEST_PLAN_STEPS} waypoints of x and y, this one has {shape}"
            )
        if not np.isfinite(self.waypoints).all():
            raise InputError("a plan's waypoints must be finite, but this plan has NaN or infinity")
        if np.abs(self.waypoints).max() > FARTHEST_WAYPOINT_M:
            raise InputError(
                f"a plan's waypoints are metres from the car, but this plan has {np.abs(self.waypoints).max():.3g} m; "
                "use coordinates relative to the car"
            )

    @property
    def judged(self) -> "Plan":
        """Its first 3 s, which protocols judge: a plan that goes on gets the verdicts of one that ends there."""
        if len(self.waypoints) == PLAN_STEPS:
            return self
        modes = None if self.modes is None else self.modes[:, :PLAN_STEPS]
        return replace(self, waypoints=self.waypoints[:PLAN_STEPS], modes=modes)

    def waypoints_in_lidar(self, lidar_ahead_m: float = LIDAR_FROM_REAR_AXLE_M) -> Floats:
        """The waypoints as positions of the lidar origin, x right, y forward: what every protocol reads.

        Args:
            lidar_ahead_m: Lidar origin ahead of the rear axle.

        Returns:
            (N, 2) metres.
        """
        return waypoints_in_lidar(self.waypoints, self.frame, lidar_ahead_m)


def _find_frame(given: object) -> PlanFrame:
    """The frame that a plan names in words."""
    if isinstance(given, str) and given in set(PlanFrame):
        return PlanFrame(given)
    said = repr(given) if isinstance(given, str) else f"a {type(given).__name__}"
    raise InputError(f"the frame of a plan is {said}; use 'ego' (x forward, y left) or 'lidar' (x right, y forward)")


@dataclass(frozen=True, slots=True)
class SceneInfo:
    """Scene information for a planner before the first sample.

    Attributes:
        name: Scene name.
        location: nuScenes location.
        cameras: Calibrated cameras.
    """

    name: str
    location: str
    cameras: tuple[Camera, ...]


class Planner(Protocol):
    """A planner under test. Stateful ones see the samples of a scene in order.

    Attributes:
        name: Shown in tables.
    """

    name: str

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""

    def plan(self, observation: Observation) -> Plan:
        """Plan the next three seconds, or up to eight.

        An exception is recorded as a failure of this sample with its traceback, never as a zero.
        """


class PlannerGoneError(InputError):
    """A planner elsewhere cannot be asked: not a failure of the planner, nothing is recorded, and the command ends."""


class PlannerAwayError(PlannerGoneError):
    """The same, but it may come back, and then the scene begins again (`RemotePlanner`)."""


class NoViewsError(InputError):
    """A planner needs images of cameras that the world, or the rig, does not have: not a failure of the planner."""


class PlannerLateError(InputError):
    """A planner elsewhere took too long; how long it may take is the machine's matter."""


class PlannerFailedError(Exception):
    """A planner in a process of its own failed, as others fail that raise.

    Attributes:
        text: The traceback there, or what happened if there is none.
        looked: Whether it had looked for images where there are none (`NoViews`).
    """

    def __init__(self, line: str, text: str, *, looked: bool = False) -> None:
        """The exception in one line, and with its traceback."""
        super().__init__(line)
        self.text = text
        self.looked = looked


class ModelFailedError(Exception):
    """A model behind a server answered no plan: it failed, and the sentence says how."""


class PlannerLostError(PlannerFailedError):
    """Its process ended or had to be ended: the sample fails, and the rest of its scene; `Planner.reset` begins anew.

    Attributes:
        late: Whether it took too long.
    """

    def __init__(self, sentence: str, *, late: bool = False) -> None:
        """Description of the failure, without anything that differs between two runs."""
        super().__init__(sentence, sentence)
        self.late = late


@runtime_checkable
class SupervisedPlanner(Protocol):
    """A planner in a process of its own, which is watched over there: no caller needs to look at the clock."""

    @property
    def pid(self) -> int | None:
        """Its process; ``None`` while there is none."""

    def seed_generators(self, seed: int) -> None:
        """Global generators of its process begin there at the next `Planner.reset`."""

    def loaded_code(self) -> dict[str, str]:
        """Result of `benchmark.runs.code_identity.hash_loaded_code` in its process."""


@runtime_checkable
class RemotePlanner(Protocol):
    """A planner elsewhere: it holds one scene at a time, and may go away half-way and come back remembering nothing."""

    def come_back(self) -> None:
        """Wait for it; raises `PlannerGoneError` if it stays away."""


@dataclass(frozen=True, slots=True)
class Ride:
    """The ego's motion in a scene up to now, and the recorded path without its times. Global frame, rear axle, metres.

    Attributes:
        times_us: (F,) of all poses that are known, the last one now.
        position: (F, 3).
        rotation: (F, 4) quaternions.
        path: (P, 3) where the recorded car went, from the beginning of the scene to its end.
        recorded_us: Until when the car is where it was recorded.
        step_us: Until the next plan is asked for.
    """

    times_us: NDArray[np.int64]
    position: Floats
    rotation: Floats
    path: Floats
    recorded_us: int
    step_us: int = 500_000


@dataclass(frozen=True, slots=True)
class AnswerNote:
    """What was peculiar in an answer that was taken all the same; ``ends_drive`` where the planner wants no more."""

    text: str = ""
    ends_drive: bool = False


@runtime_checkable
class SessionPlanner(RemotePlanner, Protocol):
    """A planner elsewhere with a session for each scene, in which poses between the samples and a route are sent."""

    def take_ride(self, ride: Ride) -> None:
        """Called before each `Planner.plan`."""

    def take_note(self) -> AnswerNote:
        """Of the last answer; it is forgotten."""

    def end_session(self) -> None:
        """The scene is over. Nothing is raised, and nothing happens without a session."""


@runtime_checkable
class ContinuousPlanner(Planner, Protocol):
    """A planner that may remember beyond a change of scene, as published runs do (docs/models.md).

    Attributes:
        memory_crosses_scenes: Whether it does. Then a split is one unit of work: all of its scenes in one order, in one
            process.
    """

    memory_crosses_scenes: bool

    def begin_run(self) -> None:
        """Forget everything: the next scene is the first one of a run. `Planner.reset` forgets less."""


def remembers_across_scenes(planner: Planner) -> TypeGuard[ContinuousPlanner]:
    """Whether a planner's plans depend on the scenes that it saw before."""
    return isinstance(planner, ContinuousPlanner) and planner.memory_crosses_scenes


def reads_message_after(planner: Planner) -> bool:
    """Whether a planner asks for `EgoState.can_motion_after`."""
    return getattr(planner, "reads_message_after", False) is True


@runtime_checkable
class PrivilegedPlanner(Protocol):
    """A baseline that sees what no car sees: all boxes, the map, or the recorded future. Tables mark it."""

    def reveal(self, scene: Scene) -> None:
        """Called after `Planner.reset` with the whole scene."""
