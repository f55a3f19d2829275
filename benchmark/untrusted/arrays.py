"""Foreign npz files: what every array says of its size is compared with what the archive holds before any is read."""

import math
import struct
import warnings
import zipfile
from io import BufferedReader
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from benchmark.untrusted.files import one_line, open_file
from benchmark.untrusted.limits import NPZ, Limits, in_words

_END: Final = b"PK\5\6"
_END_BYTES: Final = 22
_LONGEST_COMMENT: Final = 1 << 16


def read_npz(path: Path, limits: Limits = NPZ) -> dict[str, NDArray[Any]]:
    """Read the arrays of an npz file; nothing in it is unpickled.

    Args:
        path: The file.
        limits: How large it may be, what it may unpack to, and how many arrays it may have.

    Returns:
        By name, in the file's order.

    Raises:
        InputError: If it cannot be opened or is longer than any file of its kind.
        OSError: If it cannot be read.
        ValueError: If it is damaged, holds pickled objects, or unpacks to more than it may.
    """
    if not path.exists():
        raise FileNotFoundError("there is no such file")
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
            raise ValueError(one_line(error) or "it is empty") from error


def _require_few(stream: BufferedReader, limits: Limits) -> None:
    """The directory at the end says how many entries it has; each would cost memory."""
    size = stream.seek(0, 2)
    stream.seek(max(0, size - _END_BYTES - _LONGEST_COMMENT))
    tail = stream.read()
    at = tail.rfind(_END)
    if at < 0 or len(tail) - at < _END_BYTES:
        raise ValueError("it is no npz file, or not all of one")
    count, length = struct.unpack_from("<HI", tail, at + 10)
    # 65,535 stands for more; no file of arrays has as many.
    if count > limits.values or length > limits.values * (limits.name_characters + 128):
        raise ValueError(f"it holds {count} arrays, at most {limits.values} are read")


def _require_sound(archive: zipfile.ZipFile, limits: Limits) -> None:
    entries = archive.infolist()
    if len(entries) > limits.values:
        raise ValueError(f"it holds {len(entries)} arrays, at most {limits.values} are read")
    if sum(entry.file_size for entry in entries) > limits.content_bytes:
        raise ValueError(f"it unpacks to more than {in_words(limits.content_bytes)}")
    for entry in entries:
        with archive.open(entry) as held:
            version = npy.read_magic(held)  # type: ignore[no-untyped-call]
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, _, kind = read(held)  # type: ignore[no-untyped-call]
            if kind.hasobject:
                raise ValueError("Object arrays cannot be loaded, they are pickles")
            if held.tell() + math.prod(shape) * kind.itemsize != entry.file_size:
                raise ValueError(f"{one_line(entry.filename, 80)} is not as long as it says")
