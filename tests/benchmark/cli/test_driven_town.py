"""From a drive to a data set that is learned from: what the commands hand on to one another."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import open_data
from benchmark.records.driven_ego import read_driven_ego_targets
from benchmark.records.drives import DriveRecord, find_drives
from tests.benchmark.cli.cli_runs import run_main

SMALL = ("--town-scenes", "1", "--renderer", "none", "--workers", "1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return town_and_drive(tmp_path_factory.mktemp("driven"))


def town_and_drive(place: Path) -> Path:
    """A town of two training scenes that constant velocity was driven through."""
    built = run_main("data", "build", "--root", place / "road", "--train-scenes", "2", *SMALL)
    assert built.code == 0, built.err
    done = drive(place, "train")
    assert done.planner == "constant-velocity"
    return place


def drive(place: Path, split: str, agents: str = "replay", until: str = "contact", limit: int = 2) -> DriveRecord:
    out = place / f"{split} {agents}{'' if until == 'contact' else ' until fault'}"
    done = run_main(
        "drive", "--model", "constant-velocity", "--no-baselines", "--data", place / "road", "--split", split,
        "--agents", agents, "--until", until, "--out", out, "--workers", "1", "--limit", str(limit),
    )  # fmt: skip
    assert done.code == 0, done.err
    (record,) = find_drives(out)
    return record


def test_the_ego_goes_where_it_was_driven(folder: Path) -> None:
    (record,) = find_drives(folder / "train replay")
    command = ("data", "build", "--root", folder / "driven", "--driven", folder / "train replay", *SMALL)
    built = run_main(*command)
    assert built.code == 0, built.err
    data = open_data(folder / "driven")
    assert data.scene_names("train") == tuple(row.scene for row in record.rows)
    for row in record.rows:
        scene, learned = data.scene(row.scene), read_driven_ego_targets(data.provenance(), row.scene)
        assert learned is not None and learned.planner == "constant-velocity"
        states = np.array(row.ticks.ego)[: len(row.ticks.command)]
        assert len(scene.keyframes) == len(states)
        assert np.abs(scene.ego.position[scene.keyframes, :2] - states[:, :2]).max() < 1e-3
    again = run_main(*command)
    assert again.code == 0 and again.out == built.out


def test_drives_of_another_town_or_of_no_training_scene_are_refused(folder: Path) -> None:
    (record,) = find_drives(folder / "train replay")
    other = run_main("data", "build", "--root", folder / "other", "--driven", record.directory, "--seed", "7", *SMALL)
    assert other.code == 2
    assert "give the seed (and --crossing) of the town" in other.err
    evaluated = drive(folder, "val")
    refused = run_main("data", "build", "--root", folder / "val town", "--driven", evaluated.directory, *SMALL)
    assert refused.code == 2
    assert "no drive through training scenes" in refused.err
    both = run_main("data", "build", "--root", folder / "both", "--driven", folder, *SMALL)
    assert both.code == 2
    assert "2 records of drives" in both.err


def test_drives_in_which_others_answered_are_refused(folder: Path) -> None:
    answered = drive(folder, "train", "idm", limit=1)
    refused = run_main("data", "build", "--root", folder / "answered", "--driven", answered.directory, *SMALL)
    assert refused.code == 2
    assert "--agents idm" in refused.err
    left = drive(folder, "train", until="fault", limit=1)
    refused = run_main("data", "build", "--root", folder / "left", "--driven", left.directory, *SMALL)
    assert refused.code == 2
    assert "--until fault" in refused.err
