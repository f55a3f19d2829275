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


class _NumberType:
    """Stands for ``numpy.dtype``: plain numbers and texts only, whose state is nothing but a byte order.

    An array of objects with a made-up state makes numpy read memory that is not its own.
    """

    def __init__(self, name: Any, *_: Any) -> None:
        self.dtype = np.dtype(name)
        if self.dtype.kind not in "biufcSU":
            raise pickle.UnpicklingError(f"an array of {self.dtype} is not allowed")

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.dtype = self.dtype.newbyteorder(state[1])


class _Array(np.ndarray[Any, Any]):
    """An array being read; `_plain` makes it an ordinary one."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        version, shape, kind, is_fortran, data = state
        if not isinstance(kind, _NumberType):
            raise pickle.UnpicklingError("an array without a type is not allowed")
        super().__setstate__((version, shape, kind.dtype, is_fortran, data))


class _ArrayType:
    """Stands for ``numpy.ndarray``, which pickles only name: calling it could claim any amount of memory."""


def _empty_array(subtype: Any, shape: tuple[int, ...], _: Any) -> Any:
    """What pickle calls to begin an array; numpy itself always asks for a flat one without elements."""
    if subtype is not _ArrayType or shape != (0,):
        raise pickle.UnpicklingError(f"an array of shape {shape} without content is not allowed")
    return _Array((0,), np.uint8)


def _array_from_buffer(buffer: bytes, kind: _NumberType, shape: tuple[int, ...], order: Any) -> Any:
    """What pickle protocol 5 calls to rebuild an array."""
    return np.frombuffer(buffer, dtype=kind.dtype).reshape(shape, order=order)


def _scalar(kind: _NumberType, data: bytes) -> Any:
    """What pickle calls to rebuild a number."""
    return np.frombuffer(data, kind.dtype, count=1)[0]


def _plain(value: Any) -> Any:
    """``value`` with ordinary arrays in its dictionaries and lists, which are changed in place."""
    if isinstance(value, _Array):
        return value.view(np.ndarray)
    seen, waiting = set(), [value]
    while waiting:
        inner = waiting.pop()
        if id(inner) in seen or not isinstance(inner, dict | list | tuple):
            continue
        seen.add(id(inner))
        places = list(inner.items() if isinstance(inner, dict) else enumerate(inner))
        waiting += [item for _, item in places]
        if not isinstance(inner, tuple):
            for place, item in places:
                if isinstance(item, _Array):
                    inner[place] = item.view(np.ndarray)
    return value


def _bytearray(*arguments: Any) -> bytearray:
    if any(isinstance(argument, int) for argument in arguments):
        raise pickle.UnpicklingError("a bytearray without content is not allowed")
    return bytearray(*arguments)


def _bytes(*arguments: Any) -> bytes:
    return bytes(_bytearray(*arguments))


_ALLOWED: Final[dict[tuple[str, str], Any]] = {
    ("numpy", "ndarray"): _ArrayType,
    ("numpy", "dtype"): _NumberType,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _empty_array for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _array_from_buffer for core in ("core", "_core")},
    **{
        (module, kind.__name__): kind
        for module in ("builtins", "__builtin__")
        for kind in (dict, list, set, frozenset, tuple, int, float, bool, complex, str)
    },
    **{(module, "bytearray"): _bytearray for module in ("builtins", "__builtin__")},
    **{(module, "bytes"): _bytes for module in ("builtins", "__builtin__")},
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
        return _plain(_AllowListUnpickler(io.BytesIO(data)).load())
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
