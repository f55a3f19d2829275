"""Poses and routes of AlpaSim's messages: the local frame of a session, trajectories, and the way ahead.

Frames are in ``docs/extensions/alpasim.md``. All poses are of the rig: rear axle on the ground, x forward, y left. The
wire has single precision, so positions and times count from the beginning of a scene.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.alpasim.messages import build_message
from benchmark.geometry import Floats, rotation_matrix
from benchmark.planning import Command

SECOND_US: Final = 1_000_000
_THINNED_M: Final = 0.2
ROUTE_STEP_M: Final = 80.0 / 19.0
ROUTE_POINTS: Final = 20
EXTENSION_M: Final = 1000.0
"""Of a recorded path, straight on where it ends."""
_LAST_MOTION_M: Final = 1.0
_ASIDE_M: Final = 2.0
_COMMAND_S: Final = 3.0
_COMMAND_M: Final = 10.0
_UNIT: Final = 1e-4
"""Of a quaternion's squared length, as AlpaSim has it."""


@dataclass(frozen=True, slots=True)
class Poses:
    """Rig poses: (N,) microseconds, (N, 3) metres, (N, 4) quaternions w, x, y, z."""

    times_us: NDArray[np.int64]
    position: Floats
    rotation: Floats

    def __len__(self) -> int:
        return len(self.times_us)

    def at(self, places: slice) -> "Poses":
        """Some of them."""
        return Poses(self.times_us[places], self.position[places], self.rotation[places])

    @property
    def are_unit(self) -> bool:
        """Whether every quaternion turns and does nothing else."""
        with np.errstate(over="ignore", invalid="ignore"):
            lengths = (self.rotation**2).sum(axis=1)
        return bool((np.abs(lengths - 1.0) <= _UNIT).all())


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """AlpaSim's frame of one scene: axes of the map, the origin where the car was first, a second before then as 0."""

    origin: Floats
    first_us: int

    def to_local_us(self, time_us: Any) -> Any:
        """Times in it."""
        return time_us - self.first_us + SECOND_US

    def to_local(self, poses: Poses) -> Poses:
        """Global poses in it."""
        times = self.to_local_us(poses.times_us)
        return Poses(times, poses.position - self.origin, poses.rotation)


def encode_trajectory(poses: Poses) -> Any:
    """A message ``Trajectory``."""
    rows = zip(poses.times_us.tolist(), poses.position.tolist(), poses.rotation.tolist(), strict=True)
    return build_message("Trajectory", poses=[{"timestamp_us": time, "pose": _pose(*pose)} for time, *pose in rows])


def encode_pose(position: Floats, rotation: Floats) -> Any:
    """A message ``Pose``."""
    return build_message("Pose", **_pose(position.tolist(), rotation.tolist()))


def _pose(position: Sequence[float], rotation: Sequence[float]) -> dict[str, Any]:
    return {"vec": dict(zip("xyz", position)), "quat": dict(zip("wxyz", rotation))}


def decode_trajectory(message: Any) -> Poses:
    """The poses of a ``Trajectory``; nothing is checked."""
    poses = message.poses
    times = np.array([min(pose.timestamp_us, 1 << 62) for pose in poses], np.int64)
    rows = [decode_pose(pose.pose) for pose in poses]
    position = np.array([position for position, _ in rows], np.float64).reshape(-1, 3)
    return Poses(times, position, np.array([rotation for _, rotation in rows], np.float64).reshape(-1, 4))


def decode_pose(message: Any) -> tuple[list[float], list[float]]:
    """Position and quaternion of a ``Pose``."""
    vec, quat = message.vec, message.quat
    return [vec.x, vec.y, vec.z], [quat.w, quat.x, quat.y, quat.z]


def derive_states(poses: Poses) -> tuple[Floats, Floats]:
    """(N, 3) velocities and (N, 3) rotation rates in the rig frame, each from the pose before; the first as the second.

    Zero where there is one pose alone. Rates are those of the heading.
    """
    velocity, rate = np.zeros((len(poses), 3)), np.zeros((len(poses), 3))
    if len(poses) < 2:
        return velocity, rate
    seconds = np.maximum(np.diff(poses.times_us), 1) / SECOND_US
    turned = rotation_matrix(poses.rotation)
    moved = np.diff(poses.position, axis=0) / seconds[:, None]
    velocity[1:] = np.einsum("nji,nj->ni", turned[1:], moved)
    yaw = np.unwrap(np.arctan2(turned[:, 1, 0], turned[:, 0, 0]))
    rate[1:, 2] = np.diff(yaw) / seconds
    velocity[0], rate[0] = velocity[1], rate[1]
    return velocity, rate


def encode_states(velocity: Floats, rate: Floats, acceleration: Floats) -> list[dict[str, Any]]:
    """Messages ``DynamicState`` of (N, 3) each, in the rig frame."""
    names = ("linear_velocity", "angular_velocity", "linear_acceleration")
    rows = zip(velocity.tolist(), rate.tolist(), acceleration.tolist(), strict=True)
    return [
        {**{name: dict(zip("xyz", vector)) for name, vector in zip(names, row)}, "angular_acceleration": {}}
        for row in rows
    ]


def thin_path(path: Floats, extension_m: float = EXTENSION_M) -> Floats:
    """(K, 3) points of a (P, 3) path at least 0.2 m apart, then straight on as it went in its last metre."""
    kept = [path[0]]
    for point in path[1:]:
        if np.linalg.norm(point - kept[-1]) >= _THINNED_M:
            kept.append(point)
    if extension_m and len(kept) > 1:
        before = next((point for point in kept[-2::-1] if np.linalg.norm(kept[-1] - point) >= _LAST_MOTION_M), kept[0])
        ahead = kept[-1] - before
        kept.append(kept[-1] + extension_m / np.linalg.norm(ahead) * ahead)
    return np.array(kept)


def build_route(path: Floats, position: Floats, rotation: Floats) -> Floats:
    """(20 or less, 3) points of a thinned path from beside a rig pose on, 80/19 m apart along it, in the rig, z 0.

    A path of one point, where nothing ever moved, is a point.
    """
    start, steps = path[:-1], np.diff(path, axis=0)
    if not len(steps):
        return np.zeros((1, 3))
    length = np.linalg.norm(steps, axis=1)
    share = np.clip(((position - start) * steps).sum(axis=1) / length**2, 0.0, 1.0)
    nearest = int(np.argmin(np.linalg.norm(start + share[:, None] * steps - position, axis=1)))
    station = np.concatenate([[0.0], np.cumsum(length)])
    begin = station[nearest] + share[nearest] * length[nearest]
    stations = begin + ROUTE_STEP_M * np.arange(ROUTE_POINTS)
    stations = stations[stations <= station[-1] + 1e-9]
    points = np.stack([np.interp(stations, station, path[:, axis]) for axis in range(3)], axis=-1)
    local = (points - position) @ rotation_matrix(rotation)
    local[:, 2] = 0.0
    return np.asarray(local)


def derive_command(waypoints: Floats, speed: float) -> Command:
    """The command of a route of (N, 3) points in the rig: left or right where it is 2 m aside 3 s ahead.

    Looked at is the waypoint nearest to where 3 s at this speed lead, at least 10 m; points that are not finite, of
    which AlpaSim has some past the end of a recording, are none.
    """
    points = waypoints[np.isfinite(waypoints).all(axis=1)]
    if not len(points):
        return Command.STRAIGHT
    away = np.hypot(points[:, 0], points[:, 1])
    aside = float(points[np.argmin(np.abs(away - max(_COMMAND_M, _COMMAND_S * speed))), 1])
    return Command.LEFT if aside >= _ASIDE_M else Command.RIGHT if aside <= -_ASIDE_M else Command.STRAIGHT
