"""Every hostile file is one sentence with its path, within seconds, and nothing of it stays behind."""

import os
import pickle
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch

from adapters.plan_file import read_plan_file
from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.datasets.tracks import read_recorded_tracks
from benchmark.errors import InputError
from benchmark.untrusted import children
from benchmark.untrusted.answers import UnencodableValueError, write_answer
from benchmark.untrusted.arrays import read_npz
from benchmark.untrusted.checkpoints import read_stored
from benchmark.untrusted.child import read_request
from benchmark.untrusted.children import read_pickle
from benchmark.untrusted.files import CHECKPOINT, MIB, NPZ, PICKLE, Limits, to_one_line
from benchmark.untrusted.http_images import read_picture
from benchmark.untrusted.text_files import read_json, read_json_lines
from benchmark.verification.golden_sets import GoldenArrays
from benchmark.weights.folders import read_checkpoint
from benchmark.weights.tensors import read_header, read_tensors
from generation.diffusion.checkpoint import load_denoiser
from tests.benchmark.datasets.test_scenarionet import recording
from tests.benchmark.untrusted.hostile_recordings import RECORDINGS
from tests.benchmark.untrusted.mutations import BYTES
from tests.benchmark.untrusted.variants import VARIANTS, Variant, write_sparse

SMALL = replace(PICKLE, memory_bytes=256 * MIB, cpu_s=1, clock_s=12.0)
WITHIN_S = 20.0


def small_pickle(path: Path) -> Any:
    return read_pickle(path, SMALL)


def small_checkpoint(path: Path) -> Any:
    return read_stored(path, replace(CHECKPOINT, memory_bytes=256 * MIB, cpu_s=1, clock_s=12.0))


READERS: dict[str, tuple[str, tuple[Callable[[Path], Any], ...]]] = {
    "pickle": (".pkl", (small_pickle,)),
    "checkpoint": (".pth", (small_checkpoint,)),
    "safetensors": (".safetensors", (read_tensors, load_denoiser)),
    "json": (".json", (read_json,)),
    "plans": (".csv", (read_plan_file,)),
    "json plans": (".json", (read_plan_file,)),
    "scenarionet": (".pkl", (read_scenarionet,)),
    "npz": (".npz", (GoldenArrays.read, read_recorded_tracks)),
}


def plan_rows() -> list[dict[str, Any]]:
    waypoints = {f"{axis}{step}": float(step) for step in range(1, 7) for axis in "xy"}
    return [{"sample_token": f"{number:032x}", "frame": "ego", **waypoints} for number in range(20)]


def valid_bytes(kind: str, folder: Path) -> bytes:
    """A file of a kind, as its reader takes it."""
    import pandas as pd

    path = folder / f"valid{READERS[kind][0]}"
    if kind == "pickle":
        path.write_bytes(pickle.dumps({"a": np.arange(9.0)}))
    elif kind == "checkpoint":
        torch.save({"w": torch.arange(16.0)}, path)
    elif kind == "safetensors":
        safetensors.torch.save_file({"w": torch.arange(16.0)}, path)
    elif kind == "plans":
        pd.DataFrame(plan_rows()).to_csv(path, index=False)
    elif kind == "scenarionet":
        path.write_bytes(pickle.dumps(recording()))
    elif kind == "npz":
        np.savez(path, x=np.arange(9.0))
    else:
        pd.DataFrame(plan_rows()).to_json(path, orient="records")
    return path.read_bytes()


def read_here(path: Path, kind: str, limits: Limits, request: tuple[str, ...], source: int, target: int) -> int:
    """What the child process does, in this one: a recording with odd values does not harm who reads it."""
    with os.fdopen(os.dup(source), "rb") as stream, os.fdopen(os.dup(target), "wb") as out:
        try:
            write_answer(out, read_request(kind, limits, stream, *request), limits)
        except UnencodableValueError as why:
            out.seek(0)
            out.truncate()
            write_answer(out, ("unanswerable", to_one_line(why)), limits)
    return 0


def each_variant() -> Iterator[Any]:
    """Every variant; of those that take a child process each, every third, and the others at night."""
    for place, each in enumerate((*VARIANTS, *RECORDINGS)):
        nightly = each.kind in ("pickle", "checkpoint") and place % 3 > 0
        marks = [pytest.mark.slow] if nightly else []
        yield pytest.param(each, id=f"{each.kind}: {each.name}", marks=marks)


@pytest.mark.parametrize("variant", [*each_variant()])
def test_a_hostile_file_is_one_sentence_within_seconds(
    tmp_path: Path, variant: Variant, monkeypatch: pytest.MonkeyPatch
) -> None:
    suffix, readers = READERS[variant.kind]
    if variant.kind == "scenarionet" and variant.name != "twenty thousand tracks":
        monkeypatch.setattr(children, "_run", read_here)
    path = tmp_path / f"hostile{suffix}"
    path.write_bytes(variant.change(valid_bytes(variant.kind, tmp_path)))
    for read in readers:
        start = time.monotonic()
        try:
            read(path)
            assert variant.harmless
        except InputError as error:
            said = str(error)
            assert str(path) in said and len(said.splitlines()) == 1 and len(said) < 800, said
            assert said.isprintable()
        assert time.monotonic() - start < WITHIN_S


def test_valid_files_are_read(tmp_path: Path) -> None:
    for kind, (suffix, readers) in READERS.items():
        path = tmp_path / f"fine{suffix}"
        path.write_bytes(valid_bytes(kind, tmp_path))
        assert readers[0](path) is not None


def test_files_of_20_gb_that_are_holes_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = write_sparse(tmp_path / "sparse", 20 << 30)
    before = time.monotonic()
    for read in (read_pickle, read_checkpoint, read_json, read_json_lines, read_npz):
        with pytest.raises(InputError, match=r"sparse has 20 GB, but a .* has at most"):
            read(path)
    with pytest.raises(InputError, match="cannot read"):
        read_header(path, instead="get it again")
    for name in ("plans.csv", "plans.json"):
        with pytest.raises(InputError, match="has 20 GB"):
            read_plan_file(path.rename(path.with_name(name)))
        path = path.with_name(name)
    assert time.monotonic() - before < WITHIN_S


def test_a_hole_of_less_is_not_read_to_its_end(tmp_path: Path) -> None:
    path = write_sparse(tmp_path / "table.json", 3 << 30)
    before = time.monotonic()
    for read in (read_json, read_json_lines, read_checkpoint):
        with pytest.raises(InputError):
            read(path)
    assert time.monotonic() - before < WITHIN_S


def test_arrays_that_unpack_to_more_than_they_may_are_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", x=np.zeros(1 << 18))
    assert (tmp_path / "a.npz").stat().st_size < MIB and len(read_npz(tmp_path / "a.npz")["x"]) == 1 << 18
    with pytest.raises(ValueError, match="unpacks to more than 1 MB"):
        read_npz(tmp_path / "a.npz", replace(NPZ, content_bytes=MIB))


def _png(width: int, height: int) -> bytes:
    """A PNG that declares a size and holds a few bytes."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(9))) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (_png(9_000, 9_000), "9000 x 9000 pixels are more than any camera has"),
        (_png(100_000, 100_000), "cannot be read"),
        (_png(0x7FFFFFFF, 1), "cannot be read"),
        (_png(0, 0), "cannot be read"),
        (_png(8, 8)[:-20], "cannot be read"),
        (b"\xff\xd8\xff\xe0" + bytes(50), "cannot be read"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "cannot be read"),
        (b"", "cannot be read"),
    ],
    ids=["large", "bomb", "wide", "empty", "cut", "no jpeg", "a program", "nothing"],
)
def test_a_picture_is_as_large_as_one_of_a_camera(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(InputError, match=says) as refusal:
        read_picture(path)
    assert str(path) in str(refusal.value) and len(str(refusal.value).splitlines()) == 1
    with pytest.raises(InputError, match="is missing"):
        read_picture(tmp_path / "none.jpg")


def test_a_name_that_is_no_text_is_one_printable_sentence(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/plans-\xff.csv"))
    path.write_bytes(b"a,b\n")
    for read in (read_plan_file, read_pickle, read_json, read_checkpoint, read_npz):
        with pytest.raises(InputError, match="is not UTF-8 text; rename the file") as refusal:
            read(path)
        assert str(refusal.value).isprintable() and str(refusal.value).encode()


def test_what_is_no_ordinary_file_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        for read in (read_pickle, read_checkpoint, read_json):
            with pytest.raises(InputError, match=f"cannot read {path}"):
                read(path)


def test_a_damaged_old_checkpoint_is_one_sentence_or_other_numbers(tmp_path: Path) -> None:
    path = tmp_path / "old.pth"
    tensors = {"a.weight": torch.arange(64.0).reshape(8, 8), "b": torch.ones(3, dtype=torch.float16)}
    torch.save({"state_dict": tensors, "meta": {"lr": 1}}, path, _use_new_zipfile_serialization=False)
    whole, chance = path.read_bytes(), Random(3)
    for _ in range(8):
        path.write_bytes(chance.choice(BYTES).change(whole, chance))
        try:
            for held in read_checkpoint(path).tensors.values():
                held.double().sum()
        except InputError as error:
            assert str(path) in str(error) and len(str(error).splitlines()) == 1
