"""Tracks of ScenarioNet files: checked, named as nuScenes names things, and resampled."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import CATEGORIES
from benchmark.datasets.annotated_objects import find_nearest_valid
from benchmark.datasets.scenario_map import FARTHEST_M, to_real_numbers
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, poses_between, quaternion_from_yaw
from benchmark.scene import Agents, Annotations

_CATEGORY_OF_TYPE: Final = {
    "PEDESTRIAN": "human.pedestrian.adult",
    "CYCLIST": "vehicle.bicycle",
    "BICYCLE": "vehicle.bicycle",
    "MOTORCYCLIST": "vehicle.motorcycle",
    "MOTORCYCLE": "vehicle.motorcycle",
    "BUS": "vehicle.bus.rigid",
    "TRUCK": "vehicle.truck",
    "TRAFFIC_CONE": "movable_object.trafficcone",
    "TRAFFIC_BARRIER": "movable_object.barrier",
    "TRAFFIC_OBJECT": "movable_object.debris",
    "OTHER": "movable_object.debris",
    "OTHERS": "movable_object.debris",
    "UNSET": "movable_object.debris",
}
_LONGEST_CAR_M: Final = 6.5
_LONGEST_TRUCK_M: Final = 10.0
_LARGEST_M: Final = 1000.0


@dataclass(frozen=True, slots=True)
class SourceTrack:
    """One object at every step of its file: (L, 3) metres, (L,) radians, (3,) length, width, height.

    ``position`` is the box centre, but for the ego of nuScenes files; where not ``valid`` the arrays mean nothing.
    """

    category: str
    position: Floats
    heading: Floats
    size: Floats
    valid: Bools


def read_track(track: Any, name: str, steps: int, path: Path) -> SourceTrack | None:
    """Check one track; ``None`` for one that is never there and for traffic lights.

    Arrays that are missing, have wrong shapes, or are not finite where the object is there are refused.
    """
    try:
        if not isinstance(track, dict) or not isinstance(track["state"], dict) or not isinstance(track["type"], str):
            raise TypeError("not a dictionary with a state and a type")
        state, kind = track["state"], track["type"]
        valid = to_real_numbers(state["valid"]).reshape(steps) > 0
        position = to_real_numbers(state["position"])
        heading = to_real_numbers(state["heading"]).reshape(steps)
        sizes = np.column_stack(
            [to_real_numbers(state[field]).reshape(steps) for field in ("length", "width", "height")]
        )
        if position.shape not in ((steps, 2), (steps, 3)):
            raise ValueError(f"position has shape {position.shape}")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: track {name} needs type and state with position, heading, length, width, height and valid at "
            f"{steps} steps ({type(error).__name__}: {error}); fetch the file again"
        ) from error
    if not valid.any() or kind == "TRAFFIC_LIGHT":
        return None
    if position.shape[1] == 2:
        position = np.column_stack([position, np.zeros(steps)])
    size = np.asarray(np.median(sizes[valid], axis=0))
    good = np.isfinite(position).all(axis=-1) & np.isfinite(heading)
    if not good[valid].all():
        step = int(np.flatnonzero(valid & ~good)[0])
        raise InputError(f"{path}: track {name} has a pose that is not finite at step {step}; fetch the file again")
    if not np.isfinite(size).all() or not (size > 0).all():
        raise InputError(f"{path}: track {name} has the size {size.tolist()}; sizes must be positive; fetch it again")
    farthest_m = np.abs(position[valid]).max()
    if farthest_m > FARTHEST_M or size.max() > _LARGEST_M:
        raise InputError(
            f"{path}: track {name} has positions up to {farthest_m:g} and the size {size.tolist()}; these cannot be "
            "metres; fetch the file again"
        )
    return SourceTrack(_category(track, kind, size), position, heading, size, valid)


def _category(track: Mapping[str, Any], kind: str, size: Floats) -> str:
    """The source's own nuScenes category if it has one; else by type, vehicles without a type by their length."""
    metadata = track.get("metadata")
    detailed = metadata.get("type") if isinstance(metadata, dict) else None
    if isinstance(detailed, str) and detailed in CATEGORIES:
        return detailed
    if kind != "VEHICLE":
        return _CATEGORY_OF_TYPE.get(kind, "movable_object.debris")
    return name_vehicle(float(size[0]))


def name_vehicle(length_m: float) -> str:
    """Category of a vehicle of which nothing but the length is known."""
    if length_m <= _LONGEST_CAR_M:
        return "vehicle.car"
    return "vehicle.truck" if length_m <= _LONGEST_TRUCK_M else "vehicle.bus.rigid"


def resample_tracks(
    tracks: Mapping[str, SourceTrack],
    seconds: Floats,
    frame_seconds: Floats,
    keyframes: NDArray[np.int64],
    *,
    shift: Floats,
    ground_z: Floats | None,
) -> tuple[Agents, Annotations]:
    """Resample tracks: linear position, shortest-arc heading; there only where both neighbouring steps are.

    Objects that are at no keyframe are left out, because nothing would annotate them. Both results have box centres.

    Args:
        seconds: (L,) times of the source's steps.
        frame_seconds: (T,) times of frames.
        keyframes: (K,) frames that are keyframes.
        shift: (2,) metres added to all positions.
        ground_z: (L,) ground heights to subtract, or ``None`` where heights are fine as they are. Tracks with height 0
            throughout stand on the ground.
    """
    right = np.clip(np.searchsorted(seconds, frame_seconds - 1e-9), 1, len(seconds) - 1)
    left = right - 1
    fraction = np.clip((frame_seconds - seconds[left]) / (seconds[right] - seconds[left]), 0.0, 1.0)
    fraction[fraction < 1e-6], fraction[fraction > 1 - 1e-6] = 0.0, 1.0
    resampled: dict[str, tuple[SourceTrack, Floats, Floats, Bools]] = {}
    for name, track in tracks.items():
        is_there = (track.valid[left] | (fraction == 1.0)) & (track.valid[right] | (fraction == 0.0))
        if not is_there[keyframes].any():
            continue
        xyz, yaw = _interpolate_between(track, left, right, fraction, ground_z)
        nearest = find_nearest_valid(is_there[None])[0]
        resampled[name] = (track, xyz[nearest] + [*shift, 0.0], yaw[nearest], is_there)
    count, frames = len(resampled), len(frame_seconds)
    agents = Agents(
        ids=tuple(resampled),
        categories=tuple(track.category for track, *_ in resampled.values()),
        position=np.array([xyz for _, xyz, _, _ in resampled.values()]).reshape(count, frames, 3),
        yaw=np.array([yaw for _, _, yaw, _ in resampled.values()]).reshape(count, frames),
        size=np.array([track.size for track, *_ in resampled.values()]).reshape(count, 3),
        valid=np.array([is_there for *_, is_there in resampled.values()], dtype=np.bool_).reshape(count, frames),
    )
    return agents, _annotations(agents, keyframes)


def _interpolate_between(
    track: SourceTrack, left: NDArray[np.int64], right: NDArray[np.int64], fraction: Floats, ground_z: Floats | None
) -> tuple[Floats, Floats]:
    z = track.position[:, 2]
    if not z[track.valid].any():
        z = np.full_like(z, 0.5 * track.size[2])
    elif ground_z is not None:
        z = z - ground_z
    poses = np.column_stack([track.position[:, :2], track.heading])
    between = poses_between(poses[left], poses[right], fraction)
    # Exact at the source's own steps, so that keyframe annotations keep its values.
    exact = np.where(fraction == 1.0, right, left)
    on_step = (fraction == 0.0) | (fraction == 1.0)
    between = np.where(on_step[:, None], poses[exact], between)
    height = np.where(on_step, z[exact], z[left] + fraction * (z[right] - z[left]))
    return np.column_stack([between[:, :2], height]), between[:, 2]


def _annotations(agents: Agents, keyframes: NDArray[np.int64]) -> Annotations:
    """One lidar point for every box: the files count none, and metrics drop boxes without points."""
    valid = agents.valid[:, keyframes]
    nearest_keyframes = keyframes[find_nearest_valid(valid)] if len(agents) else np.zeros(valid.shape, np.int64)
    rows = np.arange(len(agents))[:, None]
    return Annotations(
        position=agents.position[rows, nearest_keyframes],
        rotation=quaternion_from_yaw(agents.yaw[rows, nearest_keyframes]),
        size=np.repeat(agents.size[:, None], len(keyframes), axis=1),
        valid=valid,
        attribute=np.full(valid.shape, "", dtype=np.str_),
        visibility=np.zeros(valid.shape, dtype=np.int64),
        num_lidar_pts=valid.astype(np.int64),
        num_radar_pts=np.zeros(valid.shape, dtype=np.int64),
    )
