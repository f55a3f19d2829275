"""``serve``, and ``drive`` and ``eval`` with servers, as a user runs them, the page's minimal server among them."""

import json
import re
import threading
from dataclasses import replace
from http.server import HTTPServer
from pathlib import Path

import numpy as np
import pytest

import benchmark
from benchmark.closed_loop.episodes import run_episode
from benchmark.extensions.http.model import http_planner
from benchmark.extensions.http.server import PlannerServer
from benchmark.planning import SceneInfo
from benchmark.records.drives import load_drives
from generation.sources.mini import TownSettings, build_town_data_set
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.closed_loop.seeing import Looking, Painted, small_scene
from tests.benchmark.closed_loop.staged import staged
from tests.benchmark.extensions.http.made import observed, scripted, serving
from tests.benchmark.extensions.http.test_sensor import Renderer
from tests.generation.nuscenes_writer.written_roots import SIZE, write_root
from tests.hand_made import scene_on_straight_road


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene on disk with small pictures."""
    root = tmp_path_factory.mktemp("data") / "road"
    write_root(root, [small_scene()], version="v1.0-mini", frames="keyframes")
    return root


def test_a_model_server_drives_with_what_the_sensor_draws(source: Path, tmp_path: Path) -> None:
    options = ("--data", source, "--split", "val", "--out", tmp_path, "--no-baselines", "--workers", "2", "--json")
    with serving(Looking()) as url:
        done = run_here("drive", *options, "--model", f"mine={url}", "--sensor", "schematic", "--image-format", "png")
    (row,) = json.loads(done.out)
    assert done.code == 0 and row["planner"] == "mine" and row["failed"] == 0
    assert row["measured"]["sensor"] == "schematic"
    (record,) = tmp_path.rglob("drive.json")
    assert json.loads(record.read_text())["planner"]["settings"] == {"image_format": "png"}


def test_a_renderer_shows_and_a_model_drives(source: Path, tmp_path: Path) -> None:
    options = ("--data", source, "--split", "val", "--out", tmp_path, "--no-baselines", "--workers", "1", "--json")
    (name,) = benchmark.open_data(source).scene_names("val")
    shown = Renderer(benchmark.open_data(source).scene(name), shape=(SIZE[1], SIZE[0]))
    with serving(Looking()) as url, scripted(shown) as drawn:
        asked = ("--model", url, "--sensor", f"gaussians={drawn.url}", "--accept-torch-tensors", "--model", "stop")
        done = run_here("drive", *options, *asked)
    assert done.code == 0, done.err
    served, blind = json.loads(done.out)
    assert done.code == 0 and served["planner"] == url.removeprefix("http://") and served["failed"] == 0
    assert served["measured"]["sensor"] == "gaussians" and blind["measured"]["sensor"] == "none"
    assert served["measured"]["sensor_facts"] == {"protocol": "neuroncap", "image_format": "torch"}


def test_an_evaluation_asks_the_server_and_without_pictures_says_what_is_missing(source: Path, tmp_path: Path) -> None:
    with serving(Looking()) as url:
        asked = ("--split", "val", "--out", tmp_path, "--model", url, "--workers", "2", "--json")
        seen = run_here("eval", "--data", source, *asked)
        write_root(tmp_path / "blind", [small_scene()], version="v1.0-mini", renderer=None)
        blind = run_here("eval", "--data", tmp_path / "blind", *asked)
    (row,) = json.loads(seen.out)
    assert seen.code == 0 and row["failed"] == 0 and row["samples"] > 0
    assert blind.code == 1 and "NeuroNCAP's requests carry" in blind.err


@pytest.mark.parametrize(
    ("options", "says", "not_said"),
    [
        ((), ["stop is served at http://127.0.0.1:", "stop it with Ctrl-C"], "warning"),
        (("--host", "0.0.0.0"), ["warning: 0.0.0.0 is open to other machines", "a password"], "pickles"),
        (("--accept-torch-tensors",), ["saved tensors are pickles", "weights_only"], "open to other machines"),
    ],
)
def test_serve_says_where_and_warns(
    options: tuple[str, ...], says: list[str], not_said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: list[PlannerServer] = []

    def serve(self: PlannerServer) -> None:
        served.append(self)
        self.close()

    monkeypatch.setattr(PlannerServer, "serve", serve)
    done = run_here("serve", "--model", "stop", "--port", "0", *options)
    assert done.code == 0 and len(served) == 1
    assert all(each in done.err for each in says) and not_said not in done.err and str(served[0].port) in done.err


PAGE = Path(__file__).resolve().parents[4] / "docs" / "extensions" / "http.md"


@pytest.mark.path
def test_it_runs_as_it_stands_and_is_driven() -> None:
    (code,) = re.findall(r"```python\n(# model_server\.py\n.*?)```", PAGE.read_text(), re.DOTALL)
    assert len([line for line in code.splitlines() if line.strip()]) <= 42
    space: dict[str, type] = {"__name__": type("model_server", (), {})}
    exec(compile(code, "model_server.py", "exec"), space)
    space["Server"].log_message = lambda *_: None  # type: ignore[attr-defined]
    with HTTPServer(("127.0.0.1", 0), space["Server"]) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        planner = http_planner(f"http://127.0.0.1:{server.server_port}", image_format="png")
        planner.require_alive()
        planner.reset(SceneInfo("scene-1", "boston-seaport", ()))
        np.testing.assert_allclose(planner.plan(observed(speed=6.0)).waypoints[:, 0], 3.0 * np.arange(1, 7))
        stage = replace(staged(scene_on_straight_road((), seconds=4.0)), sensor=Painted())
        found = run_episode(stage, planner)
        server.shutdown()
    assert found.failure is None and found.end == "end"


def test_a_server_in_axes_of_the_lidar_is_named_and_driven_right_with_its_frame(tmp_path: Path) -> None:
    """As the fork of VAD that serves NeuroNCAP answers: x right, y forward."""

    settings = TownSettings(val_scenes=4, width=96, height=54, frames="keyframes", version=1)
    root = build_town_data_set(tmp_path / "root", settings, workers=1)

    def ahead(path: str, body: bytes) -> tuple[int, bytes]:
        if path != "/infer":
            return 200, b"true"
        speed = json.loads(body)["canbus"][13]
        trajectory = [[0.0, 0.5 * step * speed] for step in range(1, 7)]
        return 200, json.dumps({"trajectory": trajectory, "aux_outputs": {}}).encode()

    options = ("--data", root, "--split", "val", "--workers", "1", "--image-format", "png")
    driving = ("--sensor", "schematic", "--no-baselines")
    with scripted(ahead) as server:
        asked = ("--model", f"fork={server.url}")
        wrong = run_here("drive", *asked, *driving, *options, "--out", tmp_path / "wrong")
        right = run_here("drive", *asked, *driving, *options, "--out", tmp_path / "right", "--frame", "lidar")
        planned = run_here("eval", *asked, *options, "--out", tmp_path / "planned")
        read = run_here("eval", *asked, *options, "--out", tmp_path / "read", "--frame", "lidar")
    for done in (wrong, planned):
        assert done.code == 0 and done.err.count("warning:") == 1 and "fork ¶" in done.out
        assert all(words in done.err for words in ("axes x right, y forward would fit", "--frame lidar", "NeuroNCAP"))
    for done in (right, read):
        assert done.code == 0 and "warning" not in done.err and "¶" not in done.out
    shares = {
        name: [row.scores.route_share or 0.0 for row in load_drives(path.parent).rows if row.scores]
        for name in ("wrong", "right")
        for path in (tmp_path / name).rglob("drive.json")
    }
    sideways, along = ([share for share in shares[name] if share is not None] for name in ("wrong", "right"))
    assert sideways and along and max(sideways) < 0.1 < min(along)
