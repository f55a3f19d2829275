"""Tensors with facts: the same bytes for the same content, read back whole, refused in one sentence."""

import pickle
from pathlib import Path

import pytest
import torch

from benchmark.errors import InputError
from benchmark.untrusted.children import read_pickle
from benchmark.weights.tensors import read_header, read_tensors, write_tensors


def test_tensors_and_facts_come_back_and_give_the_same_bytes(tmp_path: Path) -> None:
    block = torch.arange(6.0).reshape(2, 3)
    tensors = {"b": block[:, 1], "a": block.T, "none": torch.zeros(0, 2)}
    paths = [tmp_path / name for name in ("one.safetensors", "two.safetensors")]
    for path, order in zip(paths, (list(tensors), sorted(tensors)), strict=True):
        write_tensors(path, {name: tensors[name] for name in order}, {"seed": 1, "of": ["x"]})
    assert paths[0].read_bytes() == paths[1].read_bytes()
    held, facts = read_tensors(paths[0])
    assert facts == {"seed": 1, "of": ["x"]} and all(torch.equal(held[name], tensors[name]) for name in tensors)
    assert read_header(paths[0], instead="") == ({"a": (3, 2), "b": (2,), "none": (0, 2)}, facts)
    assert read_tensors(paths[0], entry="another kind")[1] == {}


def test_broken_files_are_one_sentence_that_says_what_to_do(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_tensors(path, {"a": torch.zeros(9)}, {})
    path.write_bytes(path.read_bytes()[:-4])
    for broken in (path, tmp_path / "absent"):
        with pytest.raises(InputError, match=r"^cannot read weights from .*; fetch or make the file again$"):
            read_tensors(broken)
        with pytest.raises(InputError, match=r"^cannot read anchors in .*; make them$"):
            read_tensors(broken, what="anchors in ", instead="make them")
        with pytest.raises(InputError, match=r"^cannot read weights from .*; try again$"):
            read_header(broken, instead="try again")


def test_a_recording_may_not_hold_tensors(tmp_path: Path) -> None:
    (tmp_path / "b.pkl").write_bytes(pickle.dumps({"a": torch.zeros(1)}))
    with pytest.raises(InputError, match=r"is refused: its pickle uses torch\._utils"):
        read_pickle(tmp_path / "b.pkl")
