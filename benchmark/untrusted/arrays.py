"""Foreign npz and safetensors files: what every array says of its size is compared with the file before any is read."""

import math
import os
import struct
import warnings
import zipfile
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from benchmark.untrusted.files import NPZ, SAFETENSORS, Limits, format_bytes, open_file, to_one_line
from benchmark.untrusted.text_files import parse_json

_ITEM_BITS: Final = {
    "BOOL": 8, "U8": 8, "I8": 8, "F8_E5M2": 8, "F8_E4M3": 8, "F8_E8M0": 8, "I16": 16, "U16": 16, "F16": 16, "BF16": 16,
    "I32": 32, "U32": 32, "F32": 32, "F64": 64, "I64": 64, "U64": 64, "C64": 64, "F4": 4, "F6_E2M3": 6, "F6_E3M2": 6,
    "F8_E4M3FNUZ": 8, "F8_E5M2FNUZ": 8,
}  # fmt: skip
_METADATA: Final = "__metadata__"
_LENGTH_BYTES: Final = 8
_MOST_AXES: Final = 32
_FARTHEST: Final = 1 << 40
"""No axis is longer, not even of a tensor that is empty along another."""


def require_sound_header(path: Path, limits: Limits = SAFETENSORS) -> None:
    """Check the header of a safetensors file before it is mapped.

    Raises `InputError` if the file is too long, `ValueError` if the header is longer than the file, not JSON, or
    impossible, `OSError` if it cannot be read.
    """
    if not path.exists():
        raise FileNotFoundError(f"No such file or directory: {path}")
    with open_file(path, limits) as stream:
        size = os.fstat(stream.fileno()).st_size
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
        if size < _LENGTH_BYTES or length > size - _LENGTH_BYTES:
            raise ValueError("its header is longer than the file")
        if length > limits.content_bytes:
            raise ValueError(
                f"its header has {format_bytes(length)}, at most {format_bytes(limits.content_bytes)} are read"
            )
        header = parse_json(stream.read(length), limits)
    if not isinstance(header, dict) or len(header) > limits.values:
        raise ValueError("its header is not a list of tensors")
    metadata = header.pop(_METADATA, {})
    if not isinstance(metadata, dict) or not all(isinstance(text, str) for text in metadata.values()):
        raise ValueError("the metadata in its header must map names to text")
    for name, entry in header.items():
        if len(name) > limits.name_characters:
            raise ValueError(f"a tensor's name has more than {limits.name_characters} characters")
        if not _can_be_true(entry, size - _LENGTH_BYTES - length):
            raise ValueError(f"its header has impossible values for {to_one_line(name, 80)}")


def _can_be_true(entry: Any, held_bytes: int) -> bool:
    if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
        return False
    bits, shape, place = _ITEM_BITS.get(str(entry["dtype"])), entry["shape"], entry["data_offsets"]
    if bits is None or not _are_counts(shape) or len(shape) > _MOST_AXES or not _are_counts(place) or len(place) != 2:
        return False
    return bool(place[0] <= place[1] <= held_bytes and math.prod(shape) * bits == 8 * (place[1] - place[0]))


def _are_counts(value: Any) -> bool:
    return isinstance(value, list) and all(type(number) is int and 0 <= number <= _FARTHEST for number in value)


_END: Final = b"PK\5\6"
_END_BYTES: Final = 22
_LONGEST_COMMENT: Final = 1 << 16


def read_npz(path: Path, limits: Limits = NPZ) -> dict[str, NDArray[Any]]:
    """Arrays of an npz file by name, in the file's order; nothing is unpickled.

    Raises `InputError` if it cannot be opened or is too long, `OSError` if it cannot be read, `ValueError` if it is
    damaged, holds pickled objects or unpacks to more than the limits allow.
    """
    if not path.exists():
        raise FileNotFoundError("the file does not exist")
    with open_file(path, limits) as stream:
        _require_few(stream, limits)
        stream.seek(0)
        try:
            with zipfile.ZipFile(stream) as archive:
                _require_sound(archive, limits)
            stream.seek(0)
            with warnings.catch_warnings(), np.load(stream, allow_pickle=False) as stored:
                warnings.simplefilter("ignore", UserWarning)
                return {name: stored[name] for name in stored.files}
        except MemoryError:
            raise ValueError("it does not fit into memory") from None
        # Parsers of zip files and array headers raise a dozen kinds of exceptions on bytes that are neither.
        except Exception as error:
            raise ValueError(to_one_line(error) or "it is empty") from error


def _require_few(stream: BufferedReader, limits: Limits) -> None:
    """The directory at the end says how many entries it has; each would cost memory."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - _END_BYTES - _LONGEST_COMMENT))
    tail = stream.read()
    at = tail.rfind(_END)
    if at < 0 or len(tail) - at < _END_BYTES:
        raise ValueError("it is not a complete npz file")
    count, length = struct.unpack_from("<HI", tail, at + 10)
    # 65,535 means that there are more; no file of arrays has that many.
    if count > limits.values or length > limits.values * (limits.name_characters + 128):
        raise ValueError(f"it holds {count} arrays, at most {limits.values} are read")


def _require_sound(archive: zipfile.ZipFile, limits: Limits) -> None:
    entries = archive.infolist()
    if len(entries) > limits.values:
        raise ValueError(f"it holds {len(entries)} arrays, at most {limits.values} are read")
    if sum(entry.file_size for entry in entries) > limits.content_bytes:
        raise ValueError(f"it unpacks to more than {format_bytes(limits.content_bytes)}")
    for entry in entries:
        with archive.open(entry) as held:
            version = npy.read_magic(held)  # type: ignore[no-untyped-call]
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, _, kind = read(held)  # type: ignore[no-untyped-call]
            if kind.hasobject:
                raise ValueError("Object arrays cannot be loaded, they are pickles")
            if held.tell() + math.prod(shape) * kind.itemsize != entry.file_size:
                raise ValueError(f"{to_one_line(entry.filename, 80)} has another length than it declares")
