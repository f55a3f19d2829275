"""Golden sets that are damaged, incomplete or of another kind: one sentence each."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from generation.extensions.golden_sets.built_in import BUILT_IN
from tests.benchmark.verification.damaged import refuses, said
from tests.generation.extensions.golden_sets.golden_copies import VERIFY, copied, load, save

ARRAY = {
    "physics": ("physics.npz", "center_pose"),
    "scoring": ("crossing.npz", "paper_dist"),
    "denoiser": ("parity.npz", "noise"),
}


@pytest.mark.parametrize("kind", ["physics", "denoiser"])
def test_damaged_sets_are_one_sentence(kind: str, tmp_path: Path) -> None:
    refuses(VERIFY[kind], BUILT_IN / kind, *ARRAY[kind], tmp_path)


def test_a_damaged_frame_of_scores_is_one_sentence(tmp_path: Path) -> None:
    """A set may have any number of frames, but must have one."""
    (tmp_path / "scoring").mkdir()
    save(tmp_path / "scoring" / "crossing.npz", load(BUILT_IN / "scoring" / "crossing.npz"))
    refuses(VERIFY["scoring"], tmp_path / "scoring", *ARRAY["scoring"], tmp_path / "work")


@pytest.mark.parametrize("kind", VERIFY)
def test_a_folder_of_sets_says_which_is_meant(kind: str) -> None:
    assert f"did you mean {BUILT_IN / kind}" in said(VERIFY[kind], BUILT_IN)


@pytest.mark.parametrize(
    ("file", "name", "value"),
    [
        ("physics/physics.npz", "group", np.full(8, 99)),
        ("physics/physics.npz", "group_columns", np.array(["center_x"])),
        ("physics/physics.npz", "groups", np.zeros((8, 14))),
        ("physics/physics.npz", "groups", np.zeros((8, 3))),
        ("scoring/crossing.npz", "raster", np.zeros((200, 199), np.bool_)),
        ("scoring/crossing.npz", "raster_affine_global_to_index", np.ones((2, 3))),
        ("scoring/crossing.npz", "ego_index", np.array(70)),
        ("scoring/crossing.npz", "candidates", np.zeros((48, 5, 3))),
        ("scoring/crossing.npz", "valid", np.zeros((13, 6))),
    ],
)
def test_inputs_that_do_not_fit_are_one_sentence(file: str, name: str, value: NDArray[Any], tmp_path: Path) -> None:
    kind, _, rest = file.partition("/")
    path = copied(kind, tmp_path) / rest
    save(path, load(path) | {name: value})
    said(VERIFY[kind], path.parent)
