"""One request over a socket: what is late is late, however it comes."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from benchmark.extensions.http.connection import HttpConnection
from benchmark.planning import PlannerLateError


@pytest.fixture(params=[b"x: ", b"\r\n", b"content-length: 1000\r\n\r\n"], ids=["headers", "a body", "a known length"])
def dripping(request: pytest.FixtureRequest) -> Iterator[str]:
    """The address of a server whose answer never ends: a byte each 0.05 s."""
    listening = socket.create_server(("127.0.0.1", 0))

    def drip() -> None:
        stream, _ = listening.accept()
        with stream:
            stream.sendall(b"HTTP/1.1 200 OK\r\n" + request.param)
            try:
                for _ in range(200):
                    stream.sendall(b"a")
                    time.sleep(0.05)
            except OSError:
                pass

    thread = threading.Thread(target=drip, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{listening.getsockname()[1]}"
    listening.close()
    thread.join(5.0)


def test_what_drips_in_byte_by_byte_is_late(dripping: str) -> None:
    began = time.monotonic()
    with pytest.raises(PlannerLateError, match=r"did not answer /alive within 0\.5 s"):
        HttpConnection(dripping, "the model server", 60.0).get("/alive", 0.5)
    assert time.monotonic() - began < 4.0
