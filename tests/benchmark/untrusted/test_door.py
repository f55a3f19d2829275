"""What is valid comes through the door as it is; what ends the child process is one sentence."""

import io
import pickle
import subprocess
import sys
import time
from collections import OrderedDict, defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import nn

from benchmark.errors import InputError
from benchmark.untrusted import children
from benchmark.untrusted.answers import UnencodableValueError, read_answer, write_answer
from benchmark.untrusted.child import read_request
from benchmark.untrusted.children import read_pickle
from benchmark.untrusted.files import JSON, MIB, PICKLE
from benchmark.untrusted.text_files import parse_json, read_json_lines
from benchmark.weights.folders import read_checkpoint

ROOT = Path(__file__).resolve().parents[3]


def through(value: Any) -> Any:
    stream = io.BytesIO()
    write_answer(stream, value, PICKLE)
    return read_answer(bytearray(stream.getvalue()))


def same(first: Any, second: Any) -> bool:
    if isinstance(first, np.ndarray):
        return (first.dtype, first.shape, first.tobytes()) == (second.dtype, second.shape, second.tobytes())
    return type(first) is type(second) and repr(first) == repr(second)


PLAIN = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary() | st.complex_numbers()
VALUES = st.recursive(
    PLAIN,
    lambda inner: (
        st.lists(inner)
        | st.lists(inner).map(tuple)
        | st.dictionaries(PLAIN.filter(lambda key: key == key), inner)
        | st.dictionaries(st.text(), inner).map(OrderedDict)
    ),
    max_leaves=12,
)


@settings(max_examples=40, deadline=None)
@given(VALUES)
def test_plain_values_come_back_as_they_were(value: Any) -> None:
    assert same(value, through(value))


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3), np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.arange(12)[::3], np.array(7),
        np.zeros((0, 3), np.float32), np.zeros((3, 0, 2)), np.array([True, False]), np.array(["a", "bcd"]),
        np.array([b"a", b"bc"]), np.arange(3, dtype=">f8"), np.array([1j, 2]), np.array([""]),
    ],
    ids=str,
)  # fmt: skip
def test_arrays_come_back_as_they_were_and_can_be_written_to(array: Any) -> None:
    found = through({"a": array, "again": array})
    assert same(array, found["a"]) and same(array, found["again"])
    assert found["a"].flags.writeable and found["a"].flags.f_contiguous == array.copy(order="K").flags.f_contiguous
    for number in array.reshape(-1)[:1]:
        assert same(number, through(number)) and type(through(number)) is type(number)


def test_what_no_recording_holds_is_not_answered() -> None:
    deep: list[Any] = []
    for _ in range(PICKLE.depth + 1):
        deep = [deep]
    for value, says in (
        (deep, "64 deep"),
        ({"a" * 5000: 1}, "name of more than"),
        (np.array([None]), "array of object"),
        (Path("x"), "PosixPath"),
        ("\ud800", "not Unicode"),
        (int, "type"),
    ):
        with pytest.raises(UnencodableValueError, match=says):
            through(value)
    with pytest.raises(UnencodableValueError, match="more than 10 values"):
        write_answer(io.BytesIO(), list(range(11)), replace(PICKLE, values=10))
    with pytest.raises(UnencodableValueError, match="more than 1000 bytes"):
        write_answer(io.BytesIO(), np.zeros(1000), replace(PICKLE, content_bytes=1000))
    assert through(defaultdict(list, a=[1]))["b"] == []


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_pickle_or_answer_never_breaks_the_reader(data: st.DataObject) -> None:
    whole = bytearray(pickle.dumps({"id": "x", "n": 3, "ts": np.arange(4.0), "set": {1, 2}, "t": (1, [2])}))
    for _ in range(data.draw(st.integers(0, 3))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    found = read_request("pickle", PICKLE, io.BytesIO(bytes(whole)))
    assert found[0] in ("value", "refused", "broken", "memory", "unanswerable")
    stream = io.BytesIO()
    write_answer(stream, ("value", {"ts": np.arange(4.0), "t": (1, [2])}), PICKLE)
    said = bytearray(stream.getvalue())
    said[data.draw(st.integers(0, len(said) - 1))] = data.draw(st.integers(0, 255))
    try:
        read_answer(said)
    except Exception as error:
        assert isinstance(error, Exception)


@pytest.mark.parametrize("legacy", [False, True])
def test_tensors_of_every_kind_are_those_of_pytorch(tmp_path: Path, legacy: bool) -> None:
    block = torch.arange(60.0).reshape(5, 12)
    tensors: dict[str, torch.Tensor] = {
        "rows": block[1:3], "turned": block.T, "steps": block[::2, ::3], "one": block[2, 2],
        "wide": block[:, :1].expand(5, 7), "none": torch.zeros(0, 3), "parameter": nn.Parameter(torch.ones(2)),
        "flags": torch.tensor([True, False]),
    }  # fmt: skip
    for name in ("float64", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8"):
        tensors[name] = torch.arange(7).to(getattr(torch, name))
    if not legacy:
        tensors["small"] = torch.arange(7.0).to(torch.float8_e4m3fn)
    path = tmp_path / "a.pth"
    content = {"state_dict": OrderedDict(tensors), "meta": {"shape": torch.Size([1]), "lr": np.float64(3), "b": {1, 2}}}
    torch.save(content, path, _use_new_zipfile_serialization=not legacy)
    found = read_checkpoint(path).tensors
    expected = torch.load(path, weights_only=False)["state_dict"]
    assert list(found) == list(tensors)
    for name, tensor in found.items():
        assert tensor.dtype == expected[name].dtype and tensor.shape == expected[name].shape, name
        assert torch.equal(tensor.double(), expected[name].detach().double()), name
    assert found["rows"].untyped_storage().data_ptr() == found["turned"].untyped_storage().data_ptr()
    before = path.read_bytes()
    found["rows"].zero_()
    assert path.read_bytes() == before


def test_the_numbers_of_another_byte_order_are_turned(tmp_path: Path) -> None:
    import zipfile

    torch.save({"w": torch.arange(4.0), "i": torch.arange(3)}, tmp_path / "little.pth")
    with zipfile.ZipFile(tmp_path / "little.pth") as little, zipfile.ZipFile(tmp_path / "big.pth", "w") as big:
        for entry in little.infolist():
            data = little.read(entry)
            if entry.filename.endswith("byteorder"):
                data = b"big"
            elif "/data/" in entry.filename:
                kind = ">f4" if entry.file_size == 16 else ">i8"
                data = np.frombuffer(data, kind.replace(">", "<")).astype(kind).tobytes()
            big.writestr(entry.filename, data)
    found = read_checkpoint(tmp_path / "big.pth").tensors
    assert found["w"].tolist() == [0, 1, 2, 3] and found["i"].tolist() == [0, 1, 2]


# --- the child process


def waiting(folder: Path, monkeypatch: pytest.MonkeyPatch, program: str) -> Path:
    """A valid pickle, and another program in the child's place."""
    monkeypatch.setattr(children, "_PROGRAM", program)
    path = folder / "a.pkl"
    path.write_bytes(pickle.dumps({"a": 1}))
    return path


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("import time; time.sleep(60)", "takes longer than"),
        ("import os; os.kill(os.getpid(), 11)", "signal SIGSEGV"),
        ("import os; os.kill(os.getpid(), 40)", "signal 40"),
        ("raise SystemExit(3)", r"exit status 3"),
        ("print('hello')", r"exit status 0"),
        ("import os; os.write(1, b'\\xff' * 64)", r"exit status 0"),
        ("", r"exit status 0"),
    ],
)
def test_the_death_of_the_child_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, says: str
) -> None:
    path = waiting(tmp_path, monkeypatch, program)
    start = time.monotonic()
    with pytest.raises(InputError, match=says) as refusal:
        read_pickle(path, replace(PICKLE, clock_s=1.0))
    assert str(path) in str(refusal.value) and len(str(refusal.value).splitlines()) == 1
    assert time.monotonic() - start < 10


def test_memory_that_is_not_given_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps({"a": np.zeros(100 * MIB, np.uint8)}))
    assert len(read_pickle(path)["a"]) == 100 * MIB
    with pytest.raises(InputError, match="takes more than 150 MB of memory"):
        read_pickle(path, replace(PICKLE, memory_bytes=150 * MIB))


def test_the_child_ends_with_its_parent(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(b"\x80\x02})" + b"2\x86" * 60 + b"Ns.")
    program = (
        "import sys; from pathlib import Path; from benchmark.untrusted.children import read_pickle; "
        "read_pickle(Path(sys.argv[1]))"
    )
    parent = subprocess.Popen([sys.executable, "-c", program, str(path)], cwd=ROOT)
    listed = Path(f"/proc/{parent.pid}/task/{parent.pid}/children")
    if not listed.exists():
        parent.kill()
        parent.wait()
        pytest.skip("this system does not list children")
    child = ""
    until = time.monotonic() + 30
    while not child and time.monotonic() < until:
        child = listed.read_text().strip()
    # Until it has said whom it ends with.
    while child and b"read_pickle" in Path(f"/proc/{child}/cmdline").read_bytes():
        time.sleep(0.01)
    time.sleep(2.0)
    parent.kill()
    parent.wait()
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < until:
        if Path(f"/proc/{child}/stat").read_text().split(")")[1].split()[0] == "Z":
            break
        time.sleep(0.05)
    assert child and time.monotonic() < until


# --- JSON


SIGNS = st.text('[]{}\\"a\u00e9\ud7ff')
JSON_VALUES = st.recursive(
    st.none() | st.integers(-9, 9) | SIGNS, lambda inner: st.lists(inner) | st.dictionaries(SIGNS, inner), max_leaves=30
)


@settings(deadline=None)
@given(JSON_VALUES)
@example({"]": [], "[][": None})
@example(['"[', '["', []])
def test_brackets_in_text_are_no_depth(value: Any) -> None:
    import json

    def depth(each: Any) -> int:
        inner = each.values() if isinstance(each, dict) else each if isinstance(each, list) else None
        return 0 if inner is None else 1 + max(map(depth, inner), default=0)

    for ascii_only in (True, False):
        data = json.dumps(value, ensure_ascii=ascii_only).encode()
        assert parse_json(data) == value
        assert parse_json(data, replace(JSON, depth=depth(value))) == value
        if depth(value):
            with pytest.raises(ValueError, match="deep"):
                parse_json(data, replace(JSON, depth=depth(value) - 1))


def test_lines_have_limits_and_numbers(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"a": 1}\n{"a": "' + "x" * 2000 + '"}\n')
    assert len(read_json_lines(path)) == 2
    with pytest.raises(InputError, match=r"rows\.jsonl line 2 is longer than 1 KB"):
        read_json_lines(path, replace(JSON, line_bytes=1024))
    with pytest.raises(ValueError, match="more than 3 values"):
        parse_json(b"[1, 2, 3, 4, 5]", replace(JSON, values=3))
