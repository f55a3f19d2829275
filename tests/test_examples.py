"""The scripts of examples/ run as they stand, one after the other in one folder, and come to what they say."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from safetensors.torch import save_file

import benchmark

mpl.use("Agg")
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NAMES = ("first_look", "my_planner", "judge_a_result_file", "drive_it")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all of them run: the first one builds the town, the others open it."""
    return tmp_path_factory.mktemp("examples")


def run(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.chdir(folder)
    return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")


def test_the_four_are_there_and_in_the_percent_format() -> None:
    assert sorted(path.stem for path in EXAMPLES.glob("*.py")) == sorted([*NAMES, "torch_planner"])
    for name in NAMES:
        text = (EXAMPLES / f"{name}.py").read_text()
        head, *cells = re.split(r"^# %%", text, flags=re.MULTILINE)
        assert "format_name: percent" in head and cells[0].startswith(" [markdown]\n# # ")
        assert len(cells) >= 8 and sum(cell.startswith(" [markdown]") for cell in cells) >= 4
        for cell in cells:
            if cell.startswith(" [markdown]"):
                assert all(line.startswith("#") for line in cell.splitlines()[1:] if line), cell


def test_a_first_look(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    left = run("first_look", folder, monkeypatch)
    assert set(left["here"]) == set(left["facts"]) and len(left["facts"]) == 3
    assert {fact.source for fact in left["facts"].values()} <= set(left["town"].scene_names("val"))
    assert (folder / "challenger-out" / "first-look.png").stat().st_size > 5_000
    assert "cut-in-right, made from scene-8000" in capsys.readouterr().out


def test_my_planner(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    left = run("my_planner", folder, monkeypatch)
    assert [record.planner for record in left["records"]] == 2 * ["speeding-up", "constant-velocity", "idm"]
    assert all(record.complete for record in left["records"])
    rate = left["mine"].summary.protocols["exact"].columns["collision"]["3s"]
    assert left["mine"].run.split == "adv" and 0 < len(left["hit"]) == rate.numerator
    assert f"{len(left['hit'])} of 120 samples collide" in capsys.readouterr().out


def test_judge_a_result_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    left = run("judge_a_result_file", folder, monkeypatch)
    assert left["opened"].format.name == "vad-out" and left["judged"].complete
    assert json.loads((left["judged"].directory / "run.json").read_text())["plans_from"]["order"] == "proven"


def test_drive_it(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    left = run("drive_it", folder, monkeypatch)
    assert [len(record.rows) for record in left["records"]] == [3, 3]
    assert {record.facts.measured.window for record in left["records"]} == {"encounter"}
    assert left["replayed"].facts.measured.agents == "replay" and left["replayed"].complete
    assert ": contact (" in capsys.readouterr().out
    assert (folder / "challenger-out" / "drive-it.png").stat().st_size > 5_000


def test_a_network_with_six_cameras(tmp_path: Path) -> None:
    small = benchmark.TownSettings(val_scenes=1, width=96, height=54, frames="keyframes")
    town = benchmark.open_data(benchmark.build_town(tmp_path / "town", small, workers=1))
    left = runpy.run_path(str(EXAMPLES / "torch_planner.py"))
    straight = benchmark.evaluate(town, "val", left["TorchPlanner"](device="cpu"), tmp_path / "straight")
    network = left["Network"]()
    network.head.bias.data[:] = 1.0
    save_file(network.state_dict(), tmp_path / "mine.safetensors")
    aside = left["TorchPlanner"](tmp_path / "mine.safetensors", device="cpu")
    moved = benchmark.evaluate(town, "val", aside, tmp_path / "moved")
    assert straight.complete and straight.planner == "torch-planner" and len(straight.rows) == 40
    for before, after in zip(straight.rows, moved.rows, strict=True):
        assert before.plan is not None and after.plan is not None
        assert np.allclose(np.array(after.plan.waypoints) - np.array(before.plan.waypoints), 1.0)
