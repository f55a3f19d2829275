"""Which weights the measurement needs."""

from benchmark.extensions.quality.definition import needed_for
from benchmark.weights.catalogue import FOLDERS


def test_the_weights_of_quality_are_complete() -> None:
    assert [weights.name for weights in needed_for("boxes")] == ["dino-vitb16", "musiq-spaq"]
    for weights in needed_for("grounded-sam2"):
        assert weights in FOLDERS and weights.revision != "main"
