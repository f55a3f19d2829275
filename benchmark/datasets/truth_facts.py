"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from typing import TYPE_CHECKING

from benchmark.datasets.scene_inputs import scene_inputs
from benchmark.records.run_schema import TruthFacts

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def truth_facts(data: "DataSet", name: str) -> TruthFacts:
    """Count what is annotated in a scene, and look at what else there is.

    Args:
        data: The data set.
        name: Scene name.

    Returns:
        The counts.

    Raises:
        InputError: If the scene is broken.
    """
    scene = data.scene(name)
    return TruthFacts(
        annotations=int(scene.annotations.valid.sum()), inputs=scene_inputs(scene, lidar=data.has_lidar(name))
    )
