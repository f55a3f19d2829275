"""The bytes of a tensor's storage in PyTorch's old form: five short pickles behind each other, then raw numbers.

Runs in the child process. The pickles of this second stream may name storages and nothing else, so that what is hidden
in the bytes of a tensor is refused like anything in the open. The allow-list of untrusted pickles is here, too.
"""

import codecs
import io
import pickle
from collections import OrderedDict, defaultdict
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.untrusted.answers import UnencodableValueError
from benchmark.untrusted.files import to_one_line


class DisallowedNameError(Exception):
    """A pickle asked for something that is not on the list; carries its name."""


def _encode(text: str, encoding: str = "utf-8") -> bytes:
    """Stand-in that rebuilds bytes in pickle protocol 2, which needs only these two codecs."""
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


class _PickledNumberType(NumberType):
    """The same in a checkpoint, where there is no need of texts; the refusal is worded as PyTorch words its own."""

    kinds: ClassVar = "biuf"
    refusal: ClassVar = "Unsupported class numpy.{}"


class _PickledArray(np.ndarray[Any, Any]):
    """An array being read; `_plain` makes it an ordinary one."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        version, shape, kind, is_fortran, data = state
        if not isinstance(kind, NumberType):
            raise pickle.UnpicklingError("an array without a type is not allowed")
        super().__setstate__((version, shape, kind.dtype, is_fortran, data))


class _ArrayType:
    """Stands for ``numpy.ndarray``, which pickles only name: calling it could claim any amount of memory."""


def _empty_array(subtype: Any, shape: tuple[int, ...], _: Any) -> Any:
    """Stand-in that creates an array in pickles; numpy itself always asks for a flat one without elements."""
    if subtype is not _ArrayType or shape != (0,):
        raise pickle.UnpicklingError(f"an array of shape {shape} without content is not allowed")
    return _PickledArray((0,), np.uint8)


def _array_from_buffer(buffer: bytes, kind: NumberType, shape: tuple[int, ...], order: Any) -> Any:
    """Stand-in that rebuilds an array in pickle protocol 5."""
    return np.frombuffer(buffer, dtype=kind.dtype).reshape(shape, order=order)


def _scalar(kind: NumberType, data: bytes) -> Any:
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
"""Allowed names of untrusted files, by module and name, and their stand-ins."""


class AllowListUnpickler(pickle.Unpickler):
    """Reads pickles of arrays, numbers and plain containers."""

    allowed: ClassVar[dict[tuple[str, str], Any]] = ALLOWED

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in for a name; nothing is ever imported for it."""
        if (module, name) not in self.allowed:
            raise DisallowedNameError(f"{module}.{name}")
        return self.allowed[module, name]


MAGIC: Final = 0x1950A86A20F9469CFC6C
FORMAT: Final = 1001
STORAGES: Final = {
    "FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "BFloat16Storage": "<u2", "LongStorage": "<i8",
    "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1", "BoolStorage": "|b1",
}  # fmt: skip
"""Classes of storages of real numbers, and how these are stored."""
_COUNT_BYTES: Final = 8


class LegacyStorage:
    """Stored (N,) numbers of a tensor."""

    __slots__ = ("values",)

    def __init__(self, values: NDArray[Any]) -> None:
        self.values = values

    def __setstate__(self, state: Any) -> None:
        raise DisallowedNameError("a storage with a state")


class _StorageClass:
    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name

    def __setstate__(self, state: Any) -> None:
        raise DisallowedNameError(f"a state for torch.{self.name}")


class _StorageId:
    __slots__ = ("count", "key", "kind")

    def __init__(self, kind: str, key: str, count: int) -> None:
        self.kind, self.key, self.count = kind, key, count

    def __setstate__(self, state: Any) -> None:
        raise DisallowedNameError("a storage with a state")


class _PlainUnpickler(pickle.Unpickler):
    """Whole numbers, texts and dictionaries: no names at all."""

    def find_class(self, module: str, name: str) -> Any:
        """Never."""
        raise DisallowedNameError(f"{module}.{name}, hidden in the bytes of a tensor")

    def persistent_load(self, pid: Any) -> Any:
        """Never."""
        raise DisallowedNameError("a persistent id, hidden in the bytes of a tensor")


class _StorageUnpickler(_PlainUnpickler):
    """One storage, named by a persistent id."""

    def find_class(self, module: str, name: str) -> Any:
        """The classes of storages."""
        if module != "torch" or name not in STORAGES:
            return super().find_class(module, name)
        return _StorageClass(name)

    def persistent_load(self, pid: Any) -> Any:
        """The storage of an id; the former device of its numbers (``cuda:0``) does not matter."""
        if not isinstance(pid, tuple) or len(pid) not in (5, 6) or pid[0] != "storage" or pid[5:] not in ((), (None,)):
            raise DisallowedNameError("a persistent id that names no storage")
        _, kind, key, _, count = pid[:5]
        if not isinstance(kind, _StorageClass) or not isinstance(key, str) or type(count) is not int or count < 0:
            raise DisallowedNameError("a persistent id that names no storage")
        return _StorageId(kind.name, key, count)


def read_legacy_storage(data: Any) -> LegacyStorage:
    """Numbers of a storage that `torch.save` wrote in its old form.

    Raises `DisallowedNameError` if the stream asks for anything but storages; any other error is one of a damaged
    pickle.
    """
    if not isinstance(data, bytes | bytearray):
        raise DisallowedNameError("torch.storage._load_from_bytes of something other than bytes")
    if data[:2] == b"PK":
        raise DisallowedNameError("a zip archive in the bytes of a tensor")
    stream = io.BytesIO(data)
    magic, form, system = (_PlainUnpickler(stream).load() for _ in range(3))
    if magic != MAGIC or form != FORMAT or not isinstance(system, dict) or system.get("little_endian") is not True:
        raise UnencodableValueError("the bytes of a tensor are not what PyTorch writes on ordinary machines")
    place, keys = _StorageUnpickler(stream).load(), _PlainUnpickler(stream).load()
    if not isinstance(place, _StorageId) or keys != [place.key]:
        raise UnencodableValueError("the bytes of a tensor hold something other than one storage")
    count = int.from_bytes(stream.read(_COUNT_BYTES), "little")
    numbers = data[stream.tell() :]
    dtype = np.dtype(STORAGES[place.kind])
    if count != place.count or count * dtype.itemsize != len(numbers):
        raise UnencodableValueError(
            f"a tensor declares {to_one_line(place.count, 40)} numbers and holds {len(numbers)} bytes"
        )
    values: NDArray[Any] = np.frombuffer(numbers, dtype)
    if place.kind == "BFloat16Storage":
        values = (values.astype(np.uint32) << 16).view(np.float32)
    return LegacyStorage(values)
