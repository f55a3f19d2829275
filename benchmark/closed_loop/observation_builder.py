"""Observations of a simulated world at each planning instant, field by field, and the Protocol of its cameras.

Nothing of the recording's future is in it but the command, which is the route's. Where the ego is still primed, motion
is what the recorded car measured; from then on it is what was simulated, in the form in which a data set has it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from benchmark.closed_loop.route import Route
from benchmark.closed_loop.simulation_state import (
    ACCELERATION,
    GRAVITY,
    SPEED,
    STEERING,
    YAW,
    YAW_RATE,
    EpisodeMotion,
    RecordedCan,
    X,
    Y,
)
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.machine.storage import make_token
from benchmark.planning import CameraView, Command, EgoState, NoViews, Observation
from benchmark.scene import Camera, EgoTrack, LidarMount, Scene

NO_SENSOR: Final = "none"


class SceneCameras(Protocol):
    """A sensor made ready for one scene."""

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The rig that it sees with."""

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """Current camera images.

        Args:
            driven: The world as driven; its last frame is now.

        Returns:
            Images by camera name, in memory; drawn when they are looked at.
        """


class Sensor(Protocol):
    """Cameras in a simulated world. Picklable; the same world gives the same pictures in every process."""

    @property
    def name(self) -> str:
        """Part of the name of what was measured."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """Further settings that its pictures depend on, as plain JSON values."""

    def look(self, scene: Scene) -> SceneCameras:
        """Make ready for a scene."""


@runtime_checkable
class RemoteSensor(Protocol):
    """A sensor elsewhere: it shows one scene at a time, to one process."""

    def require_alive(self) -> None:
        """Refuse it where no server answers; raises `InputError`."""


@dataclass(frozen=True, slots=True)
class NoSensor:
    """For planners that need no images."""

    name: str = NO_SENSOR

    @property
    def facts(self) -> Mapping[str, Any]:
        """Nothing."""
        return {}

    def look(self, scene: Scene) -> "NoCameras":
        """The scene's own rig, that sees nothing."""
        return NoCameras(scene.cameras)


@dataclass(frozen=True, slots=True)
class NoCameras:
    """A rig that sees nothing."""

    cameras: tuple[Camera, ...]

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """None."""
        return NoViews()


PAST_TICKS: Final = 5
"""Ego poses that a planner is given: now and two seconds back."""
STEERING_RATIO: Final = 14.9
"""Turns of the steering wheel per turn of the road wheels (Renault Zoe)."""


@dataclass(frozen=True, slots=True)
class ObservationBuilder:
    """Maker of the observations of one drive, which holds of the recording only the past of the drive, and the route.

    ``start`` is the keyframe of the first planning instant; ``known`` and ``can`` go up to the last keyframe at which
    the ego is the recorded one.
    """

    scene: str
    lidar: LidarMount
    start: int
    known: EgoTrack
    can: RecordedCan
    route: Route

    @classmethod
    def of(cls, recorded: Scene, can: RecordedCan, start: int, primed: int) -> "ObservationBuilder":
        """The observer of a drive from a keyframe on; the ego is the recorded one at the first ``primed`` instants."""
        frames = recorded.keyframes[: start + primed]
        known = EgoTrack(recorded.ego.position[frames], recorded.ego.rotation[frames])
        return cls(recorded.name, recorded.lidar, start, known, can.at(slice(start + primed)), Route.of(recorded))

    def observation(
        self, motion: EpisodeMotion, views: dict[str, CameraView], command: Command, can: Floats | None = None
    ) -> Observation:
        """The planner's observation now; its index is that of the keyframe in the world as driven.

        Its token names no sample of the recording. ``motion`` is since the first planning instant, ``can`` the engine's
        own (9,) row of the CAN bus, if it has one.
        """
        poses = np.concatenate([self.known.pose[: self.start], motion.ego[motion.ticks, :3]])
        index = len(poses) - 1
        past = index - PAST_TICKS + 1 + np.arange(PAST_TICKS)
        return Observation(
            scene=self.scene,
            sample_token=make_token("drive", self.scene, index),
            index=index,
            timestamp_us=int(motion.times_us[-1]),
            views=views,
            lidar=self.lidar,
            ego=self.build_ego_state(motion, index, can),
            past_poses=poses[np.maximum(past, 0)],
            past_valid=past >= 0,
            command=command,
        )

    def build_ego_state(self, motion: EpisodeMotion, index: int, row: Floats | None = None) -> EgoState:
        """Motion at a keyframe: measured while the ego is the recorded one, then simulated.

        ``row`` is the engine's own (9,) row of the CAN bus, if it has one.
        """
        now, primed = motion.ego[-1], index < len(self.can.motion)
        simulated = simulate_can_row(now) if row is None else row
        can = self.can.motion[index] if primed else simulated
        wheel = float(self.can.steering_wheel_rad[index]) if primed else STEERING_RATIO * float(now[STEERING])
        here = np.array([now[X], now[Y], self.route.height(now)])
        return EgoState(
            pose=now[:3].copy(),
            position=self.known.position[index].copy() if primed else here,
            rotation=self.known.rotation[index].copy() if primed else quaternion_from_yaw(now[YAW]),
            velocity=can[0:2].copy(),
            acceleration=can[3:5].copy(),
            yaw_rate=float(can[8]),
            steering_angle=wheel,
            source="can_bus" if self.can.measured or not primed else "derived",
            can_motion=can.copy(),
            # Nothing later has been simulated, and nothing later of the recording may be visible.
            can_motion_after=can.copy(),
        )


def simulate_can_row(ego: Floats) -> Floats:
    """(9,) CAN row of a simulated car, as nuScenes' message ``pose`` has it, from (7,) columns of a motion.

    Velocity, acceleration (with gravity, and towards the inside of a bend) and rotation rate of the rear axle.
    """
    speed, rate = float(ego[SPEED]), float(ego[YAW_RATE])
    return np.array([speed, 0.0, 0.0, float(ego[ACCELERATION]), speed * rate, GRAVITY, 0.0, 0.0, rate])
