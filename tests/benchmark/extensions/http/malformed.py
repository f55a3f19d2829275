"""Malformed requests: bytes that are no HTTP, bodies that are no JSON, members that cannot be, and chance.

Shared by the tests (a sample) and by ``bench/attack.py`` (a thousand).
"""

import contextlib
import random
import socket
from collections.abc import Iterator
from typing import Any, NamedTuple

from benchmark.extensions.http.session import build_request
from benchmark.extensions.http.values import HttpImageFormat
from tests.benchmark.extensions.http.made import observed
from tests.benchmark.untrusted.mutations import BYTES, JSON, become

_VALUES: tuple[Any, ...] = (
    -1, 0, "/etc/passwd", "A" * 3000, [[]], {}, [[1]] * 3, [None] * 16, {"CAM_FRONT": "x"}, [[0.0] * 4] * 4,
)  # fmt: skip
_MEMBERS = (*JSON, *(become(f"{type(value).__name__} {number}", value) for number, value in enumerate(_VALUES)))
_HEADS: tuple[bytes, ...] = (
    b"", b"\r\n\r\n", b"\x00\x01\x02", b"GET", b"GET /infer HTTP/1.1\r\n\r\n", b"POST /infer HTTP/9.9\r\n\r\n",
    b"PUT /infer HTTP/1.1\r\nhost: x\r\n\r\n", b"GET /../../etc/passwd HTTP/1.1\r\nhost: x\r\n\r\n",
    b"GET /%00 HTTP/1.1\r\nhost: x\r\n\r\n", b"POST /infer HTTP/1.1\r\nhost: x\r\ncontent-length: -5\r\n\r\n",
    b"POST /infer HTTP/1.1\r\nhost: x\r\ncontent-length: 99999999999999999999\r\n\r\n",
    b"POST /infer HTTP/1.1\r\nhost: x\r\ncontent-length: 10\r\n\r\nabc",
    b"POST /infer HTTP/1.1\r\nhost: x\r\ntransfer-encoding: chunked\r\n\r\nZZ\r\n",
    b"POST /infer HTTP/1.1\r\nhost: x\r\ncontent-encoding: gzip\r\ncontent-length: 2\r\n\r\n{}",
    b"POST /infer HTTP/1.1\r\nhost: x\r\norigin: http://evil\r\ncontent-length: 2\r\n\r\n{}",
    b"GET /alive HTTP/1.1\r\nhost: x\r\nx: " + b"y" * 70_000 + b"\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    b"GET /infer HTTP/1.1\r\nupgrade: websocket\r\nconnection: upgrade\r\nhost: x\r\n\r\n",
)  # fmt: skip


class Request(NamedTuple):
    """What a server is sent: how it is malformed, the bytes for a socket, and whether they are a whole request."""

    name: str
    sent: bytes
    whole: bool


def posted(body: bytes, path: str = "/infer") -> bytes:
    """A whole request."""
    head = f"POST {path} HTTP/1.1\r\nhost: x\r\ncontent-type: application/json\r\ncontent-length: {len(body)}"
    return f"{head}\r\n\r\n".encode() + body


def malformed(count: int, seed: int = 0) -> Iterator[Request]:
    """Requests; the same of the same seed."""
    chance = random.Random(seed)
    forms = {form: build_request(observed(), form).encoded() for form in HttpImageFormat}
    for number in range(count):
        whole = forms[chance.choice(list(HttpImageFormat))]
        if number % 4 == 0:
            head = chance.choice(_HEADS)
            yield Request(f"{head[:60]!r}", head, False)
        elif number % 4 == 1:
            path = chance.choice(("/infer", "/infer", "/reset", "/nowhere"))
            yield Request(f"{path}, truncated", posted(whole[: chance.randrange(len(whole))], path), True)
        else:
            mutation = chance.choice(_MEMBERS if number % 4 == 2 else BYTES)
            yield Request(mutation.name, posted(mutation.change(whole, chance)), True)


def answered(port: int, sent: bytes, whole: bool, patience_s: float = 20.0) -> bytes:
    """All that a server answers to bytes; empty where it hangs up. What is no whole request is broken off soon."""
    with socket.create_connection(("127.0.0.1", port), timeout=patience_s) as there:
        # A server that has seen enough hangs up while it is sent more.
        with contextlib.suppress(OSError):
            there.sendall(sent)
        there.settimeout(patience_s if whole else 0.05)
        parts = []
        with contextlib.suppress(ConnectionError, TimeoutError):
            while part := there.recv(65536):
                parts.append(part)
        return b"".join(parts)
