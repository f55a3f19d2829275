"""Drives in separate jobs: the record is the one of a run that was never cut, and what is missing is driven."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.records.drives import load_drives
from benchmark.runs.driving import drive_planners, drive_shard
from benchmark.runs.units import Shard
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.planners import Factory, Straight
from tests.benchmark.runs.test_driving import SETTINGS
from tests.benchmark.test_evaluation import town_of_six
from tests.generation.nuscenes_writer.written_roots import write_root
from tests.hand_made import Car, scene_on_straight_road

PLANNERS = [Factory(), Factory(Straight, (0.0001,))]


def shard(out: Path, number: int, of: int, planners: int = 1) -> None:
    drive_shard(town_of_six(), "val", PLANNERS[:planners], out, SETTINGS, Shard(number, of), reopen=town_of_six)


@pytest.mark.parametrize("of", [2, 9])
def test_shards_become_the_bytes_of_a_run_that_was_never_cut(tmp_path: Path, of: int) -> None:
    (whole,) = drive_planners(town_of_six(), "val", PLANNERS[:1], tmp_path / "whole", SETTINGS, reopen=town_of_six)
    for number in reversed(range(1, of + 1)):
        shard(tmp_path / "cut", number, of)
    assert not list((tmp_path / "cut").rglob("run.json"))
    data = town_of_six()
    (record,) = drive_planners(data, "val", PLANNERS[:1], tmp_path / "cut", SETTINGS, reopen=town_of_six)
    assert replace(record, directory=whole.directory) == whole == load_drives(whole.directory)
    assert bytes_below(tmp_path / "cut") == bytes_below(tmp_path / "whole")


def test_what_no_shard_drove_or_is_damaged_is_driven_by_the_run(tmp_path: Path) -> None:
    (whole,) = drive_planners(town_of_six(), "val", PLANNERS[:1], tmp_path / "whole", SETTINGS, reopen=town_of_six)
    shard(tmp_path / "cut", 1, 3)
    shard(tmp_path / "cut", 2, 2)
    kept = sorted((tmp_path / "cut").rglob("*-0.json"))
    kept[0].write_text(kept[0].read_text()[:-9])
    before = {path: path.stat().st_mtime_ns for path in kept[1:]}
    drive_planners(town_of_six(), "val", PLANNERS[:1], tmp_path / "cut", SETTINGS, reopen=town_of_six)
    assert before and all(path.stat().st_mtime_ns == at for path, at in before.items())
    assert bytes_below(tmp_path / "cut") == bytes_below(tmp_path / "whole") and whole.rows


def test_the_command_drives_shards_and_then_makes_the_record(tmp_path: Path) -> None:
    cars = {f"scene-990{number}": Car(60.0 + 9 * number, 198.25, 0.0) for number in (1, 2)}
    roads = [scene_on_straight_road((car,), seconds=4.0, name=name) for name, car in cars.items()]
    plan = write_root(tmp_path / "road", roads, version="v1.0-mini", renderer=None)
    given = ("drive", "--data", plan.root, "--split", "val", "--workers", "1", "--no-baselines")
    models = ("--model", "stop", "--model", "constant-velocity")
    whole = run_here(*given, *models, "--out", tmp_path / "whole")
    assert whole.code == 0, whole.err
    for number in (1, 2):
        done = run_here(*given, *models, "--out", tmp_path / "cut", "--shard", f"{number}/2", "--json")
        assert done.code == 0 and [each["driven"] for each in json.loads(done.out)] == [1, 1], done.err
    assert run_here(*given, *models, "--out", tmp_path / "cut").code == 0
    assert bytes_below(tmp_path / "cut") == bytes_below(tmp_path / "whole")
    refused = run_here(*given, *models, "--out", tmp_path / "cut", "--shard", "3/2")
    assert refused.code == 2 and "--shard takes INDEX/COUNT" in refused.err
