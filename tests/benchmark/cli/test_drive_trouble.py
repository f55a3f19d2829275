"""``drive`` when something goes wrong: nothing is lost, and nothing is scored as zero."""

import errno
import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.errors import InputError
from benchmark.machine.storage import lock_folder
from benchmark.runs.driving import DriveSettings, drive_split
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import LooksAtImages, LooksIfItCan
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return road(tmp_path_factory.mktemp("data") / "road")


def road(root: Path) -> Path:
    """A data set of one scene: a car stands ahead."""
    scene = scene_on_straight_road((Car(100.0, 198.25, 0.0),), seconds=8.0)
    return write_root(root, [scene], version="v1.0-mini", renderer=None).root


def driving(source: Path, out: Path, *more: str) -> Done:
    return run_here("drive", "--data", source, "--split", "val", "--out", out, "--workers", "1", *more)


@pytest.mark.parametrize(("planner", "reason"), [("Failing", "raised"), ("Poisoned", "unusable plan")])
def test_who_fails_is_counted_and_scored_nowhere(
    source: Path, tmp_path: Path, planner: str, reason: str, engine: str = "default"
) -> None:
    failing = ("--model", f"tests.benchmark.planners:{planner}", "--engine", engine)
    models = (*failing, "--model", "stop", "--no-baselines", "--json")
    done = driving(source, tmp_path, *models)
    failed, sound = json.loads(done.out)
    assert done.code == 1 and f"failed in 1 of 1 drive (1 {reason}" in done.err
    assert failed["failed"] == 1 and failed["reasons"] == {reason: 1} and failed["columns"] == {}
    assert failed["status"] == "partial" and sound["status"] == "complete" and sound["failed"] == 0
    # What failed is kept: the same command asks nobody again, and says the same.
    before = bytes_below(tmp_path)
    again = driving(source, tmp_path, *models)
    assert again.code == 1 and again.out == done.out and bytes_below(tmp_path) == before


def test_an_own_camera_model_is_refused_without_a_sensor_and_nobody_else_is(source: Path, tmp_path: Path) -> None:
    done = driving(source, tmp_path, "--model", "tests.benchmark.planners:LooksAtImages")
    assert (done.code, done.out) == (2, "") and not list(tmp_path.rglob("drive.json"))
    says = (
        "looks needs images, and --sensor none provides none (it raised KeyError: 'CAM_FRONT'); add --sensor schematic"
    )
    assert done.err.splitlines()[-1] == says
    # In this process, as from Python, it is the same; who looks and can do without is driven.
    settings = DriveSettings("default", DefaultBackend())
    with pytest.raises(InputError, match="looks needs images"):
        drive_split(town_of_two(), "val", LooksAtImages(), tmp_path / "here", settings)
    assert drive_split(town_of_two(), "val", LooksIfItCan(), tmp_path / "here", settings).complete


def test_six_identical_points_are_driven(source: Path, tmp_path: Path) -> None:
    options = ("--model", "tests.benchmark.planners:OnePoint", "--no-baselines", "--json")
    (row,) = json.loads(driving(source, tmp_path, *options).out)
    assert row["failed"] == 0 and row["coverage"] == 1.0 and 0.0 < row["columns"]["route"]["value"] < 0.5


def test_a_full_disk_is_one_sentence_and_the_same_command_goes_on(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models = ("--model", "constant-velocity", "--model", "stop", "--no-baselines")
    assert driving(source, tmp_path / "whole", *models).code == 0
    sync, left = os.fsync, [0]

    def full(descriptor: int) -> None:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(descriptor)

    monkeypatch.setattr("benchmark.machine.storage.os.fsync", full)
    # While the first drive is kept, the second one, and while a record is written.
    for room in (0, 1, 3):
        left[0] = room
        done = driving(source, tmp_path / "full", *models)
        # A slow machine says how far it was.
        said = [line for line in done.err.splitlines() if not re.search(r"\d of \d drives", line)]
        assert done.code == 2 and len(said) == 1, done.err
        assert "No space left on device; free some space, then run the same command again" in done.err
        assert done.out == ""
    monkeypatch.setattr("benchmark.machine.storage.os.fsync", sync)
    assert driving(source, tmp_path / "full", *models).code == 0
    assert bytes_below(tmp_path / "full") == bytes_below(tmp_path / "whole")


def test_two_commands_on_the_same_record_do_not_mix(source: Path, tmp_path: Path) -> None:
    models = ("--model", "stop", "--no-baselines")
    (record,) = json.loads(driving(source, tmp_path, *models, "--json").out)
    before: dict[str, Any] = bytes_below(tmp_path)
    with lock_folder(Path(record["directory"])):
        done = driving(source, tmp_path, *models)
    assert done.code == 2 and "another command is writing to" in done.err and bytes_below(tmp_path) == before
