"""Answers of the child process: plain values as JSON, arrays as bytes behind it; nothing in it is a pickle.

Every object of the JSON stands for one value that JSON does not have, named by its only key: ``d`` a dictionary,
``o`` an ordered one, ``u`` one with defaults, ``t`` a tuple, ``s`` and ``f`` sets, ``b`` and ``y`` bytes, ``c`` a
complex number, ``a`` an array, ``n`` a number of numpy.
"""

import json
import math
from collections import OrderedDict, defaultdict
from collections.abc import Callable
from typing import Any, BinaryIO, Final, Literal

import numpy as np
from numpy.typing import NDArray

from benchmark.untrusted.files import Limits

_ALIGNED_BYTES: Final = 64
_PLAIN: Final = frozenset({bool, int, float, str, type(None)})
_NUMBERS: Final = "biufcSU"
_FACTORIES: Final[dict[str, Any]] = {kind.__name__: kind for kind in (dict, list, set, int, float, str, bool, tuple)}


class UnencodableValueError(Exception):
    """A value that is too deep, too large or of a kind that no recording holds; says which."""


class _AnswerEncoder:
    """Turns a value into JSON and a list of buffers, with every limit counted on the way."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self.buffers: list[Any] = []
        self.values = self.bytes = 0
        # Kept alive, so that no other object gets the same `id`.
        self._places: dict[int, tuple[int, Any]] = {}

    def encoded(self, value: Any, depth: int) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            self._count(1)
            return value
        if depth > self.limits.depth:
            raise UnencodableValueError(f"its containers are nested more than {self.limits.depth} deep")
        if kind is list:
            return self._items(value, depth)
        writer = _WRITERS.get(kind)
        if writer is not None:
            return writer(self, value, depth)
        if isinstance(value, np.ndarray):
            return {"a": self._array(value)}
        if isinstance(value, np.generic) and value.dtype.kind in _NUMBERS:
            self._count(1)
            return {"n": [value.dtype.str, value.tobytes().hex()]}
        raise UnencodableValueError(
            f"it holds a {kind.__name__.strip('_')}, which is neither an array nor a plain value"
        )

    def _count(self, values: int) -> None:
        self.values += values
        if self.values > self.limits.values:
            raise UnencodableValueError(f"it holds more than {self.limits.values} values")

    def _items(self, items: Any, depth: int) -> list[Any]:
        self._count(1)
        if set(map(type, items)) <= _PLAIN:
            self._count(len(items))
            return list(items)
        return [self.encoded(item, depth + 1) for item in items]

    def _pairs(self, value: Any, depth: int) -> list[Any]:
        self._count(1)
        pairs: list[Any] = []
        # Not its own methods: untrusted attributes of an ordered dictionary can hide them.
        for key, member in dict.items(value):
            if type(key) is str and len(key) > self.limits.name_characters:
                raise UnencodableValueError(f"it holds a name of more than {self.limits.name_characters} characters")
            pairs.append(self.encoded(key, depth + 1))
            pairs.append(self.encoded(member, depth + 1))
        return pairs

    def _buffer(self, value: Any, data: Any, count: int) -> int:
        known = self._places.get(id(value))
        if known is not None:
            return known[0]
        self._count(1)
        self.bytes += count + _ALIGNED_BYTES
        if self.bytes > self.limits.content_bytes:
            raise UnencodableValueError(f"it holds more than {self.limits.content_bytes} bytes")
        self.buffers.append(data)
        self._places[id(value)] = len(self.buffers) - 1, value
        return len(self.buffers) - 1

    def _array(self, value: NDArray[Any]) -> list[Any]:
        if value.dtype.kind not in _NUMBERS:
            raise UnencodableValueError(f"it holds an array of {value.dtype}")
        order: Literal["C", "F"] = "F" if value.flags.fnc else "C"
        self._count(1)
        flat = np.ascontiguousarray(np.ndarray.view(value, np.ndarray).reshape(-1, order=order)).view(np.uint8)
        return [self._buffer(value, flat, flat.nbytes), value.dtype.str, list(value.shape), order]

    def _bytes(self, value: Any, _: int) -> int:
        self._count(1)
        return self._buffer(value, np.frombuffer(value, np.uint8), len(value))

    def _defaults(self, value: Any, depth: int) -> list[Any]:
        name = getattr(value.default_factory, "__name__", None)
        return [name if name in _FACTORIES else None, *self._pairs(value, depth)]


_WRITERS: Final[dict[type, Callable[[_AnswerEncoder, Any, int], Any]]] = {
    dict: lambda writer, value, depth: {"d": writer._pairs(value, depth)},
    OrderedDict: lambda writer, value, depth: {"o": writer._pairs(value, depth)},
    defaultdict: lambda writer, value, depth: {"u": writer._defaults(value, depth)},
    tuple: lambda writer, value, depth: {"t": writer._items(value, depth)},
    set: lambda writer, value, depth: {"s": writer._items(value, depth)},
    frozenset: lambda writer, value, depth: {"f": writer._items(value, depth)},
    bytes: lambda writer, value, depth: {"b": writer._bytes(value, depth)},
    bytearray: lambda writer, value, depth: {"y": writer._bytes(value, depth)},
    complex: lambda _, value, __: {"c": [value.real, value.imag]},
}


def write_answer(stream: BinaryIO, value: Any, limits: Limits) -> None:
    """Write a value of plain containers and arrays, which `read_answer` gives back.

    Raises `UnencodableValueError` if it exceeds the limits or holds anything else.
    """
    writer = _AnswerEncoder(limits)
    try:
        body = writer.encoded(value, 0)
        sizes = [buffer.nbytes for buffer in writer.buffers]
        text = json.dumps([body, sizes], ensure_ascii=False, check_circular=False).encode()
    except UnicodeEncodeError:
        raise UnencodableValueError("it holds text that is not Unicode") from None
    stream.write(len(text).to_bytes(8, "little") + text + bytes(-(len(text) + 8) % _ALIGNED_BYTES))
    for buffer in writer.buffers:
        stream.write(buffer.data)
        stream.write(bytes(-buffer.nbytes % _ALIGNED_BYTES))


def read_answer(data: bytearray) -> Any:
    """The value that `write_answer` wrote; arrays are views of ``data``. Any error is one of malformed data."""
    length = int.from_bytes(data[:8], "little")
    if not data or length > len(data) - 8:
        raise ValueError("a short answer")
    parts: list[NDArray[np.uint8]] = []

    def value_of(tagged: dict[str, Any]) -> Any:
        ((tag, content),) = tagged.items()
        return _READERS[tag](content, parts)

    text = bytes(memoryview(data)[8 : 8 + length])
    sizes = json.loads(text[text.rindex(b"[") : -1])
    place = -(-(length + 8) // _ALIGNED_BYTES) * _ALIGNED_BYTES
    data_bytes = np.frombuffer(data, np.uint8)
    for size in sizes:
        if not 0 <= size <= len(data_bytes) - place:
            raise ValueError("a short buffer")
        parts.append(data_bytes[place : place + size])
        place += -(-size // _ALIGNED_BYTES) * _ALIGNED_BYTES
    return json.loads(text, object_hook=value_of)[0]


def _dictionary(kind: Any, pairs: list[Any]) -> Any:
    following = iter(pairs)
    return kind(zip(following, following, strict=True))


def _array_of(content: list[Any], parts: list[NDArray[np.uint8]]) -> NDArray[Any]:
    place, dtype, shape, order = content
    number_type = _number_type(dtype)
    if number_type.itemsize == 0 or math.prod(shape) == 0:
        return np.zeros(shape, number_type, order=order)
    held_numbers: NDArray[Any] = parts[place].view(number_type).reshape(shape, order=order)
    return held_numbers


def _number_type(name: str) -> np.dtype[Any]:
    number_type = np.dtype(name)
    if number_type.kind not in _NUMBERS:
        raise ValueError(f"an array of {number_type}")
    return number_type


def _scalar(kind: np.dtype[Any], data: bytes) -> Any:
    return np.frombuffer(data, kind, count=1)[0] if kind.itemsize else kind.type()


_READERS: Final[dict[str, Callable[[Any, list[NDArray[np.uint8]]], Any]]] = {
    "d": lambda held, _: _dictionary(dict, held),
    "o": lambda held, _: _dictionary(OrderedDict, held),
    "u": lambda held, _: defaultdict(_FACTORIES.get(held[0]), _dictionary(dict, held[1:])),
    "t": lambda held, _: tuple(held),
    "s": lambda held, _: set(held),
    "f": lambda held, _: frozenset(held),
    "b": lambda held, parts: parts[held].tobytes(),
    "y": lambda held, parts: bytearray(parts[held].tobytes()),
    "c": lambda held, _: complex(*held),
    "a": _array_of,
    "n": lambda held, _: _scalar(_number_type(held[0]), bytes.fromhex(held[1])),
}
