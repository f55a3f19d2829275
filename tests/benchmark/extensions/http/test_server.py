"""The server as sockets see it: routes, bounds, malformed requests, and that it goes on answering."""

import gc
import json
import socket
import threading
import time
from collections.abc import Iterator

import httpx2
import pytest

from benchmark.errors import InputError
from benchmark.extensions.http import server as served
from benchmark.extensions.http.server import PlannerServer, RequestBounds
from benchmark.extensions.http.session import PlannerSession, build_request
from benchmark.extensions.http.values import HttpImageFormat
from benchmark.planning import Observation, Plan
from tests.benchmark.closed_loop.seeing import Looking
from tests.benchmark.extensions.http.made import observed
from tests.benchmark.extensions.http.malformed import answered, malformed, posted


@pytest.fixture(scope="module")
def server() -> Iterator[PlannerServer]:
    with PlannerServer(PlannerSession(Looking(), tensors=True)) as found:
        yield found


def ask(server: PlannerServer, method: str, path: str, body: bytes = b"", **headers: str) -> httpx2.Response:
    with httpx2.Client(trust_env=False, verify=False, timeout=20.0) as client:
        return client.request(method, server.url + path, content=body, headers=headers)


def body(index: int) -> bytes:
    return build_request(observed(index), HttpImageFormat.TORCH).encoded()


@pytest.mark.path
def test_the_three_routes(server: PlannerServer) -> None:
    assert ask(server, "GET", "/alive").text == "true"
    assert ask(server, "POST", "/reset", b"{}").text == "true"
    reply = ask(server, "POST", "/infer", body(0))
    assert reply.status_code == 200 and reply.headers["content-type"] == "application/json"
    # Written as Python's json writes it, and one connection a request.
    assert json.dumps(reply.json()) == reply.text and reply.headers["connection"] == "close"
    assert list(reply.json()) == ["trajectory", "aux_outputs"] and set(reply.json()["aux_outputs"].values()) == {None}
    assert ask(server, "POST", "/infer", body(0)).status_code == 409
    assert ask(server, "POST", "/reset", b"whatever it says").status_code == 200
    assert ask(server, "POST", "/infer", body(0)).text == reply.text


def test_other_routes_pages_of_browsers_and_packed_bodies_are_refused(server: PlannerServer) -> None:
    for method, path, status in (
        ("GET", "/infer", 405),
        ("PUT", "/reset", 405),
        ("GET", "/", 404),
        ("GET", "/etc/x", 404),
    ):
        reply = ask(server, method, path)
        assert reply.status_code == status and "POST /infer" in reply.json()["detail"]
    assert ask(server, "POST", "/reset", b"{}", origin="http://evil.example").status_code == 403
    assert ask(server, "POST", "/infer", b"{}", **{"content-encoding": "gzip"}).status_code == 415


def test_the_first_refusal_of_a_kind_is_a_line_on_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    with PlannerServer(PlannerSession(Looking())) as strict:
        for _ in range(3):
            assert ask(strict, "POST", "/infer", b"{}", **{"content-encoding": "gzip"}).status_code == 415
            assert ask(strict, "POST", "/infer", body(0)).status_code == 415
            assert ask(strict, "POST", "/infer", b"{}").status_code == 422
            assert ask(strict, "GET", "/get_actors%0Afake%1b[2J").status_code == 404
    packed, tensors, unreadable, unknown = capfd.readouterr().err.splitlines()
    assert "refused POST /infer (status 415)" in packed and "uncompressed" in packed
    assert "CAM_FRONT" in tensors and "start the server with --accept-torch-tensors" in tensors
    assert "the request has no images" in unreadable and "docs/extensions/http.md" in unreadable
    assert "GET /get_actors" in unknown and "use GET /alive" in unknown and "\x1b" not in unknown


def test_a_sample_of_malformed_requests(server: PlannerServer, capfd: pytest.CaptureFixture[str]) -> None:
    for name, sent, whole in malformed(48, seed=1):
        reply = answered(server.port, sent, whole)
        # A change by chance may leave a request as good as it was.
        assert reply[9:10] in (b"4", b"2") or not (reply or whole), (name, reply[:80])
    assert ask(server, "GET", "/alive").text == "true"
    assert ask(server, "POST", "/reset").text == "true" and ask(server, "POST", "/infer", body(0)).status_code == 200
    said = capfd.readouterr()
    assert "Traceback" not in said.err + said.out and "Error" not in said.err


def test_requests_leave_nothing_behind(server: PlannerServer) -> None:
    sample = [(sent, whole) for _, sent, whole in malformed(24, seed=2)]
    for each in sample:
        answered(server.port, *each)
    gc.collect()
    before = len(gc.get_objects())
    for each in sample:
        answered(server.port, *each)
    gc.collect()
    assert len(gc.get_objects()) < before + 2000


def test_a_body_is_bounded_in_size_and_time() -> None:
    bounds = RequestBounds(body_bytes=50_000, body_s=0.3)
    with PlannerServer(PlannerSession(Looking()), bounds=bounds) as small:
        assert ask(small, "POST", "/infer", bytes(50_001)).status_code == 413
        chunks = (bytes(10_000) for _ in range(9))
        with httpx2.Client(trust_env=False, verify=False) as client:
            assert client.post(f"{small.url}/infer", content=chunks).status_code == 413
        with socket.create_connection(("127.0.0.1", small.port), timeout=10) as slow:
            slow.sendall(posted(bytes(40_000))[:2000])
            assert slow.recv(100).startswith(b"HTTP/1.1 408")
        assert ask(small, "GET", "/alive").text == "true"


def test_a_connection_that_asks_for_nothing_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "HEADER_S", 0.2)
    with PlannerServer(PlannerSession(Looking())) as small:
        for sent in (b"", b"POST /infer HTTP/1.1\r\nhost:"):
            with socket.create_connection(("127.0.0.1", small.port), timeout=10) as idle:
                idle.sendall(sent)
                assert idle.recv(100) == b""


class Slow(Looking):
    """Plans when it is told to."""

    name = "slow"

    def __init__(self) -> None:
        super().__init__()
        self.begun, self.go_on = threading.Event(), threading.Event()

    def plan(self, observation: Observation) -> Plan:
        self.begun.set()
        self.go_on.wait(20.0)
        return super().plan(observation)


def test_alive_answers_while_a_plan_is_made_and_requests_wait_for_their_turn() -> None:
    planner = Slow()
    with PlannerServer(PlannerSession(planner, tensors=True)) as busy:
        replies: list[int] = []
        threads = [
            threading.Thread(
                target=lambda index=index: replies.append(ask(busy, "POST", "/infer", body(index)).status_code)
            )
            for index in (0, 1)
        ]
        threads[0].start()
        assert planner.begun.wait(10.0)
        assert ask(busy, "GET", "/alive").text == "true"
        threads[1].start()
        assert ask(busy, "GET", "/alive").text == "true" and not replies
        planner.go_on.set()
        for thread in threads:
            thread.join(20.0)
        assert replies == [200, 200]


def test_a_plan_that_takes_too_long_is_given_up_and_the_next_waits() -> None:
    planner = Slow()
    with PlannerServer(PlannerSession(planner, tensors=True), bounds=RequestBounds(answer_s=0.2)) as busy:
        reply = ask(busy, "POST", "/infer", body(0))
        assert reply.status_code == 504 and "within 0.2 s" in reply.json()["detail"]
        planner.go_on.set()
        until = time.monotonic() + 10.0
        while ask(busy, "POST", "/reset", b"{}").status_code != 200:
            assert time.monotonic() < until
        assert ask(busy, "POST", "/infer", body(0)).status_code == 200


def test_it_listens_on_this_machine_alone_and_says_what_is_taken() -> None:
    first = PlannerServer(PlannerSession(Looking()))
    assert first.host == "127.0.0.1" and not first.is_open and str(first.port) in first.url
    with pytest.raises(InputError, match=f"port {first.port}.*choose another --port"):
        PlannerServer(PlannerSession(Looking()), port=first.port)
    with pytest.raises(InputError, match="cannot listen on no-such-host"):
        PlannerServer(PlannerSession(Looking()), host="no-such-host.invalid")
    first.close()
    opened = PlannerServer(PlannerSession(Looking()), host="0.0.0.0")
    assert opened.is_open
    opened.close()
