"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.datasets.categories import KNOWN
from benchmark.datasets.labelled import labelled_keyframes
from benchmark.records.run_schema import TruthFacts
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

MOTIONLESS_S: Final = 5.0
"""A scene at least so long in which the ego pose is the same number throughout has most likely none. A car that waits
is never so still: its recorded pose trembles by hundredths of a millimetre."""


def truth_facts(data: "DataSet", name: str) -> TruthFacts:
    """Count what is annotated in a scene.

    Args:
        data: The data set.
        name: Scene name.

    Returns:
        The counts.

    Raises:
        InputError: If the scene is broken.
    """
    scene = data.scene(name)
    valid = scene.annotations.valid
    unknown: Counter[str] = Counter()
    for category, there in zip(scene.agents.categories, valid.sum(axis=1).tolist(), strict=True):
        if category not in KNOWN:
            unknown[category] += there
    labelled = labelled_keyframes(valid.sum(axis=0))
    return TruthFacts(
        annotations=int(valid.sum()),
        unlabelled=sum(not labelled[now : now + PLAN_STEPS + 1].all() for now in range(len(labelled))),
        without_size=data.annotation_counts([name])[name].annotations - int(valid.sum()),
        unknown=dict(sorted(unknown.items())),
        motionless=_motionless(scene),
    )


def counted_truth(data: "DataSet", names: Sequence[str]) -> dict[str, TruthFacts]:
    """What tables say of the truth of scenes, without reading a scene.

    Args:
        data: The data set.
        names: Scene names.

    Returns:
        The counts by name; what takes a reading is null.
    """
    counts = data.annotation_counts(names)
    return {
        name: TruthFacts(annotations=each.annotations, unknown=dict(sorted(each.unknown.items())))
        for name, each in counts.items()
    }


def _motionless(scene: Scene) -> bool:
    seconds = scene.seconds[scene.keyframes]
    poses = np.unique(scene.ego.pose[scene.keyframes], axis=0)
    return bool(seconds[-1] - seconds[0] >= MOTIONLESS_S and len(poses) == 1)
