"""The header of a safetensors file, looked at before the library reads it: every number in it is a stranger's."""

import math
import os
from pathlib import Path
from typing import Any, Final

from benchmark.untrusted.files import one_line, open_file
from benchmark.untrusted.json_text import parse_json
from benchmark.untrusted.limits import SAFETENSORS, Limits, in_words

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
    """Look at the header of a safetensors file.

    Args:
        path: The file.
        limits: How large the file and its header may be, how many tensors there may be, and how long their names.

    Raises:
        OSError: If the file cannot be read.
        InputError: If it is longer than any file of its kind.
        ValueError: If the header is longer than the file, not JSON, or says of a tensor what cannot be true.
    """
    if not path.exists():
        raise FileNotFoundError(f"No such file or directory: {path}")
    with open_file(path, limits) as stream:
        size = os.fstat(stream.fileno()).st_size
        length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
        if size < _LENGTH_BYTES or length > size - _LENGTH_BYTES:
            raise ValueError("its header is longer than the file")
        if length > limits.content_bytes:
            raise ValueError(f"its header has {in_words(length)}, at most {in_words(limits.content_bytes)} are read")
        header = parse_json(stream.read(length), limits)
    if not isinstance(header, dict) or len(header) > limits.values:
        raise ValueError("its header is no list of tensors")
    metadata = header.pop(_METADATA, {})
    if not isinstance(metadata, dict) or not all(isinstance(text, str) for text in metadata.values()):
        raise ValueError("its header's metadata are not texts by name")
    for name, entry in header.items():
        if len(name) > limits.name_characters:
            raise ValueError(f"a tensor's name has more than {limits.name_characters} characters")
        if not _can_be_true(entry, size - _LENGTH_BYTES - length):
            raise ValueError(f"its header says of {one_line(name, 80)} what cannot be true")


def _can_be_true(entry: Any, held_bytes: int) -> bool:
    if not isinstance(entry, dict) or set(entry) != {"dtype", "shape", "data_offsets"}:
        return False
    bits, shape, place = _ITEM_BITS.get(str(entry["dtype"])), entry["shape"], entry["data_offsets"]
    if bits is None or not _are_counts(shape) or len(shape) > _MOST_AXES or not _are_counts(place) or len(place) != 2:
        return False
    return bool(place[0] <= place[1] <= held_bytes and math.prod(shape) * bits == 8 * (place[1] - place[0]))


def _are_counts(value: Any) -> bool:
    return isinstance(value, list) and all(type(each) is int and 0 <= each <= _FARTHEST for each in value)
