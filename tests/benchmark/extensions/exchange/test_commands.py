"""Scenes out to other formats and in again, as commands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.generation.labels.recorded_roads import recorded, write_source
from tests.generation.nuscenes_writer.written_roots import with_adversary

REPORT = {"launch_frame": 6, "labels": {"manoeuvre": "cut-in-left"}}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901"), recorded("scene-9902"))


@pytest.fixture(scope="module")
def adversarial(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    """Two variants of one recording in one root."""
    root = tmp_path_factory.mktemp("adversarial")
    plan = DataSetPlan(root=root, split="adv", version="v1.0-mini")
    keys = []
    for agent in range(2):
        scene = with_adversary(source.scene("scene-9901"), agent)
        name = f"scene-9901-{agent:08d}"
        keys.append(write_scene(plan, scene, name=name, source_scene="scene-9901", report=REPORT))
    finish_data_set(plan, keys)
    return open_data(root)


def test_a_root_comes_back_with_equal_tracks_map_and_adversaries(adversarial: DataSet, tmp_path: Path) -> None:
    said = run_here(
        "data", "export", "scenarionet", adversarial.root, "--to", tmp_path / "files", "--workers", "1", "--json"
    )
    written = json.loads(said.out)["scenes"]
    assert said.code == 0 and [len(each["adversaries"]) for each in written] == [1, 1]
    done = run_here(
        "data", "import", "scenarionet", tmp_path / "files", "--out", tmp_path / "back", "--split", "adv",
        "--renderer", "none", "--workers", "1",
    )  # fmt: skip
    assert done.code == 0, done.err
    back = open_data(tmp_path / "back")
    names = adversarial.scene_names("adv")
    assert back.scene_names("adv") == names and len(names) == 2
    for name in names:
        mine, theirs = adversarial.scene(name), back.scene(name)
        assert theirs.adversaries == mine.adversaries and len(mine.adversaries) == 1
        order = [theirs.agents.ids.index(each) for each in mine.agents.ids]
        assert np.allclose(theirs.agents.position[order], mine.agents.position, atol=1e-9)
        assert np.allclose(theirs.annotations.rotation[order], mine.annotations.rotation, atol=1e-9)
        assert np.array_equal(theirs.annotations.num_lidar_pts[order], mine.annotations.num_lidar_pts)
        assert np.array_equal(theirs.annotations.attribute[order], mine.annotations.attribute)
        assert np.array_equal(theirs.timestamps_us, mine.timestamps_us)
        assert np.allclose(theirs.ego.position, mine.ego.position, atol=1e-9)
        assert theirs.road_map.drivable_area.symmetric_difference(mine.road_map.drivable_area).area < 1e-6
        assert {line.kind for line in theirs.road_map.dividers} == {line.kind for line in mine.road_map.dividers}
        assert set(theirs.road_map.lanes) == set(mine.road_map.lanes)
        for lane, own in mine.road_map.lanes.items():
            assert np.allclose(theirs.road_map.lanes[lane].centerline, own.centerline, atol=1e-6)
    facts, known = back.scene_facts(names), adversarial.scene_facts(names)
    assert {name: (fact.source, fact.manoeuvre) for name, fact in facts.items()} == {
        name: (fact.source, fact.manoeuvre) for name, fact in known.items()
    }
    assert (back.provenance() or {})["scenes"][names[0]]["report"] == REPORT


def test_exporting_twice_gives_the_same_bytes_and_only_what_was_asked_for(adversarial: DataSet, tmp_path: Path) -> None:
    name = adversarial.scene_names("adv")[1]
    files = []
    for folder in ("one", "two"):
        to = tmp_path / folder
        done = run_here(
            "data", "export", "scenarionet", adversarial.root, "--scenes", name, "--to", to, "--workers", "1"
        )
        assert done.code == 0 and done.out == f"1 scene in {to}, 1 adversary named in it\n"
        files.append(bytes_below(to))
    assert files[0] == files[1] and len(files[0]) == 3


def test_adversarial_scenes_are_never_imported_into_val(adversarial: DataSet, tmp_path: Path) -> None:
    run_here(
        "data", "export", "scenarionet", adversarial.root, "--limit", "1", "--to", tmp_path / "to", "--workers", "1"
    )
    done = run_here("data", "import", "scenarionet", tmp_path / "to", "--out", tmp_path / "back", "--workers", "1")
    assert done.code == 2 and "import it with --split adv" in done.err
    assert not open_tables_below(tmp_path / "back")


def open_tables_below(root: Path) -> list[Path]:
    return list(root.rglob("scene.json"))


def test_scenes_of_variant_roots_travel_together(source: DataSet, tmp_path: Path) -> None:
    root = tmp_path / "variants"
    plan = DataSetPlan(root=root, split="adv", version="v1.0-mini", layout="per-variant")
    scene = source.scene("scene-9901")
    keys = [
        write_scene(
            plan, with_adversary(scene, agent), name="scene-9901", source_scene="scene-9901", report={}, variant=agent
        )
        for agent in range(2)
    ]
    finish_data_set(plan, keys)
    assert run_here("data", "export", "scenarionet", root, "--to", tmp_path / "to", "--workers", "1").code == 0
    done = run_here(
        "data", "import", "scenarionet", tmp_path / "to", "--out", tmp_path / "back", "--split", "adv",
        "--renderer", "none", "--workers", "1",
    )  # fmt: skip
    assert done.code == 0, done.err
    back = open_data(tmp_path / "back")
    assert back.scene_names("adv") == ("scene-9901-v0", "scene-9901-v1")
    for agent, name in enumerate(back.scene_names("adv")):
        theirs, mine = back.scene(name), with_adversary(scene, agent)
        row = theirs.agents.ids.index(theirs.adversaries[0])
        assert np.allclose(theirs.annotations.position[row], mine.annotations.position[agent], atol=1e-9)


def test_a_broken_scene_is_one_sentence(adversarial: DataSet, tmp_path: Path) -> None:
    empty = write_source(tmp_path / "odd", replace(recorded("scene-9901"), cameras=()))
    for arguments, message in (
        (("nowhere", "--to", tmp_path / "a"), "there is no folder"),
        ((empty.root, "--to", tmp_path / "b", "--split", "adv"), "adv"),
        ((empty.root, "--to", tmp_path / "c", "--scenes", "scene-1"), "there is no scene scene-1"),
        ((empty.root, "--to", empty.root / "v1.0-mini" / "scene.json"), "is a file"),
    ):
        done = run_here("data", "export", "scenarionet", *arguments, "--workers", "1")
        assert done.code == 2 and message in done.err and len(done.err.splitlines()) == 1
