"""Model servers that answer anything but what was asked: a good one, of whose answers one is changed."""

import contextlib
import json
import socket
import struct
import threading
import time
from collections.abc import Callable
from http.client import parse_headers
from random import Random
from socketserver import StreamRequestHandler, ThreadingTCPServer
from typing import Any, Final, Self

from tests.benchmark.untrusted.mutations import FORMS
from tests.benchmark.untrusted.variants import DEEP

_FUTURES: Final = [[[[1.0 * step, 0.0] for step in range(1, 7)]]]
_AUX: Final = {
    "objects_in_bev": [[12.0, 3.5, 4.6, 1.9, 0.0]],
    "object_classes": ["vehicle.car"],
    "object_scores": [0.9],
    "object_ids": [3],
    "future_trajs": _FUTURES,
}
GOOD_PLAN: Final = json.dumps({"trajectory": [[4.0 * step, 0.1] for step in range(1, 7)], "aux_outputs": _AUX}).encode()
BODIES: Final = 80
"""Changes of chance of a good plan."""
_LONGEST_REQUEST_S: Final = 60.0
_ENDLESS_BYTES: Final = 1 << 30


def reply(body: bytes, status: str = "200 OK", *headers: str, length: int | str | None = None) -> bytes:
    """An answer; its length is said truly unless told."""
    header_lines = [
        f"content-length: {len(body) if length is None else length}",
        "content-type: application/json",
        *headers,
    ]
    return b"\r\n".join(
        [f"HTTP/1.1 {status}".encode(), *(header.encode("latin-1") for header in header_lines), b"", body]
    )


_HEAD: Final = b"HTTP/1.1 200 OK\r\ncontent-type: application/json\r\n"
_CHUNKED: Final = _HEAD + b"transfer-encoding: chunked\r\n\r\n"
ANSWERS: Final[dict[str, bytes]] = {
    "nothing": b"",
    "no HTTP": b"SSH-2.0-OpenSSH_9.6\r\n",
    "half a status line": b"HTTP/1.1 2",
    "HTTP of another century": GOOD_PLAN,
    "HTTP/9.9": b"HTTP/9.9 200 OK\r\n\r\n" + GOOD_PLAN,
    "status 0": reply(GOOD_PLAN, "0 OK"),
    "status 99999": reply(GOOD_PLAN, "99999 OK"),
    "status -1": reply(GOOD_PLAN, "-1 OK"),
    "a status in other figures": b"HTTP/1.1 \xd9\xa2\xd9\xa0\xd9\xa0 OK\r\n\r\n" + GOOD_PLAN,
    "10^5 times 100 Continue": b"HTTP/1.1 100 Continue\r\n\r\n" * 100_000 + reply(GOOD_PLAN),
    "101 Switching Protocols": reply(b"", "101 Switching Protocols", "upgrade: websocket", "connection: upgrade"),
    "204 with a body": reply(GOOD_PLAN, "204 No Content"),
    "301 to itself": reply(b"", "301 Moved Permanently", "location: /infer"),
    "302 to a file": reply(b"", "302 Found", "location: file:///etc/passwd"),
    "304": reply(b"", "304 Not Modified"),
    "401": reply(b"", "401 Unauthorized", 'www-authenticate: Basic realm="a"'),
    "407": reply(b"", "407 Proxy Authentication Required"),
    "418 with a plan": reply(GOOD_PLAN, "418 I'm a teapot"),
    "500 with a page": reply(b"<html><script>alert(1)</script></html>", "500 Internal Server Error"),
    "500 with escapes": reply(b'{"detail": "\\u001b[31mred\\nand more"}', "500 Internal Server Error"),
    "500 with 10^6 letters": reply(b'{"detail": "' + b"x" * 1_000_000 + b'"}', "500 Internal Server Error"),
    "503": reply(b'{"detail": "busy"}', "503 Service Unavailable", "retry-after: 999999999"),
    "200 with a page": reply(b"<!DOCTYPE html><title>router</title>"),
    "a length of -1": reply(GOOD_PLAN, length=-1),
    "a length of 10^30": reply(GOOD_PLAN, length=10**30),
    "a length that is text": reply(GOOD_PLAN, length="many"),
    "two lengths": reply(GOOD_PLAN, "200 OK", "content-length: 3"),
    "less than it says": reply(GOOD_PLAN, length=len(GOOD_PLAN) + 10),
    "more than it says": reply(GOOD_PLAN, length=len(GOOD_PLAN) - 10),
    "no length": _HEAD + b"\r\n" + GOOD_PLAN,
    "a chunk of no number": _CHUNKED + b"zz\r\n" + GOOD_PLAN,
    "a chunk of 2^64": _CHUNKED + b"ffffffffffffffff\r\n" + GOOD_PLAN,
    "a chunk of -1": _CHUNKED + b"-1\r\n" + GOOD_PLAN,
    "chunks without an end": _CHUNKED + b"1\r\n{\r\n",
    "10^6 empty headers": b"HTTP/1.1 200 OK\r\n" + b"a:\r\n" * 1_000_000 + b"\r\n" + GOOD_PLAN,
    "a header of 10^7 letters": b"HTTP/1.1 200 OK\r\na: " + b"x" * 10_000_000 + b"\r\n\r\n" + GOOD_PLAN,
    "a header with a zero byte": b"HTTP/1.1 200 OK\r\na\0b: c\r\n\r\n" + GOOD_PLAN,
    "a header that is folded": b"HTTP/1.1 200 OK\r\na: b\r\n c\r\n\r\n" + GOOD_PLAN,
    "a header without a name": b"HTTP/1.1 200 OK\r\n: c\r\n\r\n" + GOOD_PLAN,
    "line ends of one kind": reply(GOOD_PLAN).replace(b"\r\n", b"\n"),
    "a body that is said to be packed": reply(GOOD_PLAN, "200 OK", "content-encoding: gzip"),
    "a body packed in what nobody knows": reply(GOOD_PLAN, "200 OK", "content-encoding: klingon"),
    "cookies": reply(GOOD_PLAN, "200 OK", "set-cookie: a=b; domain=.com; max-age=-1"),
    "another character set": reply(GOOD_PLAN.decode().encode("utf-16"), "200 OK"),
    "a mark of the order of bytes": reply(b"\xef\xbb\xbf" + GOOD_PLAN),
    "the answer twice": reply(GOOD_PLAN) * 2,
    "nested 10^5 deep": reply(b'{"trajectory": ' + DEEP.encode() + b', "aux_outputs": {}}'),
    "10^6 numbers": reply(b'{"trajectory": [' + b"[1, 2]," * 500_000 + b'[1, 2]], "aux_outputs": {}}'),
    "10^8 blanks": reply(GOOD_PLAN + b" " * 100_000_000),
    "a number of 10^5 digits": reply(b'{"trajectory": [[' + b"9" * 100_000 + b', 0]], "aux_outputs": {}}'),
    "a plan of the other side of the earth": reply(GOOD_PLAN.replace(b"24.0", b"2e7")),
    "the same key twice": reply(GOOD_PLAN[:-1] + b', "trajectory": null}'),
    "comments": reply(b"// a plan\n" + GOOD_PLAN),
    "a plan in a list": reply(b"[" + GOOD_PLAN + b"]"),
    "text": reply(json.dumps(GOOD_PLAN.decode()).encode()),
}
"""Bytes by what they are; then the connection is closed."""
PATHS: Final = ("/alive", "/reset", "/infer")


def odd_answers() -> list[tuple[str, str]]:
    """Path and name of every odd answer."""
    bodies = [("/infer", f"change {number} of a plan") for number in range(BODIES)]
    return [*((path, name) for name in (*ANSWERS, *SLOW) for path in PATHS), *bodies]


def changed_plan(number: int) -> bytes:
    """An answer whose body is a good plan that chance has changed."""
    chance = Random(f"plan {number}")
    return reply(chance.choice(FORMS["json"]).change(GOOD_PLAN, chance))


class OddServer(ThreadingTCPServer):
    """A server in a thread of this process, that answers one path oddly and all others well.

    Attributes:
        url: Its address.
    """

    daemon_threads = True

    def __init__(self, path: str, name: str) -> None:
        super().__init__(("127.0.0.1", 0), _RequestHandler)
        self.path, self.name, self.ended = path, name, threading.Event()
        self.url = f"http://127.0.0.1:{self.server_address[1]}"
        self._thread = threading.Thread(target=self.serve_forever, args=(0.01,), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.shutdown()
        self.server_close()
        self._thread.join()

    def shutdown_request(self, request: Any) -> None:
        """Close without a word before: one answer is a connection that is reset."""
        self.close_request(request)


class _RequestHandler(StreamRequestHandler):
    """One request, and what is answered to it."""

    server: OddServer
    timeout = _LONGEST_REQUEST_S

    def handle(self) -> None:
        with contextlib.suppress(OSError):
            path, name = self._path(), self.server.name
            if path != self.server.path:
                self.connection.sendall(reply(GOOD_PLAN if path == "/infer" else b"true"))
            elif name in SLOW:
                SLOW[name](self.connection, self.server.ended)
            else:
                odd = ANSWERS[name] if name in ANSWERS else changed_plan(int(name.split()[1]))
                self.connection.sendall(odd)

    def _path(self) -> str:
        """Read the request, and say what it asks for."""
        asked = self.rfile.readline().decode("latin-1").split(" ")
        self.rfile.read(int(parse_headers(self.rfile).get("content-length", 0)))
        return asked[1] if len(asked) > 1 else ""


def _send_nothing(_: socket.socket, ended: threading.Event) -> None:
    ended.wait(_LONGEST_REQUEST_S)


def _send_slowly(connection: socket.socket, ended: threading.Event) -> None:
    for byte in reply(GOOD_PLAN):
        connection.sendall(bytes([byte]))
        if ended.wait(0.5):
            return


def _send_endlessly(connection: socket.socket, ended: threading.Event) -> None:
    connection.sendall(_HEAD + b"\r\n")
    until = time.monotonic() + _LONGEST_REQUEST_S
    for _ in range(_ENDLESS_BYTES >> 20):
        connection.sendall(b" " * (1 << 20))
        if ended.is_set() or time.monotonic() > until:
            return


def _reset_connection(connection: socket.socket, _: threading.Event) -> None:
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


SLOW: Final[dict[str, Callable[[socket.socket, threading.Event], None]]] = {
    "never": _send_nothing,
    "a byte each half second": _send_slowly,
    "without an end": _send_endlessly,
    "resets the connection": _reset_connection,
}
"""What is done instead of sending bytes at once."""
