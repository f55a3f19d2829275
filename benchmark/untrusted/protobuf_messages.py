"""Foreign protobuf messages, counted on the wire before they are objects: two bytes may become a hundred."""

from collections.abc import Callable, Mapping
from typing import Final

from benchmark.untrusted.files import Limits, format_bytes

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_LONGEST_VARINT: Final = 10


def require_message(data: bytes, name: str, inner: Callable[[str], Mapping[int, str]], limits: Limits) -> None:
    """Raise `ValueError` for bytes that are no message, or one with more bytes, levels or fields than its kind has.

    Args:
        data: The bytes.
        name: The message.
        inner: Gives the messages within a message, by the number of their field.
        limits: ``file_bytes``, ``depth`` and ``values``; these are fields, each counted as often as it is there.
    """
    if len(data) > limits.file_bytes:
        raise ValueError(f"it has {format_bytes(len(data))}, but a {limits.what} has at most {limits.file_bytes} bytes")
    left = limits.values
    waiting = [(0, len(data), name, 1)]
    while waiting:
        at, end, of, depth = waiting.pop()
        if depth > limits.depth:
            raise ValueError(f"its parts are nested more than {limits.depth} deep")
        messages = inner(of)
        while at < end:
            left -= 1
            if left < 0:
                raise ValueError(f"it has more than {limits.values} fields")
            tag, at = _read_varint(data, at, end)
            kind = tag & 7
            if kind == _BYTES:
                length, at = _read_varint(data, at, end)
                if (within := messages.get(tag >> 3)) is not None and at + length <= end:
                    waiting.append((at, at + length, within, depth + 1))
                at += length
            elif kind == _VARINT:
                _, at = _read_varint(data, at, end)
            elif kind in (_EIGHT, _FOUR):
                at += 8 if kind == _EIGHT else 4
            else:
                raise ValueError(f"it is no message of this kind: a field of {of} has the type {kind}")
            if at > end or tag >> 3 == 0:
                raise ValueError(f"it is cut off or no message of this kind, in {of}")


def _read_varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where it ends."""
    value = 0
    for shift in range(_LONGEST_VARINT):
        if at >= end:
            break
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            return value, at
    raise ValueError("it is cut off or no message: a number in it does not end")
