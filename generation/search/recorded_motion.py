"""Motion of recorded vehicles around the ego at a hand-over, and contacts of the recorded ego as metrics score them."""

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.datasets.sample_truth import compute_ego_future, compute_planar_lidar_poses
from benchmark.dynamics.bicycle import REFERENCE_STEERING_RAD, WHEELBASE, DriverLimits, VehicleState, compute_rear_axle
from benchmark.geometry import Bools, Floats, boxes_overlap, to_global, to_local, wrap_angle, yaw_of_quaternion
from benchmark.protocols.exact import (
    INSTANTS_PER_STEP,
    compute_plan_boxes,
    interpolate_footprints,
    interpolate_object_boxes,
)
from benchmark.scene import Scene
from generation.labels.labelling import compute_ego_speed
from generation.search.hyperparameters import HyperParameters


def find_log_replay_contacts(scene: Scene, agents: NDArray[np.int64] | None = None) -> Bools:
    """(N,) whether the recorded ego touches ``agents`` when a metric replays the scene from its 2 Hz annotations."""
    chosen = np.arange(len(scene.agents)) if agents is None else agents
    contacts = np.zeros(len(scene.agents), dtype=np.bool_)
    if len(scene.keyframes) < 2 or not len(chosen):
        return contacts
    boxes, present = _interpolate_annotations(scene, chosen)
    for ego, interval in _compute_ego_footprints(scene):
        contacts[chosen] |= _is_touching(ego, boxes[:, interval], present[:, interval])
    return contacts


def _interpolate_annotations(scene: Scene, chosen: NDArray[np.int64]) -> tuple[Floats, Bools]:
    """Boxes (N, K - 1, 5, 5) and presence (N, K - 1, 5) every 0.1 s after each keyframe but the last."""
    notes = scene.annotations
    yaw = yaw_of_quaternion(notes.rotation[chosen])[..., None]
    boxes = np.concatenate([notes.position[chosen, :, :2], notes.size[chosen, :, :2], yaw], axis=-1)
    between, present = interpolate_object_boxes(boxes, notes.valid[chosen])
    intervals = (len(chosen), len(scene.keyframes) - 1, INSTANTS_PER_STEP)
    return between.reshape(*intervals, 5), present.reshape(intervals)


def _compute_ego_footprints(scene: Scene) -> list[tuple[Floats, slice]]:
    """Metric footprints (I, 5, 5) of the recorded ego with the keyframe intervals they belong to.

    The first has the real heading over the whole scene; the others are what a protocol makes of the recorded future of
    each sample, whose headings are chords between waypoints.
    """
    pose = compute_planar_lidar_poses(scene)
    footprints = [(interpolate_footprints(pose[:-1], pose[1:]), slice(0, len(pose) - 1))]
    for index in range(len(pose) - PLAN_STEPS):
        future, _ = compute_ego_future(pose, index)
        boxes = compute_plan_boxes(future[:, :2]).reshape(PLAN_STEPS, INSTANTS_PER_STEP, 5)
        # The metric's frame has x to the right.
        frame = pose[index] - [0.0, 0.0, np.pi / 2]
        boxes[..., :2] = to_global(boxes[..., :2], frame)
        boxes[..., 4] += frame[2]
        footprints.append((boxes, slice(index, index + PLAN_STEPS)))
    return footprints


def _is_touching(ego: Floats, boxes: Floats, present: Bools) -> Bools:
    """(N,) whether an agent touches the ego at any instant; circumscribed circles first."""
    reach = 0.5 * (np.hypot(ego[..., 2], ego[..., 3]) + np.hypot(boxes[..., 2], boxes[..., 3]))
    near = present & (np.hypot(boxes[..., 0] - ego[..., 0], boxes[..., 1] - ego[..., 1]) <= reach)
    agent, interval, instant = np.nonzero(near)
    hit = boxes_overlap(ego[interval, instant], boxes[agent, interval, instant])
    verdict = np.zeros(len(boxes), dtype=np.bool_)
    verdict[agent[hit]] = True
    return verdict


AHEAD_S = 8.0
"""Of the ego's path, which proposed tracks have to meet."""
STANDING_M_S = 0.3
"""Slower than this a recorded vehicle stands; what its annotation drifts is noise."""
MOST_SLIP_RAD = 0.35
"""Recorded direction of motion and recorded heading may differ by this at the launch."""
FIT_HALF_WINDOW = FRAMES_PER_KEYFRAME
"""Frames on either side from which the motion at the launch is estimated: one keyframe interval."""


def is_vulnerable(scene: Scene, agent: int) -> bool:
    """Whether somebody walks or rides."""
    return scene.agents.categories[agent].startswith(("human.pedestrian", "vehicle.bicycle", "vehicle.motorcycle"))


def is_in_canvas(scene: Scene, points: Floats, half_extent_m: float, *, first: int = 0) -> Bools:
    """Whether (F, 2) global points, one a frame from ``first`` on, lie in the square around the ego."""
    local = to_local(points, scene.ego.pose[first : first + len(points)])
    return np.asarray((np.abs(local) <= half_extent_m).all(axis=-1))


def measure_to_ego_path(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Least metres, to a vehicle, of where the ego is in the next 8 s, while it moves; infinite beyond the area."""
    valid, least = scene.agents.valid[agent], np.inf
    moving = compute_ego_speed(scene) >= hyper.moving_ego_m_s
    for frame in np.flatnonzero(valid)[hyper.history_frames :: FRAME_HZ].tolist():
        ahead = slice(frame, frame + round(AHEAD_S * FRAME_HZ))
        there = scene.ego.boxes[ahead, :2][moving[ahead]]
        away = np.linalg.norm(there - scene.agents.position[agent, frame, :2], axis=1)
        least = min(least, float(away.min(initial=np.inf)))
    return least if least <= hyper.half_extent_m else np.inf


def compute_center_distance(scene: Scene, agent: int) -> Floats:
    """Distance (T,) between the box centres of an agent and of the ego, metres."""
    return np.asarray(np.linalg.norm(scene.agents.position[agent, :, :2] - scene.ego.boxes[:, :2], axis=-1))


def is_driving_forward(scene: Scene, agent: int, frame: int) -> bool:
    """Whether recorded motion agrees with recorded heading: standing, or moving where the box points."""
    velocity, _, _ = _fit_motion(scene, agent, frame)
    if np.hypot(*velocity) < STANDING_M_S:
        return True
    slip = wrap_angle(np.arctan2(velocity[1], velocity[0]) - scene.agents.yaw[agent, frame])
    return bool(np.abs(slip) <= MOST_SLIP_RAD)


def compute_initial_state(scene: Scene, agent: int, frame: int, limits: DriverLimits | None) -> VehicleState:
    """Rear-axle motion of a recorded vehicle at the hand-over, so that the new track goes on where the old one stops.

    Speed is signed along the heading and then not negative (the reference lost the sign: reversing cars shot ahead).
    The state is brought inside ``limits``; without any, only the steering inside that of the physics.
    """
    velocity, acceleration, yaw_rate = _fit_motion(scene, agent, frame)
    yaw = float(scene.agents.yaw[agent, frame])
    heading = np.array([np.cos(yaw), np.sin(yaw)])
    length = float(scene.agents.size[agent, 0])
    pose = compute_rear_axle(np.array([*scene.agents.position[agent, frame, :2], yaw]), length)
    speed = max(float(velocity @ heading), 0.0)
    if speed < STANDING_M_S:
        return VehicleState(pose, 0.0)
    if limits is None:
        steering = np.arctan(yaw_rate * WHEELBASE * length / max(speed, 1.0))
        bounded = np.clip(steering, -REFERENCE_STEERING_RAD, REFERENCE_STEERING_RAD)
        return VehicleState(pose, speed, float(acceleration @ heading), float(bounded))
    along = float(np.clip(acceleration @ heading, -limits.braking_m_s2, limits.acceleration_m_s2))
    most = min(limits.lateral_acceleration_m_s2 / speed, limits.yaw_rate_rad_s)
    steering = np.arctan(np.clip(yaw_rate, -most, most) * WHEELBASE * length / max(speed, 1.0))
    return VehicleState(pose, speed, along, float(np.clip(steering, -limits.steering_rad, limits.steering_rad)))


def _fit_motion(scene: Scene, agent: int, frame: int) -> tuple[Floats, Floats, float]:
    """Velocity (2,), acceleration (2,) and yaw rate of the recorded track at a frame, by a local quadratic fit."""
    valid = scene.agents.valid[agent]
    first, last = frame, frame
    while first > max(frame - FIT_HALF_WINDOW, 0) and valid[first - 1]:
        first -= 1
    while last < min(frame + FIT_HALF_WINDOW, len(valid) - 1) and valid[last + 1]:
        last += 1
    time = (np.arange(first, last + 1) - frame) / FRAME_HZ
    if len(time) < 3:
        return np.zeros(2), np.zeros(2), 0.0
    basis = np.column_stack([np.ones_like(time), time, 0.5 * time**2])
    yaw = np.unwrap(scene.agents.yaw[agent, first : last + 1])
    measured = np.column_stack([scene.agents.position[agent, first : last + 1, :2], yaw])
    fit = np.linalg.lstsq(basis, measured - measured[0], rcond=None)[0]
    return fit[1, :2], fit[2, :2], float(fit[1, 2])
