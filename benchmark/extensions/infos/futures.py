"""Where annotated objects go, in the two ways in which the repositories follow them."""

from typing import Any, Final

import numpy as np

from benchmark.constants import KEYFRAME_HZ, PLAN_STEPS
from benchmark.extensions.infos.boxes import NO_BOX, Indices, SceneBoxes
from benchmark.extensions.infos.frames import SensorFrame, heading, turned
from benchmark.geometry import Bools, Floats

_MARGIN_S: Final = 0.15
"""By which nuscenes-devkit lets a future reach beyond what was asked for."""
_STANDS_M: Final = 1.0
_GOALS: Final = 8
STATIC_GOAL: Final = 9


def in_own_frame(boxes: SceneBoxes, here: Indices, seconds: int) -> tuple[Floats, Bools]:
    """Future positions of objects as nuscenes-devkit's ``PredictHelper`` gives them.

    Entries are packed: where a track has a hole, later positions stand in earlier places.

    Returns:
        (N, 2 seconds, 2) positions in the frame of each object now, x to its right and y ahead, 0 where there are none;
        (N, 2 seconds) which there are.
    """
    chain = boxes.following(here, seconds * KEYFRAME_HZ)
    elapsed_s = np.abs(boxes.time_us[chain] - boxes.time_us[here][:, None]) / 1e6
    there = np.logical_and.accumulate((chain != NO_BOX) & (elapsed_s < seconds + _MARGIN_S), axis=1)
    moved = (boxes.position[chain] - boxes.position[here][:, None])[..., :2]
    own = turned(moved, (np.pi / 2 - heading(boxes.rotation[here]))[:, None])
    return np.where(there[..., None], own, 0.0), there


def offsets_from_own_frame(boxes: SceneBoxes, here: Indices, lidar: SensorFrame, seconds: int) -> tuple[Floats, Bools]:
    """Offsets step by step in the frame of the lidar, as SparseDrive's converter turns `in_own_frame` back.

    It turns by the heading in the global frame and back by that in the lidar frame, which differ for tilted boxes.

    Returns:
        (N, 2 seconds, 2) offsets, 0 where there are none; (N, 2 seconds) which there are.
    """
    own, there = in_own_frame(boxes, here, seconds)
    back = heading(lidar.local_rotation(boxes.rotation[here])) - np.pi / 2
    centre = lidar.local(boxes.position[here])[:, None, :2]
    path = np.concatenate([centre, turned(own, back[:, None]) + centre], axis=1)
    return np.where(there[..., None], np.diff(path, axis=1), 0.0), there


def vad_futures(boxes: SceneBoxes, here: Indices, lidar: SensorFrame) -> dict[str, Any]:
    """VAD's futures of N objects: the next annotation is the next step, however long the gap.

    Returns:
        ``gt_agent_fut_trajs`` (N, 12), ``gt_agent_fut_masks``, ``gt_agent_fut_yaw`` (N, 6), ``gt_agent_fut_goal`` (N,),
        all in double precision.
    """
    chain = boxes.following(here, PLAN_STEPS)
    there = chain != NO_BOX
    path = np.concatenate([here[:, None], chain], axis=1)
    position = lidar.local(boxes.position[path])[..., :2]
    angle = heading(lidar.local_rotation(boxes.rotation[path]))
    offsets = np.where(there[..., None], np.diff(position, axis=1), 0.0)
    return {
        "gt_agent_fut_trajs": offsets.reshape(len(here), 2 * PLAN_STEPS),
        "gt_agent_fut_masks": there.astype(np.float64),
        # Differences are not wrapped: a heading that passes half a turn jumps by a whole one.
        "gt_agent_fut_yaw": np.where(there, np.diff(angle, axis=1), 0.0),
        "gt_agent_fut_goal": goals(offsets),
    }


def goals(offsets: Floats) -> Floats:
    """Classes of where objects go, from (N, 6, 2) offsets: (N,) eighths of a turn 0 to 8, or 9 for those that stand.

    An object stands if neither coordinate grows by a metre; growing is meant with its sign, so that one that goes 20 m
    to the left and back stands, too.
    """
    moved = np.cumsum(offsets, axis=1)
    moved = moved[:, -1] - moved[:, 0]
    eighth = np.floor((np.arctan2(moved[:, 1], moved[:, 0]) + np.pi) / (2 * np.pi / _GOALS))
    return np.where(moved.max(axis=1) < _STANDS_M, STATIC_GOAL, eighth)
