"""Scenes that somebody edited, as a frozen split: what differs from the recordings, in memory and in files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scenario_map import ExchangedScene
from benchmark.errors import InputError
from benchmark.machine.storage import make_token
from generation.sources.importing import ImportSettings, import_scenarionet
from generation.splits.building import build_frozen
from generation.splits.edited import build_edited_scene, build_edited_split
from generation.splits.format import EDITED, read_frozen
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.datasets.test_scenarionet import recording, write
from tests.generation.splits.frozen_files import BUILT, recordings
from tests.hand_made import Car, moved, scene_on_straight_road

PLAIN = replace(BUILT, renderer=None)
NAME = "scene-9901"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("recorded"))


def test_whoever_was_moved_is_an_adversary_of_a_split_that_is_built_like_any(source: DataSet, tmp_path: Path) -> None:
    recorded, path = source.scene(NAME), tmp_path / "mine.pkl"
    split = build_edited_split(source, path, ((path, ExchangedScene(moved(recorded, 1, 0.5), NAME)),))
    (scene,) = split.frozen.scenes
    (adversary,) = scene.adversaries
    assert (split.name, scene.source, split.frozen.search.algorithm) == ("mine", NAME, EDITED)
    assert (adversary.instance, adversary.launch_frame) == (recorded.agents.ids[1], 0)
    assert np.allclose([x for x, _, _ in adversary.track], recorded.agents.position[1, :, 0] + 0.5, atol=6e-4)
    report = build_frozen(source, split, replace(PLAIN, out=tmp_path / "adv"))
    assert report.other_tables == () and report.edited
    found = open_data(tmp_path / "adv").scene(scene.name)
    row = found.agents.ids.index(found.adversaries[0])
    at = found.keyframes
    assert np.allclose(found.annotations.position[row, :, 0], recorded.agents.position[1, at, 0] + 0.5, atol=1e-3)


def test_scenes_as_recorded_twice_or_recorded_elsewhere_are_refused(source: DataSet) -> None:
    recorded, path = source.scene(NAME), Path("mine.pkl")
    for scenes, message in (
        ((ExchangedScene(recorded, NAME),), "unchanged; move a vehicle"),
        ((ExchangedScene(moved(recorded, 0, 1.0), NAME),) * 2, "the same scene as another file"),
        ((ExchangedScene(replace(moved(recorded, 0, 1.0), name="scene-1"), "scene-1"),), "has no recording of"),
    ):
        with pytest.raises(InputError, match=message):
            build_edited_split(source, path, tuple((path, made) for made in scenes))


def test_only_vehicles_may_be_moved_and_only_where_they_were_recorded() -> None:
    recorded = scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(60.0, 208.0, 1.0, 0.0, "human.pedestrian.adult")))
    path = Path("mine.pkl")
    assert build_edited_scene(moved(recorded, 0, 1.0), recorded, path).adversaries[0].launch_frame == 0
    with pytest.raises(InputError, match=r"\(human.pedestrian.adult\) was moved; only vehicles"):
        build_edited_scene(moved(recorded, 1, 1.0), recorded, path)
    valid = recorded.agents.valid.copy()
    valid[0, :30] = False
    late = replace(recorded, agents=replace(recorded.agents, valid=valid))
    with pytest.raises(InputError, match="exists before frame 30, where its recording begins"):
        build_edited_scene(recorded, late, path)
    assert build_edited_scene(moved(late, 0, 1.0), late, path).adversaries[0].launch_frame == 30


def drifting(by_m: float) -> dict[str, Any]:
    """A recording of another source whose car drifts to the left; its tracks have names that a root keeps."""
    value = recording()
    value["tracks"]["1"]["state"]["position"][:, 1] += by_m * np.linspace(0.0, 1.0, value["length"])
    value["tracks"] = {
        name if name == "0" else make_token("track", name): each for name, each in value["tracks"].items()
    }
    return value


def test_the_command_builds_what_was_edited_in_files_and_freezes_it(tmp_path: Path) -> None:
    imported = ImportSettings(images=False, frames="keyframes")
    (name,) = import_scenarionet(write(tmp_path, drifting(0.0)), tmp_path / "road", imported, workers=1)
    write(tmp_path, drifting(1.0), "mine.pkl")
    out = ("--data", tmp_path / "road", "--renderer", "none", "--frames", "keyframes", "--workers", "1")
    edited = ("generate", "--from", tmp_path / "mine.pkl", *out)
    done = run_here(*edited, "--out", tmp_path / "out", "--freeze", tmp_path / "frozen.json")
    assert done.code == 0 and "1 scene built from the edited mine" in done.out, done.err
    (scene,) = read_frozen(tmp_path / "frozen.json").scenes
    assert scene.source == name and len(scene.adversaries) == 1
    again = run_here("generate", "--from", tmp_path / "frozen.json", "--out", tmp_path / "again", *out, "--json")
    assert again.code == 0 and json.loads(again.out)["other_tables"] == [], again.err
    dry = run_here(*edited, "--out", tmp_path / "dry", "--dry-run")
    assert dry.code == 0 and "nothing was written" in dry.out and not (tmp_path / "dry").exists()
    for wrong, message in (
        (("--seeds", "0,1"), "edited scenes are not searched"),
        (("--top", "3"), "--top applies only to a search"),
        (("--split", "val-r"), "--from always builds split adv"),
    ):
        refused = run_here(*edited, "--out", tmp_path / "no", *wrong)
        assert refused.code == 2 and message in refused.err
