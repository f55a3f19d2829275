"""Which weights the measurement needs."""

from benchmark.extensions.quality.definition import list_required_weights
from benchmark.weights.catalogue import FOLDERS


def test_the_weights_of_quality_are_complete() -> None:
    assert [weights.name for weights in list_required_weights("boxes")] == ["dino-vitb16", "musiq-spaq"]
    for weights in list_required_weights("grounded-sam2"):
        assert weights in FOLDERS and weights.revision != "main"
