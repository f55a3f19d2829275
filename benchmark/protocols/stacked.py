"""Many samples as flat arrays: what the protocols compute on, without a loop over samples."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.truth import SampleTruth

_KEYFRAMES = PLAN_STEPS + 1


@dataclass(frozen=True, slots=True)
class StackedTruths:
    """S samples with M objects in all, those of a sample in a row (see `SampleTruth` for frame and units).

    Attributes:
        sample_of: (M,) which sample an object belongs to.
        instances: M instance identifiers; an object has one entry for each sample.
        categories: M category names.
        boxes: (M, 7, 5) boxes now and at the six steps.
        annotated: (M, 7) whether the object is annotated there.
        has_points: (M, 7) whether lidar or radar points were counted there.
        has_lidar_points: (M, 7) whether lidar points were.
        ego_future: (S, 6, 3) recorded lidar origin, x, y, yaw.
        ego_future_valid: (S, 6) whether it exists.
        adversarial: (M,) whether the object was made to be an adversary, as far as the data set says.
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

    def of_categories(self, names: Collection[str]) -> Bools:
        """Which objects are of certain categories.

        Args:
            names: nuScenes category names.

        Returns:
            (M,) verdicts.
        """
        return np.fromiter((name in names for name in self.categories), np.bool_, count=len(self.categories))


def stack(truths: Sequence[SampleTruth]) -> StackedTruths:
    """Samples one after the other.

    Args:
        truths: S samples.

    Returns:
        Their arrays.
    """
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
    )


def displacement(plans_lidar: Floats, truths: StackedTruths) -> Floats:
    """Distance from the recorded ego at each step, 0 where that does not exist.

    Args:
        plans_lidar: (S, 6, 2) waypoints, metres.
        truths: S samples.

    Returns:
        (S, 6) metres.
    """
    offset = plans_lidar - truths.ego_future[..., :2]
    return np.where(truths.ego_future_valid, np.hypot(offset[..., 0], offset[..., 1]), 0.0)
