"""Keyframe annotations of simulated participants: who is seen how well, with how many lidar points."""

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, to_local
from benchmark.scene import Agents, Annotations, EgoTrack

_RAYS = 7
_LIDAR_POINTS_M2 = 4200.0
_RADAR_SHARE = 0.02
_VISIBILITY_LEVELS = (0.4, 0.6, 0.8)
_MOVING_MPS = 0.3
_LIDAR_CERTAIN_M = 50.0


def annotate(agents: Agents, parked: Bools, ego: EgoTrack, keyframes: NDArray[np.int64]) -> Annotations:
    """Annotations, (N, K), of agents at the (K,) keyframes. ``parked`` says (N,) which vehicles are parked.

    Visibility is the share of sight lines from the ego's roof that no nearer box crosses; lidar points fall with
    the square of the distance and that share, and are at least one within 50 m.
    """
    position, yaw, valid = agents.position[:, keyframes], agents.yaw[:, keyframes], agents.valid[:, keyframes]
    seen = np.zeros(valid.shape)
    distance = np.zeros(valid.shape)
    boxes = agents.boxes[:, keyframes]
    for column, frame in enumerate(keyframes.tolist()):
        eye = ego.position[frame, :2]
        distance[:, column] = np.hypot(position[:, column, 0] - eye[0], position[:, column, 1] - eye[1])
        there = np.flatnonzero(valid[:, column])
        seen[there, column] = _visible_share(boxes[there, column], agents.size[there, 2], eye)
    area = agents.size[:, 2] * np.maximum(agents.size[:, 0], agents.size[:, 1])
    points = np.rint(_LIDAR_POINTS_M2 * area[:, None] * seen / np.maximum(distance, 3.0) ** 2).astype(np.int64)
    points = np.where((distance < _LIDAR_CERTAIN_M) & (seen > 0), np.maximum(points, 1), points)
    levels = 1 + np.searchsorted(np.array(_VISIBILITY_LEVELS), seen, side="right")
    return Annotations(
        position=position,
        rotation=quaternion_from_yaw(yaw),
        size=np.repeat(agents.size[:, None], len(keyframes), axis=1),
        valid=valid,
        attribute=_attributes(agents, parked, keyframes),
        visibility=np.where(valid, levels, 1).astype(np.int64),
        num_lidar_pts=np.where(valid, points, 0),
        num_radar_pts=np.where(valid, np.minimum(np.rint(_RADAR_SHARE * points), 12), 0).astype(np.int64),
    )


def _visible_share(boxes: Floats, heights: Floats, eye: Floats) -> Floats:
    """(N,) share of sight lines to each box, spread over its width as seen, that no other box crosses."""
    count = len(boxes)
    towards = np.arctan2(boxes[:, 1] - eye[1], boxes[:, 0] - eye[0])
    turned = boxes[:, 4] - towards
    half = 0.5 * (boxes[:, 2] * np.abs(np.sin(turned)) + boxes[:, 3] * np.abs(np.cos(turned)))
    spread = np.linspace(-0.9, 0.9, _RAYS)[None] * half[:, None]
    target_x = boxes[:, 0, None] - spread * np.sin(towards)[:, None]
    target_y = boxes[:, 1, None] + spread * np.cos(towards)[:, None]
    targets = np.stack([target_x, target_y], axis=-1)
    # (sight lines, boxes): both ends of each line in the frame of each box, then the slab test.
    frames = boxes[None, None, :, [0, 1, 4]]
    start = to_local(np.broadcast_to(eye, (1, 1, count, 2)), frames)
    end = to_local(np.broadcast_to(targets[:, :, None], (count, _RAYS, count, 2)), frames)
    step = end - start
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    bounds = 0.5 * boxes[None, None, :, 2:4]
    first, second = (-bounds - start) / safe, (bounds - start) / safe
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    crossed = (enter < leave) & (leave > 0) & (enter < 0.98)
    taller = heights[None, :] > 0.75 * heights[:, None]
    hidden = (crossed & taller[:, None, :] & ~np.eye(count, dtype=np.bool_)[:, None, :]).any(axis=-1)
    return np.asarray(1.0 - hidden.mean(axis=1))


def _attributes(agents: Agents, parked: Bools, keyframes: NDArray[np.int64]) -> NDArray[np.str_]:
    before = np.maximum(keyframes - 1, 0)
    after = np.minimum(keyframes + 1, agents.yaw.shape[1] - 1)
    moved = agents.position[:, after, :2] - agents.position[:, before, :2]
    speed = np.hypot(moved[..., 0], moved[..., 1]) * FRAME_HZ / (after - before)
    rows = []
    for index, category in enumerate(agents.categories):
        moving = speed[index] > _MOVING_MPS
        if category in ("vehicle.bicycle", "vehicle.motorcycle"):
            rows.append(np.full(len(keyframes), "cycle.with_rider"))
        elif category.startswith("vehicle."):
            still = "vehicle.parked" if parked[index] else "vehicle.stopped"
            rows.append(np.where(moving, "vehicle.moving", still))
        elif category.startswith("human."):
            rows.append(np.where(moving, "pedestrian.moving", "pedestrian.standing"))
        else:
            rows.append(np.full(len(keyframes), ""))
    return np.array(rows, dtype=np.str_).reshape(len(agents), len(keyframes))
