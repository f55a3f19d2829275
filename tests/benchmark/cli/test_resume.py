"""Killed at any moment and started again, or started twice: the same bytes as an undisturbed run."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmark.cli.app import app
from benchmark.records.drives import find_drives
from benchmark.records.run import find_records
from tests.benchmark.cli.cli_runs import bytes_below
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import scene_on_straight_road

ROOT = Path(__file__).resolve().parents[3]
SEARCH = ("--preset", "near", "--candidates", "16", "--rounds", "1", "--vehicles", "2", "--seed", "3")
IMAGES = ("--size", "64x40", "--frames", "keyframes", "--workers", "1")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("data") / "road"
    return write_root(root, [scene_on_straight_road(seconds=8.0)], version="v1.0-mini", renderer=None).root


def generating(source: Path, out: Path) -> list[str]:
    return ["generate", "--split", "adv", "--data", str(source), "--out", str(out), *SEARCH, *IMAGES]


def evaluating(source: Path, out: Path) -> list[str]:
    split = ["--split", "adv", "--workers", "1"]
    return ["eval", "--data", str(source), "--out", str(out), *split, "--model", "constant-velocity"]


@pytest.fixture(scope="module")
def undisturbed(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed")
    for command in (generating(source, out), evaluating(source, out)):
        finish(command)
    return out


def finish(command: list[str]) -> None:
    """Run a command to its end, in this process: starting another one takes longer than the work."""
    app(args=command, standalone_mode=False)


def started(command: list[str]) -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", "benchmark", *command],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def kill_at(command: list[str], out: Path, files: int) -> None:
    """Run a command and kill all its processes as soon as so many files are there."""
    process = started(command)
    while process.poll() is None and sum(len(names) for _, _, names in os.walk(out)) < files:
        time.sleep(0.002)
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def test_an_evaluation_that_is_killed_goes_on(source: Path, undisturbed: Path, tmp_path: Path) -> None:
    shutil.copytree(undisturbed / "data", tmp_path / "data")
    made = len(bytes_below(tmp_path))
    kill_at(evaluating(source, tmp_path), tmp_path, made + 2)
    finish(evaluating(source, tmp_path))
    assert bytes_below(tmp_path) == bytes_below(undisturbed)


def interrupt_at(command: list[str], out: Path, files: int) -> None:
    """Interrupt a command and all its processes, as a terminal does, as soon as so many files are there."""
    # Where a shell runs the tests in the background they ignore interruptions, and so would what they start.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    process = started(command)
    while process.poll() is None and sum(len(names) for _, _, names in os.walk(out)) < files:
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGINT)
    text, err = process.communicate(timeout=60)
    said = [line for line in err.splitlines() if line]
    assert (process.returncode, text) == (130, ""), err
    assert said[-1] == "interrupted; finished work is kept, the same command resumes" and "Traceback" not in err


SLOW = """
import time
from pathlib import Path
import numpy as np
from benchmark import Plan

class Slow:
    name = "slow"

    def reset(self, scene):
        Path("begun").mkdir(exist_ok=True)
        Path("begun", scene.name).touch()

    def plan(self, observation):
        time.sleep(0.2)
        return Plan(np.array([[step, 0.0] for step in range(1, 7)]), "ego")
"""


def test_an_evaluation_that_is_interrupted_says_that_the_same_command_resumes(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(tmp_path)]))
    (tmp_path / "slow.py").write_text(SLOW)
    asked = ["--split", "val", "--workers", "1", "--model", "slow:Slow"]
    command = ["eval", "--data", str(source), "--out", str(tmp_path / "out"), *asked]
    interrupt_at(command, tmp_path / "begun", 1)
    assert not find_records(tmp_path / "out" / "runs")
    finish(command)
    (record,) = find_records(tmp_path / "out" / "runs")
    assert record.complete and record.planner == "slow"


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_generation_and_drives_that_are_interrupted_say_so_too(source: Path, tmp_path: Path, workers: str) -> None:
    for make in (generating, driving):
        command = [*make(source, tmp_path), "--workers", workers]
        interrupt_at(command, tmp_path, sum(len(names) for _, _, names in os.walk(tmp_path)) + 2)
        finish(command)


@pytest.mark.slow
def test_a_split_whose_generation_is_killed_is_the_same(source: Path, undisturbed: Path, tmp_path: Path) -> None:
    made = len(bytes_below(undisturbed / "data"))
    for files in (2, made - 4):
        kill_at(generating(source, tmp_path), tmp_path, files)
    finish(generating(source, tmp_path))
    assert bytes_below(tmp_path / "data") == bytes_below(undisturbed / "data")


def driving(source: Path, out: Path, *more: str) -> list[str]:
    split = ["--split", "val", *more, "--workers", "1"]
    return ["drive", "--data", str(source), "--out", str(out), *split, "--model", "stop", "--agents", "idm"]


@pytest.mark.slow
def test_drives_that_are_killed_go_on_on_both_sides_of_a_pair(source: Path, undisturbed: Path, tmp_path: Path) -> None:
    for name in ("whole", "cut"):
        shutil.copytree(undisturbed / "data", tmp_path / name / "data")
    made = len(bytes_below(tmp_path / "cut"))
    paired = "--split", "adv", "--window", "encounter"
    finish(driving(source, tmp_path / "whole", *paired))
    whole = bytes_below(tmp_path / "whole")
    for files in (2, 7, 22):
        kill_at(driving(source, tmp_path / "cut", *paired), tmp_path / "cut", made + files)
    finish(driving(source, tmp_path / "cut", *paired))
    assert bytes_below(tmp_path / "cut") == whole and len(find_drives(tmp_path / "whole")) == 2 * 5


@pytest.mark.slow
def test_two_at_once(source: Path, undisturbed: Path, tmp_path: Path) -> None:
    """Each of them ends well or says in one sentence that the other one is at work; the result is right."""
    both = [started(generating(source, tmp_path)) for _ in range(2)]
    codes = []
    for process in both:
        out, err = process.communicate(timeout=120)
        codes.append(process.returncode)
        refused = out == "" and err.count("\n") == 1 and err.startswith("error: another command is writing to")
        assert process.returncode == 0 or (process.returncode == 2 and refused), err
    assert 0 in codes
    assert bytes_below(tmp_path / "data") == bytes_below(undisturbed / "data")
