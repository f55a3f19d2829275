"""Networks are made once a session."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.benchmark.extensions.quality.small_networks import save_scoring_networks, save_small_networks


@pytest.fixture(scope="session")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with tiny random networks of every kind."""
    pytest.importorskip("transformers")
    return save_small_networks(tmp_path_factory.mktemp("networks"))


@pytest.fixture(scope="session")
def scoring_networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Those of them that score, which are quicker to make."""
    pytest.importorskip("transformers")
    folder = tmp_path_factory.mktemp("scoring")
    save_scoring_networks(folder)
    return folder


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
