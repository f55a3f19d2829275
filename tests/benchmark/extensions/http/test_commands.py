"""``serve``, and ``drive`` and ``eval`` with servers, as a user runs them."""

import json
from pathlib import Path

import pytest

import benchmark
from benchmark.extensions.http.server import PlannerServer
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.http.made import Looking, scripted, serving
from tests.benchmark.extensions.http.test_sensor import Renderer, small_scene
from tests.generation.nuscenes_writer.written_roots import SIZE, write_root


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
