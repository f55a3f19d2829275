"""What a data set holds of the truth of a scene, so that a record can say which of its numbers rest on nothing."""

from collections.abc import Sequence

from benchmark.records.run_schema import TruthFacts
from benchmark.truth import SampleTruth


def truth_facts(truths: Sequence[SampleTruth]) -> TruthFacts:
    """Count what is annotated in a scene.

    Args:
        truths: One for each sample of the scene, in time order.

    Returns:
        The counts.
    """
    return TruthFacts(annotations=sum(int(truth.annotated[:, 0].sum()) for truth in truths))
