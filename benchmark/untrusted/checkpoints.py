"""PyTorch files: a child process says where the numbers of each tensor lie; they are mapped straight from the file."""

import math
import zlib
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.untrusted.checkpoint_structure import ITEM_BYTES
from benchmark.untrusted.children import ChildAnswer, read_in_child
from benchmark.untrusted.files import CHECKPOINT, EXPANSION, MIB, Limits, open_file

_MOST_AXES: Final = 32
_CHECKED_AT_ONCE: Final = MIB


@dataclass(frozen=True, slots=True)
class TensorLocation:
    """Place of a tensor: PyTorch's name of its type, its storage and first element there, shape and strides."""

    number_type: str
    storage: int
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class StoredCheckpoint:
    """Content of a PyTorch file.

    Tensors by name in the file's order, each inside its storage; storages are mapped bytes, and writing to them never
    reaches the file; ``configuration`` is the training configuration that mmcv stores, or empty. ``note``
    says which copy of the weights they are, where the file has averaged ones.
    """

    tensors: dict[str, TensorLocation]
    storages: tuple[NDArray[np.uint8], ...]
    big_endian: bool
    configuration: str
    note: str = ""


def read_stored(path: Path, limits: Limits = CHECKPOINT, *, checksums: bool = True) -> StoredCheckpoint:
    """Find the tensors of a checkpoint without trusting it.

    Takes a checkpoint with a state dict among its entries (mmcv's ``{meta, state_dict, optimizer}``, timm's, ...) or a
    bare one, of any PyTorch version; for the checksums of an archive all of it is read. Raises `InputError` if it would
    run code or is not what it claims.
    """
    _require_bytes(path, limits)
    structure = _structure(path, read_in_child(path, "checkpoint", limits))
    with open_file(path, limits) as stream:
        for first, length, checksum, name in structure["records"] if checksums else ():
            if _checksum(stream, first, length) != checksum:
                raise InputError(f"{path} is damaged ({name} fails its checksum); fetch it again")
        mapped = np.memmap(stream, np.uint8, "c")
    storages = tuple(mapped[first : first + length].view(np.ndarray) for first, length in structure["storages"])
    tensors: dict[str, TensorLocation] = {}
    for name, number_type, storage, offset, shape, strides in structure["tensors"]:
        if not number_type:
            raise InputError(f"{path}: {name} is not a dense tensor of real numbers; save the weights as such")
        tensors[name] = TensorLocation(number_type, storage, offset, tuple(shape), tuple(strides))
        _require_inside(path, name, tensors[name], storages)
    claimed = sum(math.prod(tensor.shape) * ITEM_BYTES[tensor.number_type] for tensor in tensors.values())
    if claimed > EXPANSION * len(mapped) + MIB:
        raise InputError(
            f"{path} claims tensors of {claimed} bytes but has {len(mapped)}; it may be malicious, get it from a "
            "source that you trust"
        )
    return StoredCheckpoint(tensors, storages, structure["big_endian"], structure["configuration"], structure["note"])


def _require_bytes(path: Path, limits: Limits) -> None:
    try:
        with open_file(path, limits) as stream:
            start = stream.read(512)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if not start:
        raise InputError(f"{path} is empty; fetch it again")
    if start.lstrip()[:1] == b"<":
        raise InputError(
            f"{path} is a web page, not a checkpoint: the server sent a page to click through; open the address "
            "in a browser and save the file itself"
        )


def _structure(path: Path, answer: ChildAnswer) -> dict[str, Any]:
    if answer.kind == "refused":
        raise InputError(
            f"{path} is refused: it uses {answer.parts[0]}, which is not among the tensors and plain values that "
            "weights need and could run code; get it from a source that you trust, or save its state_dict alone in the "
            "environment that made it"
        )
    if answer.kind == "archive":
        raise InputError(f"{path} is truncated or damaged ({answer.parts[0]}); fetch it again")
    if answer.kind == "broken" and answer.parts[1].startswith("Unsupported class "):
        name = answer.parts[1].removeprefix("Unsupported class ")
        return _structure(path, ChildAnswer("refused", (name,)))
    if answer.kind == "broken":
        raise InputError(
            f"{path} cannot be read as a PyTorch checkpoint ({answer.parts[0]}); it is damaged or not a checkpoint; "
            "fetch it again"
        )
    structure: dict[str, Any] = answer.parts[0]
    if structure.get("wrong") == "size":
        raise InputError(
            f"{path} claims to hold more bytes than it has, which no file written by PyTorch does; get it from a "
            "source that you trust"
        )
    if structure.get("wrong") == "kind":
        raise InputError(f"{path} holds a {structure['kind']} without named tensors; weights must be a state dict")
    if structure.get("wrong") == "entry":
        raise InputError(
            f"{path} holds {structure['entry']}, which is not a named tensor; weights must be a state dict, or an mmcv "
            "checkpoint with one under state_dict"
        )
    return structure


def _checksum(stream: BufferedReader, first: int, length: int) -> int:
    """CRC-32 of some bytes, read and not mapped: most of a checkpoint is never touched again."""
    stream.seek(first)
    buffer, checksum = memoryview(bytearray(min(length, _CHECKED_AT_ONCE))), 0
    while length:
        count = stream.readinto(buffer[: min(length, len(buffer))])
        if not count:
            return -1
        checksum, length = zlib.crc32(buffer[:count], checksum), length - count
    return checksum


def _require_inside(path: Path, name: str, tensor: TensorLocation, storages: tuple[NDArray[np.uint8], ...]) -> None:
    """A tensor that leaves its storage would read memory that is not its own."""
    shape, strides, item = tensor.shape, tensor.strides, ITEM_BYTES[tensor.number_type]
    sound = len(shape) == len(strides) <= _MOST_AXES and all(
        number >= 0 for number in (tensor.offset, *shape, *strides)
    )
    number_count = len(storages[tensor.storage]) // item if 0 <= tensor.storage < len(storages) else 0
    empty = 0 in shape
    last = tensor.offset + sum((length - 1) * step for length, step in zip(shape, strides, strict=sound))
    if not sound or (not empty and last >= number_count) or (empty and max(shape) > len(storages) + number_count + MIB):
        raise InputError(
            f"{path}: {format_tensor_name(name)} lies outside the numbers that the file holds; it is damaged, "
            "fetch it again"
        )


def format_tensor_name(name: str) -> str:
    """A tensor's name, fit for a sentence."""
    return name if name.isprintable() and len(name) < 200 else repr(name[:80])
