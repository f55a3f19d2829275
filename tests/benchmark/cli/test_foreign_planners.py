"""Planners written by strangers: whatever they do, the command says what happened and never a wrong number."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from generation.render.schematic import SchematicRenderer
from tests.benchmark.cli.cli_runs import Run, challenger_bench, run_main
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import scene_on_straight_road

STRANGERS = """
import os, sys
import numpy as np
from benchmark.planning import Plan, PlanFrame

class Straight:
    name = "straight"
    def reset(self, scene): pass
    def plan(self, observation): return Plan(np.zeros((6, 2)), PlanFrame.EGO)

class InitRaises(Straight):
    def __init__(self): raise RuntimeError("no weights\\nanywhere")

class Unnameable(Straight):
    name = "a\\nb"

class ResetExits(Straight):
    def reset(self, scene): sys.exit(0)

class SameName(Straight):
    def plan(self, observation): return Plan(np.ones((6, 2)), PlanFrame.EGO)

class Nothing(Straight):
    def plan(self, observation): return None

class Prints(Straight):
    def __init__(self): print("loading")
    def plan(self, observation):
        print("thinking")
        return super().plan(observation)

class Dots(Straight):
    name = ".."

class Looks(Straight):
    name = "looks"
    def plan(self, observation):
        observation.views["CAM_BACK"].load()
        return super().plan(observation)
"""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "road"
    scene, renderer = scene_on_straight_road(seconds=4.0), SchematicRenderer(64, 40)
    return write_root(root, [scene], version="v1.0-mini", renderer=renderer, frames="keyframes").root


@pytest.fixture(autouse=True)
def strangers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "strangers.py").write_text(textwrap.dedent(STRANGERS))
    (tmp_path / "unfinished.py").write_text("x = (\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]))


def evaluate(root: Path, out: Path, model: str) -> Run:
    return run_main("eval", "--data", root, "--split", "val", "--out", out, "--model", model, "--json")


@pytest.mark.parametrize(
    ("model", "word"),
    [
        ("strangers:InitRaises", "RuntimeError: no weights"),
        ("strangers:Unnameable", "printable"),
        ("unfinished:Planner", "SyntaxError"),
        ("builtins:dict", "not a class or a function"),
        (".strangers:Straight", "package.module:Class"),
    ],
)
def test_what_cannot_be_built_is_one_sentence(root: Path, tmp_path: Path, model: str, word: str) -> None:
    run = evaluate(root, tmp_path / "out", model)
    assert (run.code, run.out) == (2, ""), run
    assert run.err.startswith("error: ") and run.err.count("\n") == 1 and word in run.err, run.err


def test_debug_shows_the_planners_own_line_and_keeps_the_exit_code(root: Path, tmp_path: Path) -> None:
    run = run_main("--debug", "eval", "--data", root, "--out", tmp_path / "out", "--model", "strangers:InitRaises")
    line = next(number for number, text in enumerate(STRANGERS.splitlines(), 1) if "no weights" in text)
    assert run.code == 2 and f'{tmp_path / "strangers.py"}", line {line}, in __init__' in run.err
    assert run.err.splitlines()[-1].startswith("error: model 'strangers:InitRaises': building it raised RuntimeError")


def test_a_record_has_the_name_that_was_asked_for(root: Path, tmp_path: Path) -> None:
    on = ("--data", root, "--out", tmp_path / "out", "--json")
    named = run_main("eval", *on, "--model", "strangers:Straight", "--name", "mine", "--split", "val")
    (record,) = named.json
    assert Path(record["directory"]).name == "mine"
    assert json.loads((Path(record["directory"]) / "run.json").read_text())["planner"]["name"] == "mine"
    two = run_main("eval", *on, "--model", "stop", "--model", "idm", "--name", "mine")
    assert two.code == 2 and "--name mine names one planner, and the command runs 2; run them one at a time" in two.err
    blank = run_main("eval", *on, "--model", "stop", "--name", "a\nb")
    assert blank.code == 2 and "--name must be printable text" in blank.err


@pytest.mark.parametrize("model", ["ResetExits", "Nothing"])
def test_what_fails_on_samples_is_a_partial_run(root: Path, tmp_path: Path, model: str) -> None:
    run = evaluate(root, tmp_path / "out", f"strangers:{model}")
    assert run.code == 1, run
    assert (run.json[0]["status"], run.json[0]["failed"], run.json[0]["coverage"]) == ("partial", 8, 0.0)
    (readable,) = tmp_path.glob("out/runs/*/*/*/failures.txt")
    text = readable.read_text()
    first = next(line for line in text.splitlines() if line.startswith(("SystemExit", "TypeError")))
    assert f"(the first: {first}; all tracebacks: {readable})" in run.err and "next:" not in run.err
    assert text.startswith("8 of 8 samples failed\n\nscene-9901, sample 0 (") and text.count("Traceback") == 8


def test_a_command_ends_with_where_things_are_and_what_to_do_next(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    left = out / "runs" / "road" / "val" / "straight" / "failures.txt"
    left.parent.mkdir(parents=True)
    left.write_text("of a run that failed")
    run = run_main("eval", "--data", root, "--out", out, "--model", "strangers:Straight")
    assert run.code == 0 and f"records: {out / 'runs' / 'road' / 'val' / 'straight'}" in run.err
    assert f"next: challenger-bench sheets --split val --data {root} --out {out}" in run.err and "next:" not in run.out
    assert not left.exists()


def test_prints_do_not_reach_the_json(root: Path, tmp_path: Path) -> None:
    on = ("--data", root, "--split", "val", "--out", tmp_path / "out")
    run = challenger_bench("eval", *on, "--model", "strangers:Prints", "--json")
    assert run.code == 0 and run.json[0]["samples"] == 8
    assert "thinking" in run.err


def test_two_classes_of_one_name_are_two_planners(root: Path, tmp_path: Path) -> None:
    first, second = (evaluate(root, tmp_path / "out", f"strangers:{name}") for name in ("Straight", "SameName"))
    assert first.json[0]["protocols"]["exact"]["columns"]["l2"] != second.json[0]["protocols"]["exact"]["columns"]["l2"]


def test_some_images_missing_is_an_error_and_all_missing_is_a_scene_without_images(root: Path, tmp_path: Path) -> None:
    """Even for a planner that does not look: a record must not depend on which half of the images was there."""
    copy = Path(shutil.copytree(root, tmp_path / "road"))
    images = sorted((copy / "samples/CAM_BACK").iterdir())
    images[2].unlink()
    run = evaluate(copy, tmp_path / "out", "strangers:Straight")
    assert run.code == 2 and images[2].name in run.err and "1 of the 48" in run.err, run
    for image in (copy / "samples").glob("CAM_*/*"):
        image.unlink()
    assert evaluate(copy, tmp_path / "out", "strangers:Straight").code == 0
    run = evaluate(copy, tmp_path / "out", "strangers:Looks")
    assert run.code == 2 and images[0].name in run.err and run.err.count("\n") == 1, run


IN_THIS_FOLDER = """
import os
from pathlib import Path
import numpy as np
from benchmark.planning import Plan, PlanFrame

class MyPlanner:
    name = "my-planner"
    def __init__(self): Path(f"built-{os.getpid()}").touch()
    def reset(self, scene): pass
    def plan(self, observation): return Plan(np.zeros((6, 2)), PlanFrame.EGO)
"""
CONSOLE_SCRIPT = """
from importlib.metadata import entry_points
import benchmark.evaluation
benchmark.evaluation.PROCESSES_PAY_AFTER_S = -1.0
(script,) = entry_points(group="console_scripts", name="challenger-bench")
script.load()()
"""


def test_a_planner_in_the_current_folder_is_found_in_every_process(tmp_path: Path) -> None:
    """An installed command does not look into the current folder by itself, as `python -m` does."""
    data, here = tmp_path / "road", tmp_path / "mine"
    scenes = [scene_on_straight_road(name=name, seconds=4.0) for name in ("a", "b", "c")]
    write_root(data, scenes, version="v1.0-mini", renderer=None)
    (here / "my_package").mkdir(parents=True)
    (here / "my_package" / "planner.py").write_text(IN_THIS_FOLDER)
    project = Path(__file__).resolve().parents[3]
    arguments = ["eval", "--data", str(data), "--model", "my_package.planner:MyPlanner", "--workers", "2"]
    done = subprocess.run(
        [sys.executable, "-P", "-c", CONSOLE_SCRIPT, *arguments],
        cwd=here,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(project)},
    )
    assert done.returncode == 0, done.stderr
    assert "my-planner" in done.stdout and len(list(here.glob("built-*"))) > 1
