"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.datasets.categories import KNOWN
from benchmark.datasets.labelled import labelled_keyframes
from benchmark.datasets.scene_inputs import scene_inputs
from benchmark.datasets.steps import other_interval_us
from benchmark.records.run_schema import TruthFacts
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

MOTIONLESS_S: Final = 5.0
"""A scene at least so long in which the ego pose is the same number throughout has most likely none. A car that waits
is never so still: its recorded pose trembles by hundredths of a millimetre."""


def truth_facts(data: "DataSet", name: str, truths: Sequence[SampleTruth]) -> TruthFacts:
    """Count annotations in a scene and key frames that are no steps, and look at all other inputs.

    Args:
        truths: One for each sample of the scene, in time order.
    """
    scene = data.scene(name)
    valid = scene.annotations.valid
    unknown: Counter[str] = Counter()
    for category, there in zip(scene.agents.categories, valid.sum(axis=1).tolist(), strict=True):
        if category not in KNOWN:
            unknown[category] += there
    interval_us = other_interval_us([truth.timestamp_us for truth in truths])
    labelled = labelled_keyframes(valid.sum(axis=0))
    return TruthFacts(
        annotations=int(valid.sum()),
        unlabelled=sum(not labelled[now : now + PLAN_STEPS + 1].all() for now in range(len(labelled))),
        without_size=data.annotation_counts([name])[name].annotations - int(valid.sum()),
        unknown=dict(sorted(unknown.items())),
        motionless=_motionless(scene),
        irregular=sum(truth.timed is not None for truth in truths),
        cut_short=sum(truth.by_clock.cut_short for truth in truths),
        interval_s=None if interval_us is None else round(interval_us * 1e-6, 6),
        inputs=scene_inputs(scene, lidar=data.has_lidar(name)),
    )


def _motionless(scene: Scene) -> bool:
    seconds = scene.seconds[scene.keyframes]
    poses = np.unique(scene.ego.pose[scene.keyframes], axis=0)
    return bool(seconds[-1] - seconds[0] >= MOTIONLESS_S and len(poses) == 1)
