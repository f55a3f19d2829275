"""Foreign protobuf messages are counted on the wire, before they become objects."""

import time
import tracemalloc

import pytest

from benchmark.untrusted.files import Limits
from benchmark.untrusted.protobuf_messages import require_message

INNER = {"list": {1: "list", 2: "leaf"}, "leaf": {}}
LIMITS = Limits("message", 1 << 20, depth=4, values=1000)


def require(data: bytes) -> None:
    require_message(data, "list", INNER.__getitem__, LIMITS)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x12\x00" * 1000,
        b"\x0a\x04\x0a\x02\x12\x00",
        b"\x18\x96\x01",
        b"\x19" + bytes(8),
        b"\x1d" + bytes(4),
        # Unknown bytes are not looked into.
        b"\x22\x02\xff\xff",
    ],
)
def test_messages_pass(data: bytes) -> None:
    require(data)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x12\x00" * 1001, "more than 1000 fields"),
        (b"\x0a\x08\x0a\x06\x0a\x04\x0a\x02\x0a\x00", "nested more than 4 deep"),
        (b"\x12\x05\x00", "cut off"),
        (b"\x18\x80", "does not end"),
        (b"\x18" + b"\xff" * 11, "does not end"),
        (b"\x0b", "type 3"),
        (b"\x00\x00", "no message"),
        (b"\x19\x00", "cut off"),
        (bytes(LIMITS.file_bytes + 1), "at most"),
    ],
)
def test_what_is_no_message_or_too_much_is_a_sentence(data: bytes, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        require(data)


def test_a_large_message_of_nothing_costs_nothing() -> None:
    data = b"\x12\x00" * (LIMITS.file_bytes // 2)
    tracemalloc.start()
    started = time.perf_counter()
    with pytest.raises(ValueError, match="fields"):
        require(data)
    assert time.perf_counter() - started < 0.5
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
