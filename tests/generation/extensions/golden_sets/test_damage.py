"""Golden sets that are damaged, incomplete or of another kind: one sentence each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.errors import InputError
from generation.extensions.golden_sets.built_in import BUILT_IN
from tests.generation.extensions.golden_sets.golden_copies import VERIFY, copied, load, save


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


def garble(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[200:400] = bytes(200)
    path.write_bytes(data)


def pickled(path: Path) -> None:
    arrays = load(path)
    save(path, arrays | {next(iter(arrays)): np.array([{"a": 1}], dtype=object)})


def single_array(path: Path) -> None:
    np.save(path.with_suffix(".npy"), np.zeros(3))
    path.with_suffix(".npy").rename(path)


MAIN_FILE = {"physics": "physics.npz", "scoring": "crossing.npz", "denoiser": "parity.npz"}
ARRAY = {"physics": "center_pose", "scoring": "paper_dist", "denoiser": "noise"}


@pytest.mark.parametrize("kind", VERIFY)
@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (truncate, "whole npz file"),
        (garble, "golden numbers"),
        (pickled, "pickled"),
        (single_array, "not an npz file"),
        (lambda path: path.write_bytes(b""), "whole npz file"),
        (lambda path: path.write_text("no numbers"), "whole npz file"),
    ],
    ids=["truncated", "garbled", "pickled", "npy", "empty", "text"],
)
def test_damaged_files_are_one_sentence(kind: str, damage: Callable[[Path], None], word: str, tmp_path: Path) -> None:
    folder = copied(kind, tmp_path)
    damage(folder / MAIN_FILE[kind])
    with pytest.raises(InputError, match=word) as caught:
        VERIFY[kind](folder)
    assert MAIN_FILE[kind] in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", VERIFY)
def test_arrays_that_are_absent_or_no_numbers_are_one_sentence(kind: str, tmp_path: Path) -> None:
    folder = copied(kind, tmp_path)
    path, name = folder / MAIN_FILE[kind], ARRAY[kind]
    arrays = load(path)
    wrong = {
        "no array": {other: value for other, value in arrays.items() if other != name},
        "NaN": arrays | {name: np.where(np.arange(arrays[name].shape[-1]) == 0, np.nan, arrays[name])},
        "shape": arrays | {name: arrays[name][..., :-1]},
        "not numbers": arrays | {name: arrays[name].astype("U4")},
    }
    for word, changed in wrong.items():
        save(path, changed)
        with pytest.raises(InputError, match=f"(?s)({word}.*{name}|{name}.*{word})"):
            VERIFY[kind](folder)


@pytest.mark.parametrize("kind", VERIFY)
def test_a_directory_without_a_set_is_one_sentence(kind: str, tmp_path: Path) -> None:
    for folder, word in ((tmp_path / "nowhere", "not a directory"), (tmp_path, "has no")):
        with pytest.raises(InputError, match=word):
            VERIFY[kind](folder)
    with pytest.raises(InputError, match=f"did you mean .*{kind}"):
        VERIFY[kind](BUILT_IN)


@pytest.mark.parametrize(
    ("file", "name", "value", "word"),
    [
        ("physics/physics.npz", "group", np.full(8, 99), "do not fit"),
        ("physics/physics.npz", "group_columns", np.array(["center_x"]), "rear_x"),
        ("physics/physics.npz", "groups", np.zeros((8, 14)), "length 0 m"),
        ("physics/physics.npz", "groups", np.zeros((8, 3)), "do not fit"),
        ("scoring/crossing.npz", "raster", np.zeros((200, 199), np.bool_), "not square"),
        ("scoring/crossing.npz", "raster_affine_global_to_index", np.ones((2, 3)), "more than a turn"),
        ("scoring/crossing.npz", "ego_index", np.array(70), "do not fit"),
        ("scoring/crossing.npz", "candidates", np.zeros((48, 5, 3)), "12 after"),
        ("scoring/crossing.npz", "valid", np.zeros((13, 6)), "booleans"),
    ],
)
def test_inputs_that_do_not_fit_are_one_sentence(
    file: str, name: str, value: NDArray[Any], word: str, tmp_path: Path
) -> None:
    kind, _, rest = file.partition("/")
    path = copied(kind, tmp_path) / rest
    save(path, load(path) | {name: value})
    with pytest.raises(InputError, match=word):
        VERIFY[kind](path.parent)
