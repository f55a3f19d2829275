"""Every door tests plans: files are refused with what would fit, running planners are warned about, rows are marked."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from adapters.plan_file import WAYPOINT_COLUMNS
from adapters.result_files.writing.pickles import write_pickle
from benchmark.datasets.roots import open_data
from benchmark.geometry import Floats
from benchmark.records.run import load_record
from leaderboard.tables.collision import run_tables
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.edited_roots import small_town
from tests.benchmark.untrusted.misread import MISREAD, to_ego

SCENES = 2
Plans = dict[str, Floats]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_town(tmp_path_factory.mktemp("town") / "root", SCENES)


@pytest.fixture(scope="module")
def recorded(root: Path) -> Plans:
    """(6, 2) recorded positions of the lidar by sample token; of the last samples they stay where the scene ends."""
    data = open_data(root)
    return {
        truth.sample_token: truth.ego_future[:, :2] for name in data.scene_names("val") for truth in data.truth(name)
    }


def plan_file(path: Path, plans: Plans, frame: str = "lidar") -> Path:
    rows = [
        {"sample_token": token, "frame": frame, **dict(zip(WAYPOINT_COLUMNS, plan.ravel().tolist(), strict=True))}
        for token, plan in plans.items()
    ]
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def changed(plans: Plans, change: Callable[[Floats], Floats]) -> Plans:
    return dict(zip(plans, change(np.array([*plans.values()])), strict=True))


def record_below(folder: Path) -> Any:
    (path,) = folder.rglob("run.json")
    return load_record(path.parent)


@pytest.mark.parametrize("wrong", ["mirrored", "ego labelled lidar"])
def test_plan_files_are_refused_with_what_fits_and_the_option_that_takes_them(
    wrong: str, root: Path, recorded: Plans, tmp_path: Path
) -> None:
    change, says = MISREAD[wrong]
    path = plan_file(tmp_path / "mine.csv", changed(recorded, change))
    options = ("--data", root, "--split", "val", "--workers", "1", "--out", tmp_path / "out")
    refused = run_here("eval", "--plans", path, *options)
    assert refused.code == 2 and says in refused.err and "--as-is" in refused.err
    assert ("--frame ego reads it so" in refused.err) == (wrong == "ego labelled lidar")
    assert refused.err.strip().count("\n") == 0 and not (tmp_path / "out").exists()


def test_a_label_is_overridden_and_the_file_is_judged_as_if_it_were_right(
    root: Path, recorded: Plans, tmp_path: Path
) -> None:
    options = ("--data", root, "--split", "val", "--workers", "1", "--out", tmp_path / "out")
    wrong = plan_file(tmp_path / "wrong.csv", recorded, "ego")
    refused = run_here("eval", "--plans", wrong, *options)
    assert refused.code == 2 and "--frame lidar reads it so" in refused.err
    taken = run_here("eval", "--plans", wrong, "--frame", "lidar", *options)
    assert taken.code == 0 and "warning" not in taken.err and "checks: position: plans begin 1.00" in taken.err
    found = record_below(tmp_path)
    assert found.run.caveats == [] and found.summary.protocols["exact"].columns["l2"]["avg"].value < 1e-9
    assert found.run.planner.settings["frame"] == "lidar"


def test_a_file_that_is_taken_as_it_stands_is_marked_and_stays_so(root: Path, recorded: Plans, tmp_path: Path) -> None:
    path = plan_file(tmp_path / "mine.csv", changed(recorded, MISREAD["mirrored"][0]))
    options = ("--data", root, "--split", "val", "--workers", "1", "--out", tmp_path / "out")
    taken = run_here("eval", "--plans", path, "--as-is", *options)
    assert taken.code == 0 and "mine ¶" in taken.out
    assert taken.err.count("warning: mine: accepted as is (--as-is), although left and right") == 1
    (caveat,) = record_below(tmp_path).run.caveats
    assert caveat.kind == "as-is" and "mirrored 0.00 m" in caveat.sentence
    assert run_here("rescore", "--data", root, "--out", tmp_path / "out").code == 0
    assert record_below(tmp_path).run.caveats == [caveat]


def test_result_files_have_the_same_options(root: Path, recorded: Plans, tmp_path: Path) -> None:
    plans = changed(recorded, to_ego)
    path = write_pickle(tmp_path / "pred_trajs_dict.pkl", plans, 4)
    options = ("--data", root, "--split", "val", "--workers", "1", "--out", tmp_path / "out")
    refused = run_here("eval", "--results", path, *options)
    assert refused.code == 2 and "--frame ego reads it so, or accept it with --as-is" in refused.err
    marked = run_here("eval", "--results", path, "--as-is", "--name", "sideways", *options)
    assert marked.code == 0 and "sideways ¶" in marked.out


def test_a_running_planner_is_warned_about_once_and_its_record_is_marked(root: Path, tmp_path: Path) -> None:
    options = ("--data", root, "--split", "val", "--workers", "1", "--out", tmp_path / "out")
    name = "tests.benchmark.untrusted.running:Sideways"
    done = run_here("eval", "--model", name, "--model", "stop", *options)
    assert done.code == 0 and done.err.count("warning:") == 1
    assert "warning: sideways: x and y look exchanged and turned" in done.err
    by_planner = {
        found.planner: found for found in map(load_record, {path.parent for path in tmp_path.rglob("run.json")})
    }
    (caveat,) = by_planner["sideways"].run.caveats
    assert caveat.kind == "plans" and by_planner["stop"].run.caveats == []
    (table,) = run_tables("town", [*by_planner.values()], ["exact"])[:1]
    assert f"¶ sideways on val: {caveat.sentence}." in table.notes


def test_options_without_anything_that_they_are_about_are_refused(root: Path) -> None:
    options = ("--data", root, "--split", "val")
    assert "--frame is for plan files and models" in run_here("eval", "--model", "stop", "--frame", "ego", *options).err
    assert (
        "--frame is for plan files and models" in run_here("drive", "--model", "stop", "--frame", "ego", *options).err
    )
    assert (
        "--as-is applies only to --plans and --results" in run_here("eval", "--model", "stop", "--as-is", *options).err
    )
