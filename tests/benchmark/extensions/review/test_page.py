"""The page: asked as a stranger would, and used with the keyboard in a browser."""

import contextlib
import http.client
import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.common.keys import Keys

from benchmark.extensions.review.inspection import Inspection, draw_scenes_to_inspect
from benchmark.extensions.review.server import ReviewServer
from benchmark.records.review import read_review
from generation.render.schematic import SchematicRenderer
from tests.benchmark.extensions.review.small_roots import NAMES, three_scenes
from tests.leaderboard.site.browser import find_chromium, started


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_scenes(tmp_path_factory.mktemp("reviewed"), SchematicRenderer(96, 54)).root


@pytest.fixture
def server(root: Path) -> Iterator[ReviewServer]:
    from benchmark.datasets.roots import open_data

    (root / "review.json").unlink(missing_ok=True)
    with serving(Inspection(open_data(root), NAMES, "ada")) as running:
        yield running


@contextlib.contextmanager
def serving(inspection: Inspection) -> Iterator[ReviewServer]:
    with ReviewServer(inspection) as server:
        thread = threading.Thread(target=server.serve_until_done)
        thread.start()
        try:
            yield server
        finally:
            server.done = True
            thread.join()


def asked(server: ReviewServer, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any, Any]:
    """Status, headers and content; without further words the request is the page's own."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    sent = {"Content-Type": "application/json"} if body is not None else {}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(method, path, None if body is None else json.dumps(body), sent)
    answer = connection.getresponse()
    data = answer.read()
    connection.close()
    return answer.status, answer.headers, data


def test_it_listens_on_this_machine_alone_and_needs_the_secret(server: ReviewServer) -> None:
    assert server.server_address[0] == "127.0.0.1" and len(server.secret) >= 32
    status, headers, page = asked(server, "GET", f"/{server.secret}/")
    assert status == 200 and b"<title>Review" in page
    assert "default-src 'none'" in headers["Content-Security-Policy"] and "Access-Control-Allow-Origin" not in headers
    for path in ("/", "/state", "/wrong/state", f"/{server.secret}x/state"):
        assert asked(server, "GET", path)[0] == 404, path
    assert asked(server, "GET", f"/{server.secret}/../server.py")[0] == 404
    assert asked(server, "GET", f"/{server.secret}/state", Host="evil.example")[0] == 403


VERDICT = {"scene": 0, "verdict": "accepted"}


def test_no_other_site_can_post(server: ReviewServer, root: Path) -> None:
    place = f"/{server.secret}/verdict"
    assert asked(server, "POST", place, VERDICT, Origin="http://evil.example")[0] == 403
    assert asked(server, "POST", place, VERDICT, Origin="null")[0] == 403
    assert asked(server, "POST", place, VERDICT, Sec_Fetch_Site="cross-site")[0] == 403
    assert asked(server, "POST", place, VERDICT, Host=f"evil.example:{server.server_port}")[0] == 403
    # What a form of another site could send without being asked first.
    assert asked(server, "POST", place, VERDICT, Content_Type="text/plain")[0] == 415
    assert asked(server, "POST", "/verdict", VERDICT)[0] == 404
    assert read_review(root) == {}
    origin = f"http://127.0.0.1:{server.server_port}"
    assert asked(server, "POST", place, VERDICT, Origin=origin, Sec_Fetch_Site="same-origin")[0] == 200
    assert read_review(root)["scene-9901"].inspector == "ada"


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"scene": 3, "verdict": "accepted"}, 400),
        ({"scene": -1, "verdict": "accepted"}, 400),
        ({"scene": "0", "verdict": "accepted"}, 404),
        ({"scene": 0, "verdict": "rejected", "reason": " "}, 400),
        ({"scene": 0, "verdict": "rejected", "reason": "a\nb"}, 400),
        ({"scene": 0, "verdict": "maybe"}, 400),
        ({"scene": 0, "verdict": "rejected", "reason": "x" * 20_000}, 413),
        ([], 400),
    ],
)
def test_bad_posts_are_refused_and_record_nothing(server: ReviewServer, root: Path, body: Any, status: int) -> None:
    found, _, said = asked(server, "POST", f"/{server.secret}/verdict", body)
    assert found == status and json.loads(said)["error"]
    assert read_review(root) == {}


@pytest.mark.path
def test_pictures_are_those_of_the_data_set(server: ReviewServer) -> None:
    _, _, said = asked(server, "GET", f"/{server.secret}/scene/1")
    scene = json.loads(said)
    assert scene["name"] == "scene-9902" and len(scene["seconds"]) == 16 and len(scene["cameras"]) == 6
    assert asked(server, "GET", f"/{server.secret}/picture/1/3/cameras.webp")[2][8:12] == b"WEBP"
    assert asked(server, "GET", f"/{server.secret}/picture/1/3/above.png")[2].startswith(b"\x89PNG")
    assert asked(server, "GET", f"/{server.secret}/picture/1/16/above.png")[0] == 400


def test_a_random_subset_is_drawn_by_seed_and_stays_in_order() -> None:
    names = [f"scene-{number:04d}" for number in range(40)]
    drawn = draw_scenes_to_inspect(names, 8, 3)
    assert len(drawn) == 8 and list(drawn) == sorted(drawn) and drawn == draw_scenes_to_inspect(names, 8, 3)
    assert drawn != draw_scenes_to_inspect(names, 8, 4)
    assert draw_scenes_to_inspect(names, None, 0) == draw_scenes_to_inspect(names, 99, 0) == tuple(names)


def test_a_sitting_with_the_keyboard(server: ReviewServer, root: Path) -> None:
    programs = find_chromium()
    if programs is None:
        pytest.skip("no Chromium with its driver here; make browser installs Debian's")
    with contextlib.ExitStack() as until_done:
        try:
            browser = until_done.enter_context(started(programs, server.url))
        except WebDriverException:
            pytest.skip("Chromium does not start on this machine")
        browser.open("")
        browser.until('document.getElementById("cameras").naturalWidth > 0')
        assert browser.one("name").text == "scene-9901"
        browser.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
        assert browser.one("clock").text.startswith("1.0 of")
        browser.press("a")
        browser.until('document.getElementById("name").textContent === "scene-9902"')
        # A rejection asks for its reason, and Enter there rejects.
        browser.press("r")
        browser.until('document.activeElement.id === "reason"')
        assert read_review(root).keys() == {"scene-9901"}
        browser.press("a car in a car", Keys.ENTER)
        browser.until('document.getElementById("name").textContent === "scene-9903"')
        browser.press("2", "r")
        browser.until('document.getElementById("progress").textContent === "1 accepted, 2 rejected, 0 not reviewed"')
        browser.press("u")
        browser.until('document.getElementById("progress").textContent === "1 accepted, 1 rejected, 1 not reviewed"')
        said = {name: (one.verdict, one.reason) for name, one in read_review(root).items()}
        assert said == {"scene-9901": ("accepted", ""), "scene-9902": ("rejected", "a car in a car")}
        browser.press("p")
        browser.until('document.getElementById("reason").value === "a car in a car"')
        browser.note_logs()
        assert browser.messages == []
        asked_for = {address for address in browser.requests if not address.startswith(("data:", "about:"))}
        assert asked_for and all(address.startswith(server.url) for address in asked_for)
        browser.click(browser.one("finish"))
        browser.until('!document.getElementById("over").hidden')
    assert server.done
