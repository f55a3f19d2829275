"""Foreign pickles by an allow-list: arrays and plain containers, nothing that could run code."""

import codecs
import io
import pickle
from collections import OrderedDict, defaultdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError


def _encode(text: str, encoding: str = "utf-8") -> bytes:
    """What pickle protocol 2 calls to rebuild bytes; other codecs than these two have no business there."""
    if encoding not in ("latin1", "utf-8"):
        raise pickle.UnpicklingError(f"encoding {encoding!r} is not allowed")
    return codecs.encode(text, encoding)


def _array_from_buffer(buffer: bytes, dtype: Any, shape: tuple[int, ...], order: Any) -> Any:
    """What pickle protocol 5 calls to rebuild an array."""
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


_ALLOWED: Final[dict[tuple[str, str], Any]] = {
    ("numpy", "ndarray"): np.ndarray,
    ("numpy", "dtype"): np.dtype,
    **{
        (f"numpy.{core}.multiarray", name): getattr(np.core.multiarray, name)
        for core in ("core", "_core")
        for name in ("_reconstruct", "scalar")
    },
    **{(f"numpy.{core}.numeric", "_frombuffer"): _array_from_buffer for core in ("core", "_core")},
    **{
        (module, kind.__name__): kind
        for module in ("builtins", "__builtin__")
        for kind in (dict, list, set, frozenset, tuple, bytearray, int, float, bool, complex, str, bytes)
    },
    ("__builtin__", "long"): int,
    ("__builtin__", "unicode"): str,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): defaultdict,
    ("_codecs", "encode"): _encode,
}


class _AllowListUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise _Refused(f"{module}.{name}")
        return _ALLOWED[module, name]


class _Refused(Exception):
    """A pickle asked for something that is not on the list; carries its name."""


def read_pickle(path: Path) -> Any:
    """Read a pickle of arrays and plain containers without trusting it.

    Args:
        path: The file.

    Returns:
        Its value.

    Raises:
        InputError: If the file is absent or broken, or asks for anything that is not on the allow-list; the message
            names what it asked for.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        return _AllowListUnpickler(io.BytesIO(data)).load()
    except _Refused as refused:
        raise InputError(
            f"{path} is refused: its pickle asks for {refused}, which is not among the arrays and containers that a "
            "recording needs and could run code; do not open this file, get the recording from a source you trust"
        ) from None
    # A malformed stream may raise anything, from EOFError to what numpy thinks of a damaged array.
    except Exception as error:
        raise InputError(
            f"{path} is not a readable pickle ({type(error).__name__}: {error}); it may be truncated, fetch it again"
        ) from error
