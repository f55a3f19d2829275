"""The minimal server of the page for authors of model servers: it runs as it stands, and is driven."""

import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import HTTPServer
from pathlib import Path

import numpy as np
import pytest

from benchmark.closed_loop.episodes import run_episode
from benchmark.extensions.http.model import http_planner
from benchmark.planning import SceneInfo
from tests.benchmark.closed_loop.staged import staged
from tests.benchmark.extensions.http.made import Painted, observed
from tests.hand_made import scene_on_straight_road

PAGE = Path(__file__).resolve().parents[4] / "docs" / "extensions" / "http.md"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    (code,) = re.findall(r"```python\n(# model_server\.py\n.*?)```", PAGE.read_text(), re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 42
    space: dict[str, type] = {"__name__": type("model_server", (), {})}
    exec(compile(code, "model_server.py", "exec"), space)
    space["Server"].log_message = lambda *_: None  # type: ignore[attr-defined]
    server = HTTPServer(("127.0.0.1", 0), space["Server"])
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_it_answers_what_it_is_asked(url: str) -> None:
    planner = http_planner(url, image_format="png")
    planner.require_alive()
    planner.reset(SceneInfo("scene-1", "boston-seaport", ()))
    plan = planner.plan(observed(speed=6.0))
    np.testing.assert_allclose(plan.waypoints[:, 0], 3.0 * np.arange(1, 7))


def test_it_is_driven(url: str) -> None:
    stage = replace(staged(scene_on_straight_road((), seconds=4.0)), sensor=Painted())
    found = run_episode(stage, http_planner(url, image_format="png"))
    assert found.failure is None and found.end == "end"
