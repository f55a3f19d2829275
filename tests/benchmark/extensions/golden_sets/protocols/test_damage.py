"""Golden sets of the protocols that are damaged, incomplete or of another kind: one sentence each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.protocols import BUILT_IN, verify_protocols
from tests.benchmark.extensions.golden_sets.protocols.test_verification import change, copied, load

__all__ = ["copied"]

FILES = ("gtcol-ghost.npz", "gtcol-ghost_official.npz", "gtcol-ghost_exact.npz")


def refused(folder: Path, word: str) -> str:
    with pytest.raises(InputError, match=word) as caught:
        verify_protocols(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


def garble(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[200:400] = bytes(200)
    path.write_bytes(data)


def single_array(path: Path) -> None:
    np.save(path.with_suffix(".npy"), np.zeros(3))
    path.with_suffix(".npy").rename(path)


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (truncate, "whole npz file"),
        (garble, "golden numbers"),
        (single_array, "not an npz file"),
        (lambda path: path.write_bytes(b""), "whole npz file"),
        (lambda path: path.write_text("no numbers"), "whole npz file"),
    ],
    ids=["truncated", "garbled", "npy", "empty", "text"],
)
def test_damaged_files_are_one_sentence(file: str, damage: Callable[[Path], None], word: str, copied: Path) -> None:
    damage(copied / file)
    assert file in refused(copied, word)


@pytest.mark.parametrize(
    ("file", "array"),
    [
        ("gtcol-ghost.npz", "plans"),
        ("gtcol-ghost.npz", "ego_fut"),
        ("gtcol-ghost.npz", "obj_box"),
        ("gtcol-ghost.npz", "obj_size"),
        ("gtcol-ghost_official.npz", "uniad_L2"),
        ("gtcol-ghost_official.npz", "vad_obj_box_col"),
        ("gtcol-ghost_official.npz", "vad23_obj_col"),
        ("gtcol-ghost_official.npz", "sd_obj_box_col"),
        ("gtcol-ghost_exact.npz", "heading"),
    ],
)
def test_numbers_that_are_absent_or_none_are_one_sentence(file: str, array: str, copied: Path) -> None:
    values = load(copied / file)[array]
    poisoned = values.copy()
    poisoned.reshape(-1)[3] = np.nan
    wrong = {"no array": None, "NaN": poisoned, "shape": values[..., :-1], "not numbers": values.astype("U4")}
    for word, replacement in wrong.items():
        change(copied / file, **{array: replacement})
        message = refused(copied, word)
        assert array in message and file in message


@pytest.mark.parametrize(
    ("array", "value", "word"),
    [
        ("obj_offset", np.zeros(12, np.int32), "obj_offset .* does not divide"),
        ("obj_offset", np.array([0, *[50] * 10, 41]), "obj_offset .* does not divide"),
        ("obj_class", np.full(49, 77), "without a name"),
        ("obj_size", np.zeros((49, 2)), "without a size"),
        ("command", np.full(11, 5), "unknown command"),
        ("ego_fut_valid", np.tile([True, False, True, True, True, True], (11, 1)), "gaps"),
        ("ego_fut_valid", np.ones((11, 6)), "booleans"),
        ("plans", np.zeros((11, 0, 6, 2)), "no samples or no plans"),
        ("plans", np.zeros((0, 8, 6, 2)), "no samples or no plans"),
        ("plans", np.full((11, 8, 6, 2), 1e300), "beyond 10 km"),
        ("obj_size", np.full((49, 2), 1e9), "beyond 10 km"),
        ("plan_names", np.array(["a"] * 8), "a name twice"),
        ("plan_names", np.array(["a"]), "plan_names"),
        ("plan_names", np.arange(8), "not names"),
    ],
)
def test_inputs_that_do_not_fit_are_one_sentence(array: str, value: NDArray[Any], word: str, copied: Path) -> None:
    path = copied / "gtcol-ghost.npz"
    count = len(load(path)["obj_class"])
    sized = np.resize(value, (count, *value.shape[1:])) if array in ("obj_class", "obj_size") else value
    change(path, **{array: sized})
    assert "gtcol-ghost.npz" in refused(copied, word)


@pytest.mark.parametrize(
    ("array", "value", "word"),
    [
        ("uniad_obj_box_col", np.full((11, 8, 6), 0.5), "other than 0 and 1"),
        ("uniad_raw_box", np.zeros((11, 8, 6)), "booleans"),
        ("uniad_seg_bits", np.full((11, 6, 5000), 300), "no bytes"),
        ("uniad_seg_bits", np.zeros((11, 6, 5000)), "whole numbers"),
        ("vad_seg_bits", np.zeros((11, 6, 200), np.uint8), "shape"),
    ],
)
def test_verdicts_that_do_not_fit_are_one_sentence(array: str, value: NDArray[Any], word: str, copied: Path) -> None:
    change(copied / "gtcol-ghost_official.npz", **{array: value})
    assert array in refused(copied, word)


def test_a_directory_without_a_set_is_one_sentence(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere", "not a directory")
    refused(tmp_path, r"has no \*_official\.npz")
    refused(BUILT_IN.parent, "did you mean .*protocols")


@pytest.mark.parametrize("absent", FILES[:2])
def test_half_a_scene_is_one_sentence(absent: str, copied: Path) -> None:
    for file in FILES[:2]:
        (copied / f"scene-{file}").write_bytes((copied / file).read_bytes())
    (copied / f"scene-{absent}").unlink()
    refused(copied, f"has no scene-{absent}")


def test_a_manifest_that_is_no_json_is_one_sentence(copied: Path) -> None:
    (copied / "manifest.json").write_text("{")
    assert "manifest.json" in refused(copied, "manifest")
