from pathlib import Path

import pytest

from tests.benchmark.edited_roots import small_town


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene of the embedded town without images; tests edit copies of it."""
    return small_town(tmp_path_factory.mktemp("town") / "root")
