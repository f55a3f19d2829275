"""``drive`` as a user runs it, on a small data set on disk."""

import json
import shutil
from pathlib import Path

import pytest

from tests.benchmark.cli.in_process import run_here
from tests.benchmark.cli.test_drive_trouble import driving, road

BASELINES = {"stop", "constant-velocity", "constant-velocity-on-path", "log-replay", "idm"}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return road(tmp_path_factory.mktemp("data") / "road")


@pytest.fixture(scope="module")
def out(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    assert driving(source, folder).code == 0
    return folder


def test_the_baselines_are_in_every_table(source: Path, out: Path) -> None:
    done = driving(source, out, "--json")
    rows = json.loads(done.out)
    assert done.code == 0 and {each["planner"] for each in rows} == BASELINES
    by_name = {each["planner"]: each["columns"] for each in rows}
    assert by_name["constant-velocity"]["at_fault"]["value"] == 1.0
    assert by_name["stop"]["contact"]["value"] == 0.0 and by_name["stop"]["route"]["value"] < 0.3
    assert by_name["idm"]["contact"]["value"] == 0.0
    assert all(each["measured"]["sensor"] == "none" for each in rows)


def test_the_table_says_what_was_measured(source: Path, out: Path) -> None:
    done = driving(source, out)
    assert "road val: closed loop, engine default, agents replay" in done.out and "log-replay †" in done.out
    assert "next: challenger-bench eval" in done.err


def test_a_dry_run_says_how_long_and_writes_nothing(source: Path, tmp_path: Path) -> None:
    done = driving(source, tmp_path / "new", "--dry-run", "--model", "stop", "--no-baselines")
    assert done.code == 0 and "would drive stop through 1 scene of val" in done.out and "at most about" in done.out
    assert not (tmp_path / "new").exists()


def test_a_network_sees_what_the_sensor_draws(source: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    options = ("--model", "sparsedrive-mini", "--sensor", "schematic", "--no-baselines", "--json")
    done = driving(source, tmp_path, *options)
    (row,) = json.loads(done.out)
    assert done.code == 0 and row["failed"] == 0 and row["measured"]["sensor"] == "schematic"
    assert row["measured"]["sensor_facts"]["style"] == "first"


def test_stored_drives_are_scored_anew_beside_runs(source: Path, out: Path, tmp_path: Path) -> None:
    copy = tmp_path / "out"
    shutil.copytree(out / "drives" / "road" / "val" / "default-replay-none", copy / "drives" / "d")
    options = ("rescore", "--data", source, "--out", copy)
    said = json.loads(run_here(*options, "--json").out)
    assert len(said) == 5 and {each["says"] for each in said} == {"current"}
    head = next((copy / "drives").rglob("drive.json"))
    head.write_text(head.read_text().replace('"scoring": ', '"scoring": 90'))
    done = run_here(*options)
    assert done.code == 0 and f"{head.parent}: rescored" in done.out and done.out.count("current") == 4
    head.write_text("{")
    done = run_here(*options)
    assert done.code == 1 and str(head) in done.out and done.out.count("current") == 4
    done = run_here("rescore", "--data", source, "--out", tmp_path / "new")
    assert done.code == 2 and "no evaluation records" in done.err and "no drive" in done.err
