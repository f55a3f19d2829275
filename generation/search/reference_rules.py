"""What the public reference code does before its score: which vehicles, from when on, in which state of motion."""

from typing import Final

import numpy as np
import shapely

from benchmark.dynamics.bicycle import VehicleState, rear_axle
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.scene import Scene
from generation.search.reference_scoring import lidar_positions

CAR: Final = "vehicle.car"
CHOSEN_WITHIN_M: Final = 20.0
LEAST_DRIVABLE_SHARE: Final = 0.7
LAUNCH_WITHIN_M: Final = 25.0
SEEN_FRAMES: Final = 4
"""Frames in a row, up to the one before, in which a vehicle must have been there to be launched."""
LAST_LAUNCH: Final = 140
HISTORY_FRAMES: Final = 16
FIRST_LAUNCH: Final = 20
"""Frames are waited for before anything is planned: the model is told of 16 frames."""
AREA_M: Final = 50.0
"""Half the side of the area around the lidar in which a vehicle counts as near."""
STEP_FRAMES: Final = 4
"""Frames that the model takes for half a second."""
SPEED_FRAMES: Final = 2
"""Frames over which the speed is taken."""


def lidar_distance(scene: Scene, agent: int) -> Floats:
    """Distance (T,) from the ego's lidar to an agent's box centre, metres."""
    return np.asarray(np.linalg.norm(scene.agents.position[agent, :, :2] - lidar_positions(scene), axis=-1))


def in_reference_canvas(scene: Scene, agent: int) -> Bools:
    """(T,) whether an agent is there and in the square around the ego's lidar."""
    pose = np.column_stack([lidar_positions(scene), scene.ego.pose[:, 2]])
    local = to_local(scene.agents.position[agent, :, :2], pose)
    return np.asarray((np.abs(local) <= AREA_M).all(axis=-1) & scene.agents.valid[agent])


def near_on_the_road(scene: Scene, agent: int) -> tuple[bool, bool]:
    """Whether the reference code would edit a vehicle: comes within 20 m of the lidar, and is on the road while near.

    A vehicle that is never in the area has neither.
    """
    canvas = in_reference_canvas(scene, agent)
    if not canvas.any():
        return False, False
    shapely.prepare(scene.road_map.drivable_area)
    on_road = scene.road_map.is_drivable(scene.agents.position[agent, canvas, :2]).mean() >= LEAST_DRIVABLE_SHARE
    return bool(lidar_distance(scene, agent)[canvas].min() <= CHOSEN_WITHIN_M), bool(on_road)


def reference_launch(scene: Scene, agent: int) -> int | None:
    """First frame, not before 20, at which the reference code takes a vehicle over.

    ``None`` if there is none up to frame 140, and where the vehicle was not there over the history that is read,
    which the reference code does not ask: it goes on with positions of nothing.
    """
    valid = scene.agents.valid[agent]
    near = valid & (lidar_distance(scene, agent) < LAUNCH_WITHIN_M)
    for frame in np.flatnonzero(near[: LAST_LAUNCH + 1]):
        if frame >= SEEN_FRAMES and valid[frame - SEEN_FRAMES : frame].all():
            start = max(int(frame), FIRST_LAUNCH)
            there = start < len(valid) - 1 and bool(valid[start - HISTORY_FRAMES : start + 1].all())
            return start if there else None
    return None


def reference_state(before: Floats, now: Floats, length_m: float) -> VehicleState:
    """Motion that the reference code plans from: its speed has lost its sign, everything else is zero.

    (3,) poses of the box centre two frames ago and now; the speed, at the rear axle, is in metres a frame.
    """
    speed = float(np.hypot(*(now[:2] - before[:2]))) / SPEED_FRAMES
    return VehicleState(rear_axle(now, length_m), speed)


def reference_previous(before: Floats, now: Floats) -> Floats:
    """Pose (3,) that the reference code tells the model: the centre four frames ago in the frame of the centre now."""
    return np.concatenate([to_local(before[:2], now), wrap_angle(before[2:] - now[2])])
