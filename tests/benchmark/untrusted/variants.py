"""Hostile files, by kind and name: each is made of a valid one, so that tests and a campaign can share them."""

import io
import json
import os
import pickle
import struct
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True, slots=True)
class Variant:
    """One attack on a kind of file: the hostile bytes from those of a valid one, which may be harmless to read."""

    kind: str
    name: str
    change: Callable[[bytes], bytes]
    harmless: bool = False


def _pickled(body: bytes) -> bytes:
    return b"\x80\x02" + body + b"."


def _colliding(count: int) -> bytes:
    """A set of whole numbers that all have one hash."""
    numbers = (((1 << 61) - 1) * number for number in range(1, count))
    packed = (number.to_bytes(11, "little") for number in numbers)
    return b"\x80\x04\x8f(" + b"".join(b"\x8a\x0b" + number for number in packed) + b"\x90."


DEPTH = 100_000
DEEP = "[" * DEPTH + "]" * DEPTH
PICKLES = (
    Variant("pickle", "lists nested 10^5 deep", lambda _: _pickled(b"]" * DEPTH + b"a" * (DEPTH - 1))),
    Variant("pickle", "tuples nested 10^6 deep as a key", lambda _: _pickled(b"})" + b"\x85" * 1_000_000 + b"Ns")),
    Variant("pickle", "a key whose hash takes 2^60 steps", lambda _: _pickled(b"})" + b"2\x86" * 60 + b"Ns")),
    Variant("pickle", "a value that unfolds to 2^60", lambda _: _pickled(b")" + b"2\x86" * 60)),
    Variant("pickle", "keys that all collide", lambda _: _colliding(60_000)),
    Variant("pickle", "more empty lists than memory", lambda _: _pickled(b"]" * 40_000_000)),
    Variant("pickle", "a place in the memo beyond all memory", lambda _: _pickled(b"Nr\xff\xff\xff\x7f")),
    Variant("pickle", "a whole number of a million digits", lambda _: pickle.dumps({"id": 1 << 4_000_000})),
    Variant("pickle", "text of half a pair", lambda _: pickle.dumps({"id": "\ud800"})),
    Variant("pickle", "a name of a million characters", lambda _: pickle.dumps({"x" * 1_000_000: 1})),
    Variant("pickle", "a container within itself", lambda _: _pickled(b"]q\0h\0a")),
    Variant("pickle", "a long name that is asked for", lambda _: _pickled(b"c" + b"os\n" + b"x" * 100_000 + b"\n")),
    Variant("pickle", "a line break in a name", lambda _: b"\x80\x04\x8c\x02os\x8c\x04a\xe2\x80\xa8\x93."),
    Variant("pickle", "nothing", lambda _: b""),
    Variant("pickle", "only zeros", lambda _: bytes(1000)),
    Variant("pickle", "half", lambda valid: valid[: len(valid) // 2]),
)


class _Named:
    """Pickles as a name of PyTorch's, or as a call of it."""

    def __init__(self, call: Callable[..., Any], *arguments: Any) -> None:
        self.reduced = (call, arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return self.reduced


class _Stored:
    def __init__(self, kind: Any = None, key: str = "0", count: Any = 16) -> None:
        import torch

        self.said = ("storage", kind or torch.FloatStorage, key, "cpu", count)


class _Pickler(pickle.Pickler):
    def persistent_id(self, held: Any) -> Any:
        return held.said if isinstance(held, _Stored) else None


def checkpoint(content: Any, **records: bytes) -> bytes:
    """An archive as PyTorch writes them, with one storage of 16 numbers."""
    pickled, made = io.BytesIO(), io.BytesIO()
    _Pickler(pickled, 2).dump(content)
    with zipfile.ZipFile(made, "w") as archive:
        archive.writestr("a/data.pkl", pickled.getvalue())
        archive.writestr("a/data/0", np.arange(16, dtype="<f4").tobytes())
        for name, data in records.items():
            archive.writestr(f"a/{name}", data)
    return made.getvalue()


def tensor(offset: Any, shape: Any, strides: Any, **stored: Any) -> _Named:
    """A tensor of that storage, with anything said of its place."""
    import torch

    place: tuple[Any, ...] = (_Stored(**stored), offset, shape, strides, False, OrderedDict())
    return _Named(torch._utils._rebuild_tensor_v2, *place)


def _says(offset: Any, shape: Any, strides: Any, **stored: Any) -> Callable[[bytes], bytes]:
    return lambda _: checkpoint({"w": tensor(offset, shape, strides, **stored)})


def _in_data(body: bytes) -> Callable[[bytes], bytes]:
    def change(_: bytes) -> bytes:
        made = io.BytesIO()
        with zipfile.ZipFile(made, "w") as archive:
            archive.writestr("a/data.pkl", _pickled(body))
        return made.getvalue()

    return change


def _twice_named(_: bytes) -> bytes:
    whole = checkpoint({"w": tensor(0, (4, 4), (4, 1))}, **{"data/1": bytes(64)})
    return whole.replace(b"a/data/1", b"a/data/0")


def _directory_says(at: int, value: int) -> Callable[[bytes], bytes]:
    """Another number in the directory's row of the storage."""

    def change(_: bytes) -> bytes:
        whole = bytearray(checkpoint({"w": tensor(0, (4, 4), (4, 1))}))
        row = whole.rindex(b"PK\1\2")
        whole[row + at : row + at + 4] = value.to_bytes(4, "little")
        return bytes(whole)

    return change


CHECKPOINTS = (
    Variant("checkpoint", "a tensor beyond its storage", _says(0, (5, 4), (4, 1))),
    Variant("checkpoint", "a first element beyond its storage", _says(16, (1,), (1,))),
    Variant("checkpoint", "a first element before its storage", _says(-1, (1,), (1,))),
    Variant("checkpoint", "strides that go back", _says(15, (4,), (-1,))),
    Variant("checkpoint", "strides that leave the storage", _says(0, (2, 2), (1 << 62, 1))),
    Variant("checkpoint", "a shape of more than 64 bits", _says(0, (1 << 70,), (1,))),
    Variant("checkpoint", "an empty tensor that is endless", _says(0, (0, 1 << 62), (1, 1))),
    Variant("checkpoint", "ten thousand axes", _says(0, (1,) * 10_000, (1,) * 10_000)),
    Variant("checkpoint", "more strides than axes", _says(0, (4,), (1, 1))),
    Variant("checkpoint", "a shape that is text", _says(0, "four", (1,))),
    Variant("checkpoint", "a shape that is no list", _says(0, 4, 1)),
    Variant("checkpoint", "a place that is a fraction", _says(0.5, (4,), (1,))),
    Variant("checkpoint", "a storage that is not there", _says(0, (4,), (1,), key="7")),
    Variant("checkpoint", "a storage of another folder", _says(0, (4,), (1,), key="../data.pkl")),
    Variant("checkpoint", "a storage of negative length", _says(0, (4,), (1,), count=-4), harmless=True),
    Variant("checkpoint", "a storage of endless length", _says(0, (1 << 40,), (1,), count=1 << 60)),
    Variant("checkpoint", "a name of a million characters", lambda _: checkpoint({"w" * 1_000_000: tensor(0, (), ())})),
    Variant("checkpoint", "a name of half a pair", lambda _: checkpoint({"\ud800": tensor(0, (), ())})),
    Variant("checkpoint", "an order of bytes that is unknown", lambda _: checkpoint({}, byteorder=b"middle")),
    Variant("checkpoint", "two records with the same name", _twice_named),
    Variant("checkpoint", "a record that begins beyond the file", _directory_says(42, 1 << 31)),
    Variant("checkpoint", "a record that ends beyond the file", _directory_says(24, 1 << 30)),
    Variant("checkpoint", "a key whose hash takes 2^60 steps", _in_data(b"})" + b"2\x86" * 60 + b"Ns")),
    Variant("checkpoint", "tuples nested 10^6 deep as a key", _in_data(b"})" + b"\x85" * 1_000_000 + b"Ns")),
    Variant("checkpoint", "an empty archive", lambda _: b"PK\5\6" + bytes(18)),
    Variant("checkpoint", "a TorchScript archive", lambda _: checkpoint({}, **{"constants.pkl": b"N."})),
    Variant("checkpoint", "half", lambda valid: valid[: len(valid) // 2]),
)


def safetensors(header: Any, data: bytes = b"\0" * 16) -> bytes:
    """A file with any header: a value, or its bytes."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def _entry(**said: Any) -> Callable[[bytes], bytes]:
    held = {"dtype": "F32", "shape": [4], "data_offsets": [0, 16], **said}
    return lambda _: safetensors({"w": {name: value for name, value in held.items() if value is not None}})


def _metadata(value: Any) -> Callable[[bytes], bytes]:
    entry = {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]}
    return lambda _: safetensors({"__metadata__": value, "w": entry})


SAFETENSORS = (
    Variant("safetensors", "a header longer than the file", lambda _: (1 << 62).to_bytes(8, "little") + b"{}"),
    Variant("safetensors", "a header nested 10^5 deep", lambda _: safetensors(DEEP.encode())),
    Variant("safetensors", "a header that is a list", lambda _: safetensors([])),
    Variant("safetensors", "a header that is no JSON", lambda _: safetensors(b"\xff\xfe{}")),
    Variant("safetensors", "a tensor of 2^60 numbers", _entry(shape=[1 << 60])),
    Variant("safetensors", "a tensor of 2^60 bytes", _entry(shape=[1 << 58], data_offsets=[0, 1 << 60])),
    Variant("safetensors", "an empty tensor that is endless", _entry(shape=[0, 1 << 63], data_offsets=[0, 0])),
    Variant("safetensors", "ten thousand axes", _entry(shape=[1] * 10_000)),
    Variant("safetensors", "a negative axis", _entry(shape=[-4])),
    Variant("safetensors", "an axis that is true", _entry(shape=[4, True])),
    Variant("safetensors", "an unknown type", _entry(dtype="F31")),
    Variant("safetensors", "no shape", _entry(shape=None)),
    Variant("safetensors", "an entry that is text", lambda _: safetensors({"w": "F32"})),
    Variant("safetensors", "a name of a million characters", lambda _: safetensors({"w" * 1_000_000: {}})),
    Variant("safetensors", "a name of half a pair", lambda _: safetensors(b'{"\\ud800": {}}')),
    Variant("safetensors", "metadata that are a list", _metadata([])),
    Variant("safetensors", "metadata nested 10^5 deep", _metadata({"challenger-bench": DEEP})),
    Variant("safetensors", "metadata that are no JSON", _metadata({"challenger-bench": "{"})),
    Variant("safetensors", "bytes that belong to nothing", _entry(shape=[2], data_offsets=[0, 8])),
    Variant("safetensors", "half", lambda valid: valid[: len(valid) // 2]),
)

JSONS = (
    Variant("json", "lists nested 10^5 deep", lambda _: DEEP.encode()),
    Variant("json", "objects nested 10^5 deep", lambda _: b'{"a":' * DEPTH + b"1" + b"}" * DEPTH),
    Variant("json", "lists nested 100 deep", lambda _: b'["[{", ' + b"[" * 100 + b"]" * 100 + b"]"),
    Variant("json", "lists that are never closed", lambda _: b"[" * 2_000_000),
    Variant("json", "half a pair, escaped", lambda _: b'{"name": "scene-\\ud800"}'),
    Variant("json", "half a pair, in bytes", lambda _: b'{"name": "scene-\xed\xa0\x80"}'),
    Variant("json", "bytes that are not text", lambda _: b'{"name": "\xff"}'),
    Variant("json", "a whole number of a million digits", lambda _: b"[" + b"1" * 1_000_000 + b"]"),
    Variant("json", "nothing", lambda _: b""),
    Variant("json", "only zeros", lambda _: bytes(1000)),
    Variant("json", "half", lambda valid: valid[: len(valid) // 2]),
)


def _columns(count: int) -> bytes:
    return b",".join(b"c%d" % number for number in range(count))


PLANS = (
    Variant("plans", "a first line with a million columns", lambda _: _columns(1_000_000) + b"\n"),
    Variant("plans", "a later line with a million columns", lambda valid: valid + b"," * 1_000_000 + b"\n"),
    Variant("plans", "a line of ten million characters", lambda valid: valid + b"x" * 10_000_000),
    Variant("plans", "a quote that is never closed", lambda valid: valid + b'"' + b"a\n" * 100_000),
    Variant("plans", "ten million lines", lambda valid: valid + b"\n" * 10_000_000),
    Variant("plans", "a zero byte", lambda valid: valid.replace(b",", b",\0", 30)),
    Variant("plans", "bytes that are not text", lambda valid: valid.replace(b",", b",\xff", 30)),
    Variant("plans", "text of 16 bits", lambda valid: valid.decode().encode("utf-16")),
    Variant("plans", "half", lambda valid: valid[: len(valid) // 2 - 7]),
)


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


JSON_PLANS = (
    Variant("json plans", "a row with a million columns", lambda _: _json([{str(n): 1 for n in range(10**6)}])),
    Variant("json plans", "rows with columns of their own", lambda _: _json([{str(n): 1} for n in range(10**5)])),
    Variant("json plans", "rows nested 10^5 deep", lambda _: DEEP.encode()),
    Variant("json plans", "a table by column", lambda _: b'{"a": [1]}'),
    Variant("json plans", "text", lambda _: b'"plans"'),
    Variant("json plans", "half a pair", lambda valid: valid.replace(b'"ego"', b'"\\ud800"')),
    Variant("json plans", "half", lambda valid: valid[: len(valid) // 2]),
)


def npz(arrays: dict[str, bytes]) -> bytes:
    """An archive of anything."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(f"{name}.npy", data)
    return made.getvalue()


def _array(header: str, data: bytes = b"") -> bytes:
    text = header.encode() + b" " * (-(len(header) + 11) % 64) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text + data


def _claims(descr: str, shape: str, data: bytes = b"") -> Callable[[bytes], bytes]:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}}}"
    return lambda _: npz({"x": _array(header, data)})


NPZS = (
    Variant("npz", "an array of 10^12 numbers", _claims("'<f8'", "(1000000000000,)")),
    Variant("npz", "an array of more than 64 bits", _claims("'<f8'", "(1 << 70,)")),
    Variant("npz", "an array of negative length", _claims("'<f8'", "(-1,)")),
    Variant("npz", "text of 10^9 characters", _claims("'<U1000000000'", "(1000,)")),
    Variant("npz", "an array of objects", _claims("'|O'", "(1,)", pickle.dumps([1]))),
    Variant("npz", "a header nested 10^4 deep", _claims("(" * 9000 + ")" * 9000, "()")),
    Variant("npz", "a header that is no header", lambda _: npz({"x": b"\x93NUMPY\1\0\xff\xff"})),
    Variant("npz", "twenty thousand arrays", lambda _: npz({str(number): b"" for number in range(20_000)})),
    Variant("npz", "an empty archive", lambda _: b"PK\5\6" + bytes(18), harmless=True),
    Variant("npz", "nothing", lambda _: b""),
    Variant("npz", "half", lambda valid: valid[: len(valid) // 2]),
)

VARIANTS = (*PICKLES, *CHECKPOINTS, *SAFETENSORS, *JSONS, *PLANS, *JSON_PLANS, *NPZS)


def write_sparse(path: Path, size: int) -> Path:
    """A file that claims a size and occupies nothing."""
    with path.open("wb") as stream:
        os.ftruncate(stream.fileno(), size)
    return path
