"""Many samples as flat arrays: what the protocols compute on, without a loop over samples."""

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, fields
from operator import is_
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, to_global, to_local, wrap_angle
from benchmark.truth import Roads, SampleTruth

_KEYFRAMES = PLAN_STEPS + 1


@dataclass(frozen=True, slots=True)
class StackedTruths:
    """S samples with M objects in all, those of a sample in a row (see `SampleTruth` for frame and units).

    Attributes:
        sample_of: (M,) which sample an object belongs to.
        instances: M instance identifiers; an object has one entry for each sample.
        boxes: (M, 7, 5) boxes now and at the six steps; ``annotated`` is (M, 7).
        has_points: (M, 7) whether lidar or radar points were counted there; ``has_lidar_points`` leaves out radar.
        ego_future: (S, 6, 3) recorded lidar origin, x, y, yaw; ``ego_future_valid`` is (S, 6).
        adversarial: (M,) whether the object was made to be an adversary, as far as the data set says.
        seen_before: (M,) whether the object was seen now or in the second before (`SampleTruth.seen_before`).
        axle_poses: (S, 7, 3) global x, y, yaw of the rear axle now and at the steps.
        ahead_m: (S,) lidar origin ahead of the rear axle.
        keyframes_before: (S,) earlier keyframes of the scene.
        kept: Answers of `of_categories`.
    """

    sample_of: NDArray[np.int64]
    instances: tuple[str, ...]
    categories: tuple[str, ...]
    boxes: Floats
    annotated: Bools
    has_points: Bools
    has_lidar_points: Bools
    ego_future: Floats
    ego_future_valid: Bools
    adversarial: Bools
    seen_before: Bools
    axle_poses: Floats
    ahead_m: Floats
    keyframes_before: NDArray[np.int64]
    roads: tuple[Roads | None, ...]
    kept: dict[frozenset[str], Bools] = field(default_factory=dict, repr=False, compare=False)

    def of_categories(self, names: Collection[str]) -> Bools:
        """(M,) which objects are of certain nuScenes categories."""
        key = frozenset(names)
        if key not in self.kept:
            self.kept[key] = np.fromiter((name in key for name in self.categories), np.bool_, len(self.categories))
            self.kept[key].flags.writeable = False
        return self.kept[key]

    @property
    def axle_future(self) -> Floats:
        """(S, 6, 2) recorded rear axle at the steps in the ego frame of the sample, x forward, y left, metres."""
        return to_local(self.axle_poses[:, 1:, :2], self.axle_poses[:, :1])

    def boxes_in_ego(self, objects: NDArray[np.int64], steps: NDArray[np.int64]) -> Floats:
        """(N, 5) boxes at steps 0..6 in the ego frame of their samples: x forward, y left of the rear axle."""
        boxes = self.boxes[objects, steps]
        ahead = self.ahead_m[self.sample_of[objects]]
        center = np.stack([boxes[:, 1] + ahead, -boxes[:, 0]], axis=-1)
        return np.concatenate([center, boxes[:, 2:4], boxes[:, 4:] - np.pi / 2], axis=-1)


def stack(truths: Sequence[SampleTruth]) -> StackedTruths:
    """Samples one after the other in read-only arrays: the last ones are not stacked again for the next protocol."""
    for known, stacked in _LAST:
        if len(known) == len(truths) and all(map(is_, known, truths)):
            return stacked
    stacked = _stack_truths(truths)
    for column in fields(stacked):
        values = getattr(stacked, column.name)
        if isinstance(values, np.ndarray):
            values.flags.writeable = False
    _LAST.append((tuple(truths), stacked))
    return stacked


_LAST: Final[deque[tuple[tuple[SampleTruth, ...], StackedTruths]]] = deque(maxlen=1)


def _stack_truths(truths: Sequence[SampleTruth]) -> StackedTruths:
    counts = [len(truth.instances) for truth in truths]
    empty = np.zeros((0, _KEYFRAMES), dtype=np.bool_)
    return StackedTruths(
        sample_of=np.repeat(np.arange(len(truths)), counts),
        instances=tuple(name for truth in truths for name in truth.instances),
        categories=tuple(name for truth in truths for name in truth.categories),
        boxes=np.concatenate([np.zeros((0, _KEYFRAMES, 5)), *(truth.boxes for truth in truths)]),
        annotated=np.concatenate([empty, *(truth.annotated for truth in truths)]),
        has_points=np.concatenate([empty, *(truth.has_points for truth in truths)]),
        has_lidar_points=np.concatenate([empty, *(truth.has_lidar_points for truth in truths)]),
        ego_future=np.array([truth.ego_future for truth in truths], np.float64).reshape(-1, PLAN_STEPS, 3),
        ego_future_valid=np.array([truth.ego_future_valid for truth in truths], np.bool_).reshape(-1, PLAN_STEPS),
        adversarial=np.array([name in truth.adversaries for truth in truths for name in truth.instances], np.bool_),
        seen_before=np.concatenate(
            [empty[:, 0], *(t.annotated[:, 0] if t.seen_before is None else t.seen_before for t in truths)]
        ),
        axle_poses=np.array([_axle_poses(truth) for truth in truths], np.float64).reshape(-1, _KEYFRAMES, 3),
        ahead_m=np.array([truth.lidar_ahead_m for truth in truths], np.float64),
        keyframes_before=np.array([truth.index for truth in truths], np.int64),
        roads=tuple(truth.roads for truth in truths),
    )


def _axle_poses(truth: SampleTruth) -> Floats:
    """(7, 3) rear axle now and at the steps; from the lidar's poses where a sample does not have them itself."""
    if truth.axle_poses is not None:
        return truth.axle_poses
    now = np.array([[0.0, 0.0, np.pi / 2]])
    local = np.concatenate([now, truth.ego_future])
    yaw = wrap_angle(local[:, 2] - np.pi / 2 + truth.lidar_pose[2])
    lidar = to_global(np.stack([local[:, 1], -local[:, 0]], axis=-1), truth.lidar_pose)
    axle = lidar - truth.lidar_ahead_m * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.concatenate([axle, yaw[:, None]], axis=-1)


def compute_displacement(plans_lidar: Floats, truths: StackedTruths) -> Floats:
    """(S, 6) metres from the recorded ego at each step, 0 where that does not exist."""
    offset = plans_lidar - truths.ego_future[..., :2]
    return np.where(truths.ego_future_valid, np.hypot(offset[..., 0], offset[..., 1]), 0.0)
