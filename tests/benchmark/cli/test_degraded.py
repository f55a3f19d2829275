"""What a user sees of a root that lacks something, and of plans that lack rows."""

import csv
import json
import shutil
from pathlib import Path

import pytest

from adapters.plan_file import WAYPOINT_COLUMNS
from benchmark.datasets.roots import open_data
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.edited_roots import copy_of, small_town


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "root")


def test_a_missing_map_is_said_once_for_each_planner_and_marks_the_row(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "data" / "root")
    shutil.move(root / "maps" / "expansion", tmp_path / "data" / "expansion")
    checked = run_here("data", "check", root)
    assert checked.code == 0 and "lies at ../expansion/boston-seaport.json" in checked.out
    done = run_here("eval", "--data", root, "--model", "idm", "--model", "stop", "--out", tmp_path / "out")
    warnings = [line for line in done.err.splitlines() if line.startswith("warning: ")]
    assert done.code == 0 and [line.split(":")[1] for line in warnings] == [" idm", " stop"]
    assert (
        "idm † ¶" in done.out
        and "drives straight instead" in warnings[0]
        and "drives straight instead" not in warnings[1]
    )
    sound = run_here("eval", "--data", town, "--model", "idm", "--out", tmp_path / "sound")
    assert sound.code == 0 and "warning" not in sound.err and "¶" not in sound.out


def plans(root: Path, path: Path, *, first: int, by_keyframe: bool) -> Path:
    """A file of plans that stand still, without the first rows."""
    data = open_data(root)
    (scene,) = data.scene_names("val")
    names = {sample: row for row, sample in data.keyframe_rows(scene).items()}
    tokens = [truth.sample_token for truth in data.truth(scene)]
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["sample_token", "frame", *WAYPOINT_COLUMNS])
        writer.writerows([names[each] if by_keyframe else each, "ego", *[0.0] * 12] for each in tokens[first:])
    return path


def test_missing_rows_of_a_plan_file_are_a_partial_run_where_that_is_allowed(town: Path, tmp_path: Path) -> None:
    path = plans(town, tmp_path / "mine.csv", first=3, by_keyframe=True)

    def run(*more: str) -> Done:
        return run_here("eval", "--data", town, "--plans", path, "--out", tmp_path / "out", *more)

    refused = run()
    assert refused.code == 2 and "--allow-partial" in refused.err and not (tmp_path / "out").exists()
    done = run("--allow-partial", "--json")
    (said,) = json.loads(done.out)
    assert done.code == 0 and said["status"] == "partial" and said["failed"] == 3
    assert "tokens of sample_data rows" in done.err
