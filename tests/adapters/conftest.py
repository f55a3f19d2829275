"""What a checkpoint has to hold for each model is found out once."""

from collections.abc import Iterator, Mapping, Sequence

import pytest
from torch import Tensor

from adapters.checkpoints import checkpoint_import
from adapters.models import Model


@pytest.fixture(scope="session", autouse=True)
def expected_tensors_are_found_out_once() -> Iterator[None]:
    """An import compares with every model, and building one without memory takes a second: its settings decide it."""
    build, found = checkpoint_import.expected_tensors, dict[str, dict[str, Tensor]]()

    def expected_tensors(model: Model, shapes: Mapping[str, Sequence[int]]) -> dict[str, Tensor]:
        key = repr((model.net.build, model.configuration(shapes), model.net.settings, model.net.seeded))
        if key not in found:
            found[key] = build(model, shapes)
        return dict(found[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checkpoint_import, "expected_tensors", expected_tensors)
        yield
