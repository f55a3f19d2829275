"""What measures and attacks the whole product is skipped, before it is imported, where an extension is missing."""

from pathlib import Path

import pytest

from tests.whole_product import ABSENT, REASON


class OfTheWhole(pytest.Module):
    """A module that is not imported."""

    def collect(self) -> list[pytest.Item | pytest.Collector]:
        pytest.skip(REASON)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Stand in for every module of this folder."""
    return OfTheWhole.from_parent(parent, path=module_path) if ABSENT else None
