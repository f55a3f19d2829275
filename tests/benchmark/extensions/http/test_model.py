"""The client: exactly NeuroNCAP's requests, never one twice, and a sentence for everything that can go wrong."""

import base64
import json
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adapters.registry import build_planner
from benchmark.closed_loop.planner_calls import Failure, FailureReason, notify_planner, request_plan
from benchmark.errors import InputError
from benchmark.extensions.http.model import HttpPlanner, http_planner
from benchmark.extensions.http.session import build_request
from benchmark.extensions.http.values import HttpImageFormat
from benchmark.machine.address import Address, is_address
from benchmark.planning import ModelFailedError, PlannerAwayError, PlannerGoneError, PlannerLateError, SceneInfo
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.untrusted.files import HTTP_ANSWER
from tests.benchmark.extensions.http.made import GOOD, SHARED, Reply, free_port, observed, scripted

SCENE = SceneInfo("scene-1", "boston-seaport", ())


def planner(url: str, form: str = "png", deadline_s: float = 20.0) -> HttpPlanner:
    return http_planner(url, image_format=form, deadline_s=deadline_s)


def good(path: str, body: bytes) -> Reply:
    return 200, GOOD if path == "/infer" else b"true"


@pytest.mark.path
@pytest.mark.parametrize("form", list(HttpImageFormat))
def test_the_requests_are_neuroncaps(form: HttpImageFormat) -> None:
    with scripted(good) as server:
        one = planner(server.url, form.value)
        one.require_alive()
        one.reset(SCENE)
        plan = one.plan(observed())
    assert plan.waypoints[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    assert [(method, path) for method, path, _, _ in server.asked] == [
        ("GET", "/alive"), ("POST", "/reset"), ("POST", "/infer"),
    ]  # fmt: skip
    alive, reset, infer = server.asked
    assert reset[3] == b"{}" and infer[3] == build_request(observed(), form).encoded()
    for _, _, headers, sent in (reset, infer):
        assert headers["content-type"] == "application/json" and headers["content-length"] == str(len(sent))
    assert set(alive[2]) == {"host", "accept", "connection", "user-agent"}
    assert set(infer[2]) == {*alive[2], "content-type", "content-length"}


@pytest.mark.skipif(not SHARED.exists(), reason="the recorded sessions are not here")
def test_a_recorded_server_is_driven_as_it_was() -> None:
    session = json.loads((SHARED / "session_plain.json").read_text())["exchanges"]
    recorded = [each for each in session if each["server"] == "model" and not each.get("left_out")]
    waiting = [each for each in recorded if each["path"] == "/infer"]

    def answer(path: str, body: bytes) -> Reply:
        if path != "/infer":
            return 200, b"true"
        return 200, waiting[[r[1] for r in server.asked].count("/infer") - 1]["response_body"].encode()

    with scripted(answer) as server:
        one = planner(server.url, "torch")
        one.require_alive()
        one.reset(SCENE)
        plans = [one.plan(observed(index)) for index in range(len(waiting))]
    assert server.paths == [each["path"] for each in recorded]
    for plan, each in zip(plans, waiting, strict=True):
        assert plan.waypoints.tolist() == json.loads(each["response_body"])["trajectory"]
    for (_, _, headers, body), each in zip(server.asked, recorded, strict=True):
        kept = {"host", "accept", "connection", "user-agent", "content-length", "content-type"}
        assert set(headers) == set(each["request_headers"]) <= kept
        assert headers["accept"] == each["request_headers"]["accept"]
        if each["path"] != "/infer":
            assert body.decode() == each["request_body"]


FAILURES: list[tuple[str, Reply, str]] = [
    ("an error page of a framework", (500, b'{"detail": "CUDA out of memory"}'), "status 500: CUDA out of memory"),
    ("pictures that it cannot read", (500, b"Internal Server Error"), "as png, try --image-format torch, or auto"),
    ("an error in plain words", (500, b"Internal Server Error"), "Internal Server Error"),
    ("too few waypoints", (200, b'{"trajectory": [[1, 0]], "aux_outputs": {}}'), "6 to 16 waypoints"),
    ("NaN", (200, GOOD.replace(b"[1, 0]", b"[NaN, 0]")), "finite, but"),
    ("global coordinates", (200, GOOD.replace(b"[1, 0]", b"[1e6, 0]")), "metres from the car"),
    ("nothing beside it", (200, b'{"trajectory": []}'), "no aux_outputs"),
    ("broken JSON", (200, b'{"trajectory": [[1,'), "not valid JSON"),
]
GONE: list[tuple[str, Reply, str]] = [
    ("a web page", (200, b"<!DOCTYPE html><html>hello</html>"), "a web page"),
    ("a web page that is not found", (404, b"<html>404</html>"), "a web page"),
    ("another route", (404, b'{"detail": "Not Found"}'), "status 404: Not Found.*another version"),
    ("other members", (422, b'{"detail": [{"loc": ["body", "image"], "msg": "missing"}]}'), "422.*another version"),
    ("other pictures", (415, b'{"detail": "no tensors"}'), "--image-format"),
]


def reads_only(form: str, status: int = 500) -> Callable[[str, bytes], Reply]:
    """A server that reads pictures in one form, and fails with an error of its framework at any other."""

    def answer(path: str, body: bytes) -> Reply:
        if path != "/infer":
            return 200, b"true"
        is_png = base64.b64decode(json.loads(body)["images"]["CAM_FRONT"]).startswith(b"\x89PNG")
        return (200, GOOD) if is_png == (form == "png") else (status, b"Internal Server Error")

    return answer


@pytest.mark.parametrize("form", ["torch", "png"])
@pytest.mark.parametrize("status", [500, 415, 200])
def test_auto_finds_the_form_that_a_server_reads(form: str, status: int, capsys: pytest.CaptureFixture[str]) -> None:
    with scripted(reads_only(form, status)) as server:
        one = planner(server.url, "auto")
        one.reset(SCENE)
        assert [one.plan(observed(index)).waypoints[0, 0] for index in range(2)] == [1.0, 1.0]
    again = ["/infer", "/reset"] if form == "png" else []
    assert server.paths == ["/reset", *again, "/infer", "/infer"]
    assert capsys.readouterr().err.count(f"reads images as {form}") == 1
    assert build_planner_facts(one).settings["image_format"] == "auto"


@pytest.mark.parametrize(
    ("reply", "error", "says", "asked"),
    [
        ((500, b"no GPU"), ModelFailedError, r"no GPU to images as torch; .*no GPU to images as png\)$", 2),
        ((404, b"<html>"), PlannerGoneError, "a web page", 1),
        ((503, b"busy"), PlannerLateError, "too busy", 1),
        ((422, b'{"detail": "other members"}'), PlannerGoneError, "another version", 2),
    ],
)
def test_auto_says_what_came_of_both_and_gives_up_on_who_is_no_model_server(
    reply: Reply, error: type[Exception], says: str, asked: int
) -> None:
    with scripted(lambda path, body: reply if path == "/infer" else (200, b"true")) as server:
        with pytest.raises(error, match=says):
            planner(server.url, "auto").plan(observed())
        assert server.paths.count("/infer") == asked


def test_a_server_that_hangs_up_on_images_is_asked_in_the_other_form() -> None:
    """As a server does that is no framework's, and raises."""
    with scripted(
        lambda path, body: reads_only("png")(path, body) if b"iVBORw0KGgo" in body or path != "/infer" else None
    ) as server:
        one = planner(server.url, "auto")
        assert one.plan(observed()).waypoints[0, 0] == 1.0 and server.paths == ["/infer", "/reset", "/infer"]
        with pytest.raises(PlannerAwayError, match=r"hung up.*as torch, try --image-format png, or auto"):
            planner(server.url, "torch").plan(observed())
    with (
        scripted(lambda path, body: None) as server,
        pytest.raises(PlannerAwayError, match="hung up before answering /reset"),
    ):
        planner(server.url, "auto").plan(observed())


def test_a_model_that_planned_before_is_not_told_of_images() -> None:
    replies = [(200, GOOD), (500, b"out of memory")]
    with scripted(lambda path, body: replies.pop(0)) as server:
        one = planner(server.url, "torch")
        one.plan(observed())
        with pytest.raises(ModelFailedError, match=r"out of memory\)$"):
            one.plan(observed(1))


@pytest.mark.parametrize(("_", "reply", "says"), FAILURES, ids=[name for name, _, _ in FAILURES])
def test_a_model_that_fails_is_a_failure_with_a_sentence(_: str, reply: Reply, says: str) -> None:
    with scripted(lambda path, body: reply) as server:
        with pytest.raises(ModelFailedError, match=says):
            planner(server.url).plan(observed())
        found = request_plan(planner(server.url), observed(), 20.0)
    assert isinstance(found, Failure) and found.reason is FailureReason.RAISED and server.paths == ["/infer"] * 2


@pytest.mark.parametrize(("_", "reply", "says"), GONE, ids=[name for name, _, _ in GONE])
def test_what_is_no_model_server_ends_the_command(_: str, reply: Reply, says: str) -> None:
    with scripted(lambda path, body: reply) as server:
        for ask in (
            lambda one: one.plan(observed()),
            lambda one: one.reset(SCENE),
            lambda one: request_plan(one, observed(), 20.0),
        ):
            with pytest.raises(PlannerGoneError, match=says) as gone:
                ask(planner(server.url))
            assert not isinstance(gone.value, PlannerAwayError) and server.url in str(gone.value)


def test_an_error_status_with_a_plan_is_driven_like_neuroncap_does_and_said_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with scripted(lambda path, body: (500, GOOD)) as server:
        one = planner(server.url)
        assert [one.plan(observed(index)).waypoints[0, 0] for index in range(2)] == [1.0, 1.0]
    assert capsys.readouterr().err.count("status 500") == 1


@pytest.mark.parametrize("status", [408, 503])
def test_a_busy_server_is_late_and_nobody_has_failed(status: int) -> None:
    with scripted(lambda path, body: (status, b'{"detail": "busy"}')) as server:
        with pytest.raises(PlannerLateError, match="too busy"):
            planner(server.url).plan(observed())
        found = request_plan(planner(server.url), observed(), 20.0)
        late = planner(server.url)
        # Any answer is alive.
        late.require_alive()
        again = notify_planner(late, lambda: late.reset(SCENE), 20.0)
    assert isinstance(found, Failure) and found.reason is FailureReason.TIMEOUT
    assert again is not None and again.reason is FailureReason.TIMEOUT


def test_nobody_there_is_a_sentence_with_the_address() -> None:
    url = f"http://127.0.0.1:{free_port()}"
    with pytest.raises(PlannerAwayError, match=f"nobody answers at {url}; start|nobody answers at {url} "):
        planner(url).require_alive()


def test_a_server_that_hangs_up_is_away_and_the_request_is_not_sent_again() -> None:
    with scripted(lambda path, body: None) as server:
        with pytest.raises(PlannerAwayError, match="hung up before answering /infer"):
            planner(server.url).plan(observed())
        assert server.paths == ["/infer"]


def speaking(answers: bytes, *, pause_s: float = 0.0, hold_s: float = 0.0) -> tuple[str, threading.Thread]:
    """Somebody who answers one connection with bytes, one after the other if there is a pause."""
    listener = socket.create_server(("127.0.0.1", 0))

    def answer() -> None:
        with listener, listener.accept()[0] as there:
            there.recv(65536)
            try:
                for start in range(0, len(answers), 1 if pause_s else max(len(answers), 1)):
                    there.sendall(answers[start : start + (1 if pause_s else len(answers))])
                    time.sleep(pause_s)
                time.sleep(hold_s)
            except OSError:
                pass

    thread = threading.Thread(target=answer, daemon=True)
    thread.start()
    return f"http://127.0.0.1:{listener.getsockname()[1]}", thread


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        (b"SSH-2.0-OpenSSH_9.6\r\n\r\n\r\n", "as a web server would"),
        (b"HTTP/1.1 200 OK\r\ncontent-length: 100\r\n\r\n{}", "hung up before answering /reset"),
    ],
)
def test_who_does_not_speak_http_or_breaks_off_is_named(answers: bytes, says: str) -> None:
    url, thread = speaking(answers)
    with pytest.raises(PlannerGoneError, match=says):
        planner(url).reset(SCENE)
    thread.join()


DRIPPING = (b"x: ", b"\r\n", b"content-length: 1000\r\n\r\n")
"""Headers, a body, and a body of a known length, which come byte by byte."""


@pytest.mark.parametrize("answers", [b"", *(b"HTTP/1.1 200 OK\r\n" + more + b" " * 200 for more in DRIPPING)])
def test_an_answer_that_is_late_or_drips_is_late_and_a_drive_gives_up_waiting(answers: bytes) -> None:
    url, thread = speaking(answers, pause_s=0.01 if answers else 0.0, hold_s=0.6)
    began = time.monotonic()
    with pytest.raises(PlannerLateError, match=r"within 0\.3 s"):
        planner(url, deadline_s=0.3).reset(SCENE)
    assert time.monotonic() - began < 5.0
    thread.join()
    url, thread = speaking(answers, pause_s=0.01 if answers else 0.0, hold_s=0.6)
    found = request_plan(planner(url), observed(), 0.3)
    assert isinstance(found, Failure) and found.reason is FailureReason.TIMEOUT
    thread.join()


def test_an_answer_without_end_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    few = replace(HTTP_ANSWER, file_bytes=1000)
    monkeypatch.setattr("benchmark.extensions.http.connection.HTTP_ANSWER", few)
    with (
        scripted(lambda path, body: (200, bytes(5000))) as server,
        pytest.raises(PlannerGoneError, match="more than 1000 bytes"),
    ):
        planner(server.url).plan(observed())


def test_it_waits_for_a_server_that_comes_back(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with scripted(good) as server:
        planner(server.url).come_back()
    assert "is gone; waiting" in capsys.readouterr().err
    monkeypatch.setattr("benchmark.extensions.http.model.RETURN_S", 0.2)
    with pytest.raises(PlannerAwayError, match="nobody answers"):
        planner(f"http://127.0.0.1:{free_port()}").come_back()


def test_the_name_or_else_the_address_is_what_identifies_it() -> None:
    plain, named, moved, other = (
        build_planner_facts(planner(*given))
        for given in (
            ("http://127.0.0.1:9000",), ("mine=http://127.0.0.1:9000",), ("mine=http://127.0.0.1:9001",),
            ("mine=http://127.0.0.1:9000", "torch"),
        )
    )  # fmt: skip
    assert plain.name == "127.0.0.1:9000" and plain.settings["address"] == "http://127.0.0.1:9000"
    assert named.name == "mine" and "address" not in named.settings
    assert moved == named != other


def test_addresses() -> None:
    for text, url, name in (
        ("http://127.0.0.1:9000", "http://127.0.0.1:9000", "127.0.0.1:9000"),
        ("http://localhost:9000/", "http://localhost:9000", "localhost:9000"),
        ("HTTP://[::1]:9000", "http://[::1]:9000", "[::1]:9000"),
        ("my model=http://gpu-4:80", "http://gpu-4:80", "my model"),
    ):
        found = Address.of(text, "--model")
        assert is_address(text) and (found.url, found.name) == (url, name)


NO_ADDRESSES = (
    "http://127.0.0.1", "http://", "http://:9000", "http://h:99999", "http://h:x", "http://h:9000/infer", "http://h:0",
    "http://me:secret@h:9000", "http://h:9000?x=1", "http://h:9000#f", "https://h:9000", "=http://h:9000",
    "a/b=http://h:9000", "x" * 61 + "=http://h:9000", "http:/h:9000", "\x00=http://h:9000",
)  # fmt: skip


def test_what_is_no_address() -> None:
    for text in NO_ADDRESSES:
        assert is_address(text)
        with pytest.raises(InputError, match=r"--model .* is not an address; write http://HOST:PORT"):
            Address.of(text, "--model")
    assert not any(map(is_address, ("vad", "package.module:Class", "a=b", "uniad-mini")))


def test_a_planner_here_and_one_over_the_wire_are_never_taken_for_one_another() -> None:
    with pytest.raises(InputError, match="uniad is already the name of a planner"):
        build_planner("uniad=http://127.0.0.1:9000")
    with pytest.raises(InputError, match="does not take --checkpoint"):
        build_planner("http://127.0.0.1:9000", checkpoint=Path(__file__))
    built = build_planner("http://127.0.0.1:9000", over_http={"image_format": "png"})
    assert isinstance(built, HttpPlanner) and built.form is HttpImageFormat.PNG
    assert np.isfinite(built._connection.deadline_s)
