import shutil
from pathlib import Path

import pytest

from benchmark.extensions.golden_sets.protocols import BUILT_IN
from tests.benchmark.extensions.golden_sets import golden_further
from tests.benchmark.extensions.golden_sets.golden_protocols import CASES


@pytest.fixture(scope="session")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each scene of the protocols' set as a set of its own, and ``further``, one of the form that has roads."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in CASES:
        (folder / name).mkdir()
        for path in BUILT_IN.glob(f"{name}*.npz"):
            shutil.copy(path, folder / name)
    return {name: folder / name for name in CASES} | {"further": golden_further.write(folder / "further")}
