"""Golden sets of the protocols that are damaged, incomplete or of another kind: one sentence each."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.protocols import BUILT_IN, GOLDEN
from tests.benchmark.extensions.golden_sets.protocols.test_verification import change, copied
from tests.benchmark.verification.damaged import refuses, said

__all__ = ["copied"]

FILES = ("gtcol-ghost.npz", "gtcol-ghost_official.npz")


@pytest.mark.parametrize(
    ("file", "array"), [("gtcol-ghost.npz", "obj_box"), ("gtcol-ghost_official.npz", "vad_obj_box_col")]
)
def test_damaged_sets_are_one_sentence(file: str, array: str, copied: Path, tmp_path: Path) -> None:
    refuses(GOLDEN.verify, copied, file, array, tmp_path / "work")


@pytest.mark.parametrize(
    ("file", "array", "value"),
    [
        ("gtcol-ghost.npz", "command", np.full(11, 5)),
        ("gtcol-ghost.npz", "ego_fut_valid", np.ones((11, 6))),
        ("gtcol-ghost.npz", "plans", np.zeros((11, 0, 6, 2))),
        ("gtcol-ghost.npz", "plan_names", np.arange(8)),
        ("gtcol-ghost_official.npz", "uniad_raw_box", np.zeros((11, 8, 5))),
        ("gtcol-ghost_official.npz", "vad_seg_bits", np.zeros((11, 6, 200), np.uint8)),
        ("gtcol-ghost_exact.npz", "heading", None),
    ],
)
def test_arrays_that_do_not_fit_are_one_sentence(
    file: str, array: str, value: NDArray[Any] | None, copied: Path
) -> None:
    change(copied / file, **{array: value})
    said(GOLDEN.verify, copied)


def test_a_folder_of_sets_says_which_is_meant() -> None:
    assert f"did you mean {BUILT_IN}" in said(GOLDEN.verify, BUILT_IN.parent)


@pytest.mark.parametrize("absent", FILES)
def test_half_a_scene_is_one_sentence(absent: str, copied: Path) -> None:
    for file in FILES:
        (copied / f"scene-{file}").write_bytes((copied / file).read_bytes())
    (copied / f"scene-{absent}").unlink()
    assert f"it has no scene-{absent}" in said(GOLDEN.verify, copied)


@pytest.mark.parametrize("text", ["{", "[1]", '{"made": "today"}'])
def test_a_manifest_of_another_form_is_one_sentence(text: str, copied: Path) -> None:
    (copied / "manifest.json").write_text(text)
    said(GOLDEN.verify, copied)
