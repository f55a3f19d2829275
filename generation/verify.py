"""Whether an adversarial scene is kept: challenging, drivable, and solvable by the recorded ego.

Paper section 3 (last paragraph of "Multi-round Trajectory Refinement") and appendix "The Adv-nuSc Dataset".
"""

from dataclasses import replace
from enum import StrEnum

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.datasets.annotated import tracks_between
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, to_local, wrap_angle
from benchmark.scene import Scene
from generation.candidates import in_canvas
from generation.hyperparameters import HyperParameters
from generation.labels import agent_boxes, body_gaps, ego_speed
from generation.physics import DriverLimits, rear_axle
from generation.solvable import log_replay_contacts


class Discard(StrEnum):
    """Why a scene is not kept."""

    NEVER_LAUNCHED = "never-launched"
    ORIGINAL_COLLIDES = "original-scene-collides"
    NO_SAFE_CANDIDATE = "no-candidate-without-collision"
    HITS_OBJECT = "hits-an-object"
    HITS_EGO = "hits-the-ego"
    EGO_BLOCKED = "blocks-the-ego-at-the-end"
    LEAVES_AREA = "leaves-the-area-around-the-ego"
    LEAVES_ROAD = "leaves-the-drivable-area"
    NEVER_CLOSE = "never-gets-close"
    UNDRIVEABLE = "motion-no-driver-could-drive"


LIMIT_TOLERANCE = 1.05
"""Finite differences at 12 Hz overshoot the simulator's own limits by less than this factor."""
SIDEWAYS_M_S = 0.3
"""Sideways speed of the rear axle that an explicit integration step may show in a tight turn."""


def verify(scene: Scene, agent: int, start: int, hyper: HyperParameters, limits: DriverLimits) -> Discard | None:
    """Check one adversarial scene.

    Args:
        scene: The adversarial scene.
        agent: Index of the adversary.
        start: First frame of the adversarial track.
        hyper: Limits of the filter.
        limits: Limits of the driver.

    Returns:
        The first reason to discard it, or ``None`` to keep it.
    """
    boxes = agent_boxes(scene, agent)[start:]
    if not np.isfinite(boxes).all() or not is_drivable_motion(boxes, limits):
        return Discard.UNDRIVEABLE
    read = _as_read(scene)
    stretches = ((scene, np.arange(start, start + len(boxes))), (read, np.arange(start, read.agents.yaw.shape[1])))
    if any(touches_others(agent_boxes(seen, agent)[at], seen, agent, at).any() for seen, at in stretches):
        return Discard.HITS_OBJECT
    contact = boxes_overlap(boxes, scene.ego.boxes[start:]).any()
    if contact or log_replay_contacts(scene, np.array([agent]))[agent]:
        return Discard.HITS_EGO
    if _blocks_ego(scene, boxes, hyper):
        return Discard.EGO_BLOCKED
    if not in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m)[start:].all():
        return Discard.LEAVES_AREA
    if _leaves_road(scene, boxes, hyper):
        return Discard.LEAVES_ROAD
    moving = ego_speed(scene)[start:] >= hyper.moving_ego_m_s
    if not (body_gaps(scene, agent, start)[moving] <= hyper.close_gap_m).any():
        return Discard.NEVER_CLOSE
    return None


def _as_read(scene: Scene) -> Scene:
    """The scene as a reader of the data set gets it: 2 Hz annotations and straight lines, which cut corners."""
    tracks = tracks_between(scene.agents.ids, scene.agents.categories, scene.annotations, scene.keyframes)
    return replace(scene, agents=tracks)


def touches_others(boxes: Floats, scene: Scene, agent: int, frames: NDArray[np.int64]) -> Bools:
    """Whether a track touches any other present agent.

    Args:
        boxes: (F, 5) boxes of the track.
        scene: The scene.
        agent: Index of the track's own agent, which is left out.
        frames: (F,) frame indices.

    Returns:
        (F,) verdicts.
    """
    at = frames
    present = scene.agents.valid[:, at].copy()
    present[agent] = False
    center = scene.agents.position[:, at, :2]
    reach = 0.5 * (np.hypot(*scene.agents.size[:, :2].T)[:, None] + np.hypot(boxes[:, 2], boxes[:, 3]))
    near = present & (np.hypot(center[..., 0] - boxes[:, 0], center[..., 1] - boxes[:, 1]) <= reach)
    other, step = np.nonzero(near)
    others = np.column_stack([center[other, step], scene.agents.size[other, :2], scene.agents.yaw[other, at[step]]])
    hit = np.zeros(len(at), dtype=np.bool_)
    hit[step[boxes_overlap(boxes[step], others)]] = True
    return hit


def _blocks_ego(scene: Scene, boxes: Floats, hyper: HyperParameters) -> bool:
    """Whether the ego would hit the adversary after the last frame although it brakes hard on its heading.

    The recorded ego needs no way out while the recording lasts; this asks for one where it ends. An adversary behind
    the ego is itself the one to brake.
    """
    ego = scene.ego.boxes
    if to_local(boxes[-1, :2], ego[-1, [0, 1, 4]])[0] <= 0.0:
        return False
    seconds = scene.seconds
    span = float(seconds[-1] - seconds[-2])
    velocity = (ego[-1, :2] - ego[-2, :2]) / span
    speed = float(np.hypot(*velocity))
    time = np.arange(0.0, speed / hyper.stopping_m_s2 + 0.1, 0.1)
    braking = np.minimum(time, speed / hyper.stopping_m_s2)
    travelled = speed * braking - 0.5 * hyper.stopping_m_s2 * braking**2
    stopping = np.repeat(ego[-1:], len(time), axis=0)
    stopping[:, :2] += travelled[:, None] * np.array([np.cos(ego[-1, 4]), np.sin(ego[-1, 4])])
    other = np.repeat(boxes[-1:], len(time), axis=0)
    other[:, :2] += time[:, None] * (boxes[-1, :2] - boxes[-2, :2]) / span
    return bool(boxes_overlap(stopping, other).any())


def _leaves_road(scene: Scene, boxes: Floats, hyper: HyperParameters) -> bool:
    shapely.prepare(scene.road_map.drivable_area)
    center_off = ~scene.road_map.is_drivable(boxes[:, :2])
    corner_off = ~scene.road_map.is_drivable(box_corners(boxes)).all(axis=-1)
    return bool(center_off.mean() > hyper.most_off_road_share or corner_off.mean() > hyper.most_corner_off_road_share)


def is_drivable_motion(boxes: Floats, limits: DriverLimits) -> bool:
    """Whether a 12 Hz track stays inside what the driver can do: finite differences of the rear axle's path.

    Args:
        boxes: (F, 5) boxes.
        limits: Limits.

    Returns:
        The verdict; tracks of fewer than three frames pass.
    """
    if len(boxes) < 3:
        return True
    axle = rear_axle(boxes[:, [0, 1, 4]], float(boxes[0, 2]))
    step = np.diff(axle[:, :2], axis=0) * FRAME_HZ
    yaw = axle[:-1, 2]
    along = step[:, 0] * np.cos(yaw) + step[:, 1] * np.sin(yaw)
    across = step[:, 1] * np.cos(yaw) - step[:, 0] * np.sin(yaw)
    yaw_rate = wrap_angle(np.diff(axle[:, 2])) * FRAME_HZ
    acceleration = np.diff(along) * FRAME_HZ
    return bool(
        np.abs(across).max() <= SIDEWAYS_M_S
        and along.min() >= -SIDEWAYS_M_S
        and acceleration.max() <= limits.acceleration_m_s2 * LIMIT_TOLERANCE
        and acceleration.min() >= -limits.braking_m_s2 * LIMIT_TOLERANCE
        and np.abs(yaw_rate).max() <= limits.yaw_rate_rad_s * LIMIT_TOLERANCE
        and np.abs(yaw_rate * along).max() <= limits.lateral_acceleration_m_s2 * LIMIT_TOLERANCE
    )
