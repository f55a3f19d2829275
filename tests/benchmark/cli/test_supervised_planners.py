"""Commands with a planner that dies: the run goes on, ends with code 1, says why, and asks again the next time."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark import api
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.sandbox.limits import SandboxLimits
from generation.pipeline.surrogate import read_surrogate_result
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.fake_data import town_of_two
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

MORTAL = """
import os, sys, time
from pathlib import Path
import numpy as np
from benchmark.planning import Plan, PlanFrame

class Mortal:
    name = "mortal"
    settings = {"ways": "some"}
    def reset(self, scene):
        self.scene = scene.name
    def plan(self, observation):
        print("planning")
        if observation.index == 2 and self.scene == "scene-1" and Path(__file__).with_name("dies").exists():
            os._exit(0)
        if observation.index == 2 and self.scene == "scene-1" and Path(__file__).with_name("hangs").exists():
            time.sleep(1000)
        return Plan(np.column_stack([4.0 * np.arange(1, 7), np.zeros(6)]), PlanFrame.EGO)
"""
SAMPLES = 8


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "road"
    scenes = [scene_on_straight_road((Car(100.0, 198.25, 8.0),), name=f"scene-{each}", seconds=4.0) for each in (1, 2)]
    return write_root(root, scenes, version="v1.0-mini", renderer=None).root


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mortal_planner.py").write_text(MORTAL)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def run(command: str, source: Path, out: Path, *more: str) -> Done:
    model = ("--model", "mortal_planner:Mortal", "--split", "val", "--workers", "1", "--json")
    return run_here(command, "--data", source, "--out", out, *model, *more)


def test_eval_goes_on_after_a_death_and_asks_again(source: Path, home: Path) -> None:
    out = home / "out"
    (home / "dies").touch()
    done = run("eval", source, out, "--sample-limit", "90", "--memory-limit", "4")
    (said,) = json.loads(done.out)
    assert done.code == 1 and (said["samples"], said["failed"], said["status"]) == (2 * SAMPLES, SAMPLES - 2, "partial")
    assert "the planner's process ended by itself with exit status 0" in done.err
    config = json.loads((Path(said["directory"]) / "run.json").read_text())["config"]
    assert config["supervision"] == {"sample_limit_s": 90.0, "memory_limit_bytes": 4 << 30}
    (home / "dies").unlink()
    done = run("eval", source, out)
    (said,) = json.loads(done.out)
    assert done.code == 0 and (said["failed"], said["status"]) == (0, "complete")


def test_drive_goes_on_after_a_death_and_asks_again(source: Path, home: Path) -> None:
    out = home / "out"
    for way, reason in (("dies", "died"), ("hangs", "timeout")):
        (home / way).touch()
        done = run("drive", source, out, "--no-baselines", "--timeout", "4")
        (said,) = json.loads(done.out)
        assert done.code == 1 and said["reasons"] == {reason: 1} and said["drives"] == 2, done.err
        (home / way).unlink()
    done = run("drive", source, out, "--no-baselines")
    (said,) = json.loads(done.out)
    assert done.code == 0 and said["failed"] == 0


def test_a_surrogate_is_watched_over_and_its_death_is_no_verdict(home: Path) -> None:
    data = town_of_two()
    data.scenes["scene-1"] = replace(data.scenes.pop("scene-9901"), name="scene-1")
    under_test = api.planner_under_test("mortal_planner:Mortal", supervision=SandboxLimits(30.0))
    settings = EvalSettings(("exact",))
    assert read_surrogate_result(evaluate(data, "val", under_test.factory, home / "sound", settings)).scenes == 2
    (home / "dies").touch()
    record = evaluate(data, "val", under_test.factory, home / "runs", settings)
    with pytest.raises(InputError, match=r"mortal raised on .* the planner's process ended by itself"):
        read_surrogate_result(record)


def test_limits_are_of_planners_of_other_packages() -> None:
    assert "--sample-limit is of planners of other packages" in refusal(
        "eval", "--model", "stop", "--sample-limit", "5"
    )
    assert "--memory-limit is of planners" in refusal("generate", "--memory-limit", "5")
    assert "--sample-limit is of planners" in refusal("ablate", "--sample-limit", "5")
