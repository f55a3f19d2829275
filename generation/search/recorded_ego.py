"""Whether the recorded ego gets through: its own trajectory, judged as the metrics judge a plan.

Data sets are stored at 2 Hz and metrics interpolate them; the recorded ego gets through only if it is clear of
everything in those interpolated boxes too, with its real heading and with the heading that a metric derives.
"""

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.datasets.sample_truth import ego_future, planar_lidar_poses
from benchmark.geometry import Bools, Floats, boxes_overlap, to_global, yaw_of_quaternion
from benchmark.protocols.exact import INSTANTS_PER_STEP, ego_boxes, footprints_between, object_boxes
from benchmark.scene import Scene


def log_replay_contacts(scene: Scene, agents: NDArray[np.int64] | None = None) -> Bools:
    """Which agents the recorded ego touches when a metric replays the scene from its 2 Hz annotations.

    (N,) verdicts for ``agents``, all by default; False for those that were not tested.
    """
    chosen = np.arange(len(scene.agents)) if agents is None else agents
    contacts = np.zeros(len(scene.agents), dtype=np.bool_)
    if len(scene.keyframes) < 2 or not len(chosen):
        return contacts
    boxes, present = _interpolated_annotations(scene, chosen)
    for ego, interval in _ego_footprints(scene):
        contacts[chosen] |= _touching(ego, boxes[:, interval], present[:, interval])
    return contacts


def _interpolated_annotations(scene: Scene, chosen: NDArray[np.int64]) -> tuple[Floats, Bools]:
    """Boxes (N, K - 1, 5, 5) and presence (N, K - 1, 5) every 0.1 s after each keyframe but the last."""
    notes = scene.annotations
    yaw = yaw_of_quaternion(notes.rotation[chosen])[..., None]
    boxes = np.concatenate([notes.position[chosen, :, :2], notes.size[chosen, :, :2], yaw], axis=-1)
    between, present = object_boxes(boxes, notes.valid[chosen])
    intervals = (len(chosen), len(scene.keyframes) - 1, INSTANTS_PER_STEP)
    return between.reshape(*intervals, 5), present.reshape(intervals)


def _ego_footprints(scene: Scene) -> list[tuple[Floats, slice]]:
    """Metric footprints (I, 5, 5) of the recorded ego with the keyframe intervals they belong to.

    The first has the real heading over the whole scene; the others are what a protocol makes of the recorded future
    of each sample, whose headings are chords between waypoints.
    """
    pose = planar_lidar_poses(scene)
    footprints = [(footprints_between(pose[:-1], pose[1:]), slice(0, len(pose) - 1))]
    for index in range(len(pose) - PLAN_STEPS):
        future, _ = ego_future(pose, index)
        boxes = ego_boxes(future[:, :2]).reshape(PLAN_STEPS, INSTANTS_PER_STEP, 5)
        # The metric's frame has x to the right.
        frame = pose[index] - [0.0, 0.0, np.pi / 2]
        boxes[..., :2] = to_global(boxes[..., :2], frame)
        boxes[..., 4] += frame[2]
        footprints.append((boxes, slice(index, index + PLAN_STEPS)))
    return footprints


def _touching(ego: Floats, boxes: Floats, present: Bools) -> Bools:
    """(N,) whether an agent touches the ego at any instant; circumscribed circles first."""
    reach = 0.5 * (np.hypot(ego[..., 2], ego[..., 3]) + np.hypot(boxes[..., 2], boxes[..., 3]))
    near = present & (np.hypot(boxes[..., 0] - ego[..., 0], boxes[..., 1] - ego[..., 1]) <= reach)
    agent, interval, instant = np.nonzero(near)
    hit = boxes_overlap(ego[interval, instant], boxes[agent, interval, instant])
    verdict = np.zeros(len(boxes), dtype=np.bool_)
    verdict[agent[hit]] = True
    return verdict
