from pathlib import Path

import pytest

from benchmark.datasets.roots import DataSet
from tests.benchmark.extensions.challenge.small_entries import honest, recordings


@pytest.fixture(scope="session")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("challenge")


@pytest.fixture(scope="session")
def base(place: Path) -> DataSet:
    return recordings(place / "base")


@pytest.fixture(scope="session")
def entry(place: Path, base: DataSet) -> Path:
    return honest(place / "honest").root
