"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from collections.abc import Sequence

from benchmark.datasets.scene_inputs import scene_inputs
from benchmark.records.run_schema import TruthFacts
from benchmark.scene import Scene
from benchmark.truth import SampleTruth


def truth_facts(scene: Scene, truths: Sequence[SampleTruth], *, lidar: bool) -> TruthFacts:
    """Count what is annotated in a scene, and look at what else there is.

    Args:
        scene: The scene.
        truths: One for each sample of the scene, in time order.
        lidar: Whether its data set says where the lidar sits.

    Returns:
        The counts.
    """
    annotations = sum(int(truth.annotated[:, 0].sum()) for truth in truths)
    return TruthFacts(annotations=annotations, inputs=scene_inputs(scene, lidar=lidar))
