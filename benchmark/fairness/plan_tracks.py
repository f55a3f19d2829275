"""Tracks up to the contact of a plan: both as recorded up to the sample, then the plan and the other as recorded."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.contact_fault import make_contact_grid
from benchmark.fairness.fault_definition import WINDOW_S, ContactTracks, RoadUser
from benchmark.geometry import Bools, Floats, ego_footprints, wrap_angle
from benchmark.interactions.tracks import STEP_S
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

_POSE: Final = (0, 1, 4)
"""Columns of a box."""
_BEFORE_S: Final = 1.0
"""Frames so long before the window are enough to interpolate from."""
_NOW_S: Final = 1e-6
"""A frame so near to a sample is the sample's."""


def _place_recorded_ego(scene: Scene) -> Floats:
    """(T, 3) poses of the ego's box of ``exact``, which is not quite the body, on the recorded path."""
    lidar, ahead_m = scene.ego.pose.copy(), float(scene.lidar.translation[0])
    lidar[:, :2] += ahead_m * np.column_stack([np.cos(lidar[:, 2]), np.sin(lidar[:, 2])])
    return ego_footprints(lidar)[:, _POSE]


_load_recorded_ego: Final = IdentityCache[Scene, Floats](_place_recorded_ego, kept=2)


@dataclass(frozen=True, slots=True)
class RoadUserAhead:
    """An agent around a sample: (31, 5) boxes in its lidar frame, 0.1 s apart from now on, and (31,) if it is there."""

    name: str
    category: str
    boxes: Floats
    there: Bools


def place_lidar_boxes(boxes: Floats, lidar_pose: Floats) -> Floats:
    """(..., 5) boxes of a lidar frame (x right, y forward) in the world, given (..., 3) poses of the lidar there."""
    turn = lidar_pose[..., 2] - np.pi / 2
    cos, sin = np.cos(turn), np.sin(turn)
    placed = boxes.copy()
    placed[..., 0] = lidar_pose[..., 0] + boxes[..., 0] * cos - boxes[..., 1] * sin
    placed[..., 1] = lidar_pose[..., 1] + boxes[..., 0] * sin + boxes[..., 1] * cos
    placed[..., 4] = wrap_angle(boxes[..., 4] + turn)
    return placed


def trace_plan_contact(
    scene: Scene, truth: SampleTruth, ego_boxes: Floats, other: RoadUserAhead, instant: int
) -> ContactTracks:
    """Ego and other every 0.1 s up to their contact, for as long as the other was there, 5 s at most.

    ``ego_boxes`` (31, 5) follow the plan in the lidar frame, 0.1 s apart; they touch the other's at an instant.
    """
    now = (truth.timestamp_us - int(scene.timestamps_us[0])) * 1e-6
    seconds = scene.seconds
    first, past = np.searchsorted(seconds, [now - WINDOW_S - _BEFORE_S, now - _NOW_S]).tolist()
    ahead = now + STEP_S * np.arange(instant + 1)
    absent = np.flatnonzero(~other.there[: instant + 1])
    came = int(absent[-1]) + 1 if len(absent) else 0
    known = _recorded_poses(scene, other.name, slice(first, past)) if came == 0 else np.zeros((0, 3))
    ego_times = np.concatenate([seconds[first:past], ahead])
    other_times = np.concatenate([seconds[past - len(known) : past], ahead[came:]])
    grid = make_contact_grid(float(ahead[-1]), float(other_times[0]))
    ego = np.concatenate([_load_recorded_ego(scene)[first:past], _place(ego_boxes[: instant + 1], truth)])
    poses = np.concatenate([known, _place(other.boxes[came : instant + 1], truth)])
    return ContactTracks(
        grid,
        RoadUser.resampled("vehicle.car", _size(ego_boxes[instant]), ego_times, ego, grid),
        RoadUser.resampled(other.category, _size(other.boxes[instant]), other_times, poses, grid),
    )


def _recorded_poses(scene: Scene, name: str, frames: slice) -> Floats:
    """(P, 3) of an agent in the unbroken run of frames at the end of some; none of an unknown one."""
    if name not in scene.agents.ids:
        return np.zeros((0, 3))
    agents, number = scene.agents, scene.agents.ids.index(name)
    absent = np.flatnonzero(~agents.valid[number, frames])
    rows = slice(frames.start + (int(absent[-1]) + 1 if len(absent) else 0), frames.stop)
    return np.column_stack([agents.position[number, rows, :2], agents.yaw[number, rows]])


def _place(boxes: Floats, truth: SampleTruth) -> Floats:
    return place_lidar_boxes(boxes, truth.lidar_pose)[:, _POSE]


def _size(box: Floats) -> tuple[float, float]:
    return float(box[2]), float(box[3])
