"""Arrays kept in one file of the user's cache: written whole, read as a part of memory that processes share.

The file says what it was made of, and has a hash of all that follows; whatever does not fit is as good as none. Nothing
in it is code or a pickle, and types and places come from whoever reads, not from the file.
"""

import hashlib
import struct
from collections.abc import Mapping, Sequence
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, content_key, only_writer, parse_json, write_parts
from benchmark.machine.user_cache import cache_root
from benchmark.untrusted.files import open_file
from benchmark.untrusted.limits import KEPT_ARRAYS

_MAGIC: Final = b"kept arrays 1\n\0\0"
_LENGTH: Final = struct.Struct("<Q")
_ALIGNED: Final = 64
_LONGEST_HEAD: Final = 1 << 20


def kept_place(folder: str, known_by: Path) -> Path | None:
    """Where arrays that are made of a file or folder are kept.

    Args:
        folder: Of the user's cache, for arrays of one kind.
        known_by: The file or folder.

    Returns:
        The file; nowhere where the user has no home.
    """
    try:
        root = cache_root()
    except RuntimeError:
        return None
    return root / folder / f"{content_key(str(known_by.resolve()))[:32]}.arrays"


def write_arrays(path: Path, made_of: str, said: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Keep arrays, unless somebody else is keeping some there, or there is no room or right to.

    Args:
        path: The file; its folder is made, and holds such files alone.
        made_of: What the arrays depend on.
        said: What else is to be said of them, as JSON.
        arrays: One-dimensional arrays by name.

    Returns:
        Whether they are kept.
    """
    body: list[bytes | memoryview] = []
    hashed, counts = hashlib.sha256(), {}
    for name, values in arrays.items():
        data = np.ascontiguousarray(values).data.cast("B") if len(values) else memoryview(b"")
        body += [data, bytes(-len(data) % _ALIGNED)]
        counts[name] = len(values)
    for part in body:
        hashed.update(part)
    head = canonical_json({"made_of": made_of, "said": said, "counts": counts, "sha256": hashed.hexdigest()}).encode()
    head += b" " * (-(len(_MAGIC) + _LENGTH.size + len(head)) % _ALIGNED)
    try:
        with only_writer(path.parent):
            write_parts(path, (_MAGIC, _LENGTH.pack(len(head)), head, *body))
    except InputError:
        # Nothing is lost: the same is computed again.
        return False
    return True


def read_arrays(path: Path, made_of: str, types: Mapping[str, str]) -> dict[str, NDArray[Any]] | None:
    """Arrays that were kept.

    Args:
        path: The file.
        made_of: What they must depend on.
        types: Types of numpy by name, in the order in which they were given to `write_arrays`.

    Returns:
        Arrays that nobody may write to, which lie in the file; ``None`` if it is absent, damaged or made of something
        else.
    """
    try:
        with open_file(path, KEPT_ARRAYS) as stream:
            head = _head(stream)
            if head.get("made_of") != made_of or set(head.get("counts", ())) != set(types):
                return None
            places = _places(stream.tell(), types, head["counts"])
            if hashlib.file_digest(stream, "sha256").hexdigest() != head.get("sha256") or stream.tell() != places[-1]:
                return None
            whole = np.asarray(np.memmap(stream, np.uint8, "r"))
    except (InputError, OSError, ValueError):
        return None
    starts = zip(types.items(), places)
    return {
        name: whole[first : first + head["counts"][name] * np.dtype(kind).itemsize].view(kind)
        for (name, kind), first in starts
    }


def said_of(path: Path) -> Mapping[str, Any] | None:
    """What else was said of kept arrays; ``None`` if there are none."""
    try:
        with open_file(path, KEPT_ARRAYS) as stream:
            said = _head(stream).get("said")
    except (InputError, OSError, ValueError):
        return None
    return said if isinstance(said, dict) else None


def _head(stream: BufferedReader) -> dict[str, Any]:
    """What the file begins with; raises ValueError if it begins otherwise."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("it begins with something else")
    length = _LENGTH.unpack(_exactly(stream, _LENGTH.size))[0]
    if length > _LONGEST_HEAD:
        raise ValueError("its head is too long")
    head = parse_json(_exactly(stream, length))
    if not isinstance(head, dict) or not isinstance(head.get("counts"), dict):
        raise ValueError("its head is not one")
    if not all(type(count) is int and count >= 0 for count in head["counts"].values()):
        raise ValueError("its counts are none")
    return head


def _exactly(stream: BufferedReader, count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise ValueError("it ends too soon")
    return data


def _places(first: int, types: Mapping[str, str], counts: Mapping[str, int]) -> Sequence[int]:
    """Where each array begins, and where the last one ends."""
    places = [first]
    for name, kind in types.items():
        size = counts[name] * np.dtype(kind).itemsize
        places.append(places[-1] + size + -size % _ALIGNED)
    return places
