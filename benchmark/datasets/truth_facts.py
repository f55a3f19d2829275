"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from collections.abc import Sequence

from benchmark.datasets.scene_inputs import scene_inputs
from benchmark.datasets.steps import other_interval_us
from benchmark.records.run_schema import TruthFacts
from benchmark.scene import Scene
from benchmark.truth import SampleTruth


def truth_facts(scene: Scene, truths: Sequence[SampleTruth], *, lidar: bool) -> TruthFacts:
    """Count what is annotated in a scene and where key frames are no steps, and look at what else there is.

    Args:
        scene: The scene.
        truths: One for each sample of the scene, in time order.
        lidar: Whether its data set says where the lidar sits.

    Returns:
        The counts.
    """
    interval_us = other_interval_us([truth.timestamp_us for truth in truths])
    return TruthFacts(
        annotations=sum(int(truth.annotated[:, 0].sum()) for truth in truths),
        irregular=sum(truth.timed is not None for truth in truths),
        cut_short=sum(truth.by_clock.cut_short for truth in truths),
        interval_s=None if interval_us is None else round(interval_us * 1e-6, 6),
        inputs=scene_inputs(scene, lidar=lidar),
    )
