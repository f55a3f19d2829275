"""What foreign pickles may ask for, and what they get in its place: the first wall, on which the others rest.

Runs in the child process (`child.py`), and needs neither torch nor anything else but numpy.
"""

import codecs
import pickle
from collections import OrderedDict, defaultdict
from typing import Any, ClassVar, Final

import numpy as np


class Refused(Exception):
    """A pickle asked for something that is not on the list; carries its name."""


def _encode(text: str, encoding: str = "utf-8") -> bytes:
    """What pickle protocol 2 calls to rebuild bytes; other codecs than these two have no business there."""
    if encoding not in ("latin1", "utf-8"):
        raise pickle.UnpicklingError(f"encoding {encoding!r} is not allowed")
    return codecs.encode(text, encoding)


class NumberType:
    """Stands for ``numpy.dtype``: plain numbers and texts only, whose state is nothing but a byte order.

    A number type of numpy itself, with a made-up state, reads memory that is not its own.
    """

    kinds: ClassVar = "biufcSU"
    refusal: ClassVar = "an array of {} is not allowed"

    def __init__(self, name: Any, *_: Any) -> None:
        self.dtype = np.dtype(name)
        if self.dtype.kind not in self.kinds:
            raise pickle.UnpicklingError(self.refusal.format(self.dtype))

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.dtype = self.dtype.newbyteorder(state[1])


class _LoggedNumberType(NumberType):
    """The same in a checkpoint, where there is no need of texts; the refusal is worded as PyTorch words its own."""

    kinds: ClassVar = "biuf"
    refusal: ClassVar = "Unsupported class numpy.{}"


class _Array(np.ndarray[Any, Any]):
    """An array being read; `_plain` makes it an ordinary one."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        version, shape, kind, is_fortran, data = state
        if not isinstance(kind, NumberType):
            raise pickle.UnpicklingError("an array without a type is not allowed")
        super().__setstate__((version, shape, kind.dtype, is_fortran, data))


class _ArrayType:
    """Stands for ``numpy.ndarray``, which pickles only name: calling it could claim any amount of memory."""


def _empty_array(subtype: Any, shape: tuple[int, ...], _: Any) -> Any:
    """What pickle calls to begin an array; numpy itself always asks for a flat one without elements."""
    if subtype is not _ArrayType or shape != (0,):
        raise pickle.UnpicklingError(f"an array of shape {shape} without content is not allowed")
    return _Array((0,), np.uint8)


def _array_from_buffer(buffer: bytes, kind: NumberType, shape: tuple[int, ...], order: Any) -> Any:
    """What pickle protocol 5 calls to rebuild an array."""
    return np.frombuffer(buffer, dtype=kind.dtype).reshape(shape, order=order)


def _scalar(kind: NumberType, data: bytes) -> Any:
    """What pickle calls to rebuild a number."""
    return np.frombuffer(data, kind.dtype, count=1)[0]


def _bytearray(*arguments: Any) -> bytearray:
    if any(isinstance(argument, int) for argument in arguments):
        raise pickle.UnpicklingError("a bytearray without content is not allowed")
    return bytearray(*arguments)


def _bytes(*arguments: Any) -> bytes:
    return bytes(_bytearray(*arguments))


_CORES: Final = ("core", "_core")
_BUILTINS: Final = ("builtins", "__builtin__")
NUMBERS: Final[dict[tuple[str, str], Any]] = {
    ("numpy", "dtype"): NumberType,
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in _CORES},
}
ALLOWED: Final[dict[tuple[str, str], Any]] = {
    **NUMBERS,
    ("numpy", "ndarray"): _ArrayType,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _empty_array for core in _CORES},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _array_from_buffer for core in _CORES},
    **{
        (module, kind.__name__): kind
        for module in _BUILTINS
        for kind in (dict, list, set, frozenset, tuple, int, float, bool, complex, str)
    },
    **{(module, "bytearray"): _bytearray for module in _BUILTINS},
    **{(module, "bytes"): _bytes for module in _BUILTINS},
    ("__builtin__", "long"): int,
    ("__builtin__", "unicode"): str,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): defaultdict,
    ("_codecs", "encode"): _encode,
}
"""What foreign files may ask for, by module and name, and what they get in its place."""


class AllowListUnpickler(pickle.Unpickler):
    """Reads pickles of arrays, numbers and plain containers."""

    allowed: ClassVar[dict[tuple[str, str], Any]] = ALLOWED

    def find_class(self, module: str, name: str) -> Any:
        """What stands for a name; nothing is ever imported for it."""
        if (module, name) not in self.allowed:
            raise Refused(f"{module}.{name}")
        return self.allowed[module, name]
