"""Roots under names of nuScenes' validation scenes: what readers with hard-coded splits do with them, and the mark.

The rules of py123d 0.7 and trajdata 1.4 are re-stated here; `bench/clients.py` runs the packages themselves.
"""

import csv
import itertools
import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from nuscenes.can_bus.can_bus_api import NuScenesCanBus
from nuscenes.map_expansion.arcline_path_utils import discretize_lane
from nuscenes.map_expansion.map_api import NuScenesMap
from nuscenes.nuscenes import NuScenes
from nuscenes.utils.splits import create_splits_scenes

from benchmark.constants import CAMERA_NAMES, NUSCENES_TABLES, OFFICIAL_LOCATIONS
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.extensions.exchange.borrowed_names import NAMES_FILE, export_nuscenes
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.generation.nuscenes_writer.written_roots import (
    SolidRenderer,
    contents,
    short_scene,
    with_adversary,
    write_root,
)
from tests.hand_made import scene_on_straight_road

VERSION = "v1.0-trainval"
OWN = ("scene-9901-aa", "scene-9901-bb", "scene-9902-cc")


def write_variants(root: Path, **settings: Any) -> Path:
    """Two variants of one recording, which share their times, and one of another."""
    plan = DataSetPlan(root=root, **{"split": "adv", "renderer": SolidRenderer(), **settings})
    scenes = [with_adversary(short_scene(name[:10]), agent) for agent, name in zip((0, 1, 0), OWN)]
    report = {"labels": {"manoeuvre": "cut-in-left"}}
    keys = [
        write_scene(plan, scene, name=name, source_scene=scene.name, report=report)
        for scene, name in zip(scenes, OWN, strict=True)
    ]
    finish_data_set(plan, keys)
    return root


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_variants(tmp_path_factory.mktemp("variants") / "root")


@pytest.fixture(scope="module")
def exported(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    before, to = contents(root), tmp_path_factory.mktemp("exported") / "root"
    data = NuScenesData.open(root)
    export_nuscenes(data, data.scene_names(), to)
    assert contents(root) == before
    return to


def read_table(root: Path, name: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads((root / VERSION / f"{name}.json").read_text())
    return rows


def read_names(root: Path) -> dict[str, dict[str, str]]:
    with (root / NAMES_FILE).open() as stream:
        return {row["scene"]: row for row in csv.DictReader(stream)}


def find_logs_as_py123d(root: Path) -> dict[str, list[Any]]:
    """Keyframes of each log of ``nuscenes_val``: a log is a scene of the official list, whatever else is there."""
    nusc = NuScenes(VERSION, str(root), verbose=False)
    can_bus = NuScenesCanBus(str(root))
    logs = {}
    for scene in nusc.scene:
        if scene["name"] not in create_splits_scenes()["val"]:
            continue
        samples, token = [], scene["first_sample_token"]
        times = [message["utime"] for message in can_bus.get_messages(scene["name"], "pose")]
        while token:
            sample = nusc.get("sample", token)
            assert {*CAMERA_NAMES, "LIDAR_TOP"} <= set(sample["data"])
            # Farther messages count as none, and the ego as standing.
            assert np.abs(np.array(times) - sample["timestamp"]).min() <= 500_000
            samples.append(sample)
            token = sample["next"]
        logs[scene["name"]] = samples
    return logs


def find_scenes_as_trajdata(root: Path) -> list[str]:
    """Scenes of ``nusc_trainval-val``: every scene needs a split, and lies in a city that the name begins with."""
    lists = create_splits_scenes()
    splits = {name: split for split in ("train", "val") for name in lists[split]}
    nusc = NuScenes(VERSION, str(root), verbose=False)
    names = []
    for scene in nusc.scene:
        city = nusc.get("log", scene["log_token"])["location"].split("-")[0]
        if splits[scene["name"]] == "val" and city in ("boston", "singapore"):
            assert scene["description"].lower() is not None
            names.append(scene["name"])
    return names


def count_lanes_as_trajdata(root: Path, city: str) -> int:
    """Lanes of one of the four maps, all of which are read: a search tree of no centre line is an error."""
    road = NuScenesMap(str(root), city)
    for lane in road.lane:
        center = np.array(discretize_lane(road.arcline_path_3.get(lane["token"], []), 0.5))[:, :2]
        outline = road.get("polygon", lane["polygon_token"])["exterior_node_tokens"]
        corners = np.array([[road.get("node", token)[axis] for axis in "xy"] for token in outline])
        line = shapely.LineString(center)
        assert len(center) > 1 and shapely.distance(shapely.points(corners), line).max() < 10
    np.concatenate([np.zeros((1, 2)) for _ in road.lane])
    return len(road.lane)


def test_py123d_finds_each_scene_as_a_log(root: Path, exported: Path) -> None:
    logs = find_logs_as_py123d(exported)
    assert [len(samples) for samples in logs.values()] == [5, 5, 5]
    assert set(logs) == set(read_names(exported))
    assert find_logs_as_py123d(root) == {}


def test_trajdata_finds_each_scene_and_reads_four_maps(root: Path, exported: Path) -> None:
    assert sorted(find_scenes_as_trajdata(exported)) == sorted(read_names(exported))
    assert {count_lanes_as_trajdata(exported, city) for city in OFFICIAL_LOCATIONS} == {4}
    with pytest.raises(KeyError, match="scene-9901-"):
        find_scenes_as_trajdata(root)
    with pytest.raises(ValueError, match="need at least one array"):
        count_lanes_as_trajdata(root, "singapore-queenstown")


def test_scenes_are_one_after_the_other_and_differ_from_their_own_in_name_and_time_alone(
    root: Path, exported: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs, named = find_logs_as_py123d(exported), read_names(exported)
    spans = sorted((samples[0]["timestamp"], samples[-1]["timestamp"]) for samples in logs.values())
    assert all(last + 2_000_000 < first for (_, last), (first, _) in itertools.pairwise(spans))
    assert sorted(int(row["shift_us"]) > 0 for row in named.values()) == [False, False, True]
    NuScenes(VERSION, str(exported), verbose=False).list_scenes()
    assert next(iter(named)) in capsys.readouterr().out
    shifts = {row["name"]: int(row["shift_us"]) for row in named.values()}
    own_names = {row["token"]: row["name"] for row in read_table(root, "scene")}
    scene_of = {row["token"]: own_names[row["scene_token"]] for row in read_table(root, "sample")}
    scene_of |= {row["ego_pose_token"]: scene_of[row["sample_token"]] for row in read_table(root, "sample_data")}
    for table in NUSCENES_TABLES:
        mine, theirs = ({row["token"]: row for row in read_table(folder, table)} for folder in (exported, root))
        for token, row in theirs.items():
            moved = dict(row)
            if table == "scene":
                moved["name"] = next(scene for scene, other in named.items() if other["name"] == row["name"])
            if "timestamp" in row:
                moved["timestamp"] += shifts[scene_of[row.get("sample_token", token)]]
            assert mine.pop(token) == moved
        assert not mine
    for scene, row in named.items():
        mine, theirs = (
            json.loads((folder / "can_bus" / f"{name}_pose.json").read_text())
            for folder, name in ((exported, scene), (root, row["name"]))
        )
        assert mine == [{**each, "utime": each["utime"] + int(row["shift_us"])} for each in theirs]


def test_the_roots_own_file_says_which_scene_is_which(root: Path, exported: Path) -> None:
    named = read_names(exported)
    assert [row["name"] for row in named.values()] == list(OWN)
    assert [row["source_scene"] for row in named.values()] == ["scene-9901", "scene-9901", "scene-9902"]
    assert list(named) == sorted(create_splits_scenes()["val"])[:3]
    mark, theirs = (NuScenesData.open(folder).provenance() or {} for folder in (exported, root))
    assert mark["source"]["fingerprint"] == NuScenesData.open(root).fingerprint()
    for scene, row in named.items():
        report = mark["scenes"][scene]
        assert report["exported_from"] == row["name"] and report["source_scene"] == row["source_scene"]
        assert {**report, **theirs["scenes"][row["name"]]} == report and len(report["adversaries"]) == 1
    ours = NuScenesData.open(exported)
    for scene, row in named.items():
        assert (exported / "samples" / "CAM_FRONT").is_dir()
        truth, own = ours.truth(scene), NuScenesData.open(root).truth(row["name"])
        assert [mine.ego_future.tolist() for mine in truth] == [theirs.ego_future.tolist() for theirs in own]
        assert next(iter(ours.observations(scene))).views["CAM_FRONT"].load().any()


@pytest.mark.parametrize("listed", [False, True])
def test_no_command_takes_it_for_validation_scenes(exported: Path, tmp_path: Path, listed: bool) -> None:
    copy = shutil.copytree(exported, tmp_path / "root", symlinks=True)
    if listed:
        (copy / "splits.json").write_text(json.dumps({"val": sorted(read_names(exported))}))
    out = ("--out", tmp_path / "out")
    for command in (
        ("eval", "--data", copy, "--model", "idm"),
        ("eval", "--data", copy, "--model", "idm", "--split", "val"),
        ("eval", "--data", copy, "--model", "idm", "--split", "adv"),
        ("eval", "--data", copy, "--model", "idm", "--split", "borrowed-names"),
        ("drive", "--data", copy, "--model", "idm", "--split", "val"),
        ("generate", "--data", copy),
        ("data", "stats", copy, "--split", "val"),
        ("data", "export", "nuscenes", copy, "--to", tmp_path / "to"),
    ):
        done = run_here(*command, *out)
        assert done.code == 2 and "exported from" in done.err + done.out, command
    assert not (tmp_path / "out").exists() and not (tmp_path / "to").exists()
    told = run_here("data", "info", copy)
    assert told.code == 0 and "cannot be evaluated" in told.out
    for split in ("val", "adv", "borrowed-names"):
        with pytest.raises(InputError, match="are none of them"):
            open_data(copy).scene_names(split)
    assert len(open_data(copy).scene_names()) == 3
    assert run_here("data", "check", copy).code == 0


def test_recordings_keep_the_official_names_that_they_have(tmp_path: Path) -> None:
    scenes = [short_scene(name, seconds=1.0) for name in ("scene-0003", "scene-0061", "scene-0553")]
    write_root(tmp_path / "root", scenes)
    for name in ("challenger.json", "splits.json"):
        (tmp_path / "root" / VERSION / name).unlink()
    data = NuScenesData.open(tmp_path / "root")
    (written,) = export_nuscenes(data, data.scene_names(), tmp_path / "to")
    assert {scene.name: scene.scene for scene in written.names} == {
        "scene-0003": "scene-0003", "scene-0061": "scene-0012", "scene-0553": "scene-0553",
    }  # fmt: skip
    assert all(scene.shift_us == 0 for scene in written.names)
    mark = NuScenesData.open(tmp_path / "to").provenance() or {}
    assert all(report["adversaries"] == [] for report in mark["scenes"].values())
    chosen = run_here(
        "data", "export", "nuscenes", tmp_path / "root", "--limit", "1", "--json", "--to", tmp_path / "one"
    )
    assert [scene["name"] for scene in json.loads(chosen.out)["roots"][0]["names"]] == ["scene-0003"]
    assert {len(read_table(tmp_path / "one", table)) for table in ("scene", "log", "calibrated_sensor")} == {1, 7}


def test_more_scenes_than_names_are_refused(tmp_path: Path) -> None:
    scene = scene_on_straight_road(seconds=0.5)
    many = [replace(scene, name=f"scene-{9000 + number}") for number in range(151)]
    made = TinyRoot.of(tmp_path / "root", many, sweeps=False, cameras=()).write()
    done = run_here("data", "export", "nuscenes", made, "--to", tmp_path / "to")
    assert done.code == 2
    assert done.err.count("\n") == 1 and "has 151 scenes to export" in done.err and "names for 150" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["root"]


def test_what_readers_would_fail_at_is_refused_and_leaves_nothing(root: Path, tmp_path: Path) -> None:
    scene = short_scene(seconds=1.0)
    away = replace(scene, road_map=replace(scene.road_map, location="town"))
    write_root(tmp_path / "away", [away])
    write_root(tmp_path / "blind", [scene], renderer=None)
    broken = shutil.copytree(root, tmp_path / "broken")
    path = next((broken / "can_bus").glob("scene-9901-bb_pose.json"))
    path.write_text(path.read_text().replace('"utime":', '"more":NaN,"utime":', 1))
    for name, why in (("away", "lies in town"), ("blind", "has no CAM_FRONT"), ("broken", "is not finite")):
        data = NuScenesData.open(tmp_path / name)
        with pytest.raises(InputError, match=why):
            export_nuscenes(data, data.scene_names(), tmp_path / "to")
    with pytest.raises(InputError, match="no scene to export"):
        export_nuscenes(data, [], tmp_path / "to")
    with pytest.raises(InputError, match="no scene 'scene-1'"):
        export_nuscenes(data, ["scene-1"], tmp_path / "to")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["away", "blind", "broken"]


def test_twice_is_once_and_nothing_of_others_is_written_over(root: Path, tmp_path: Path) -> None:
    data, to = NuScenesData.open(root), tmp_path / "to"
    # What a killed process left is cleared.
    (tmp_path / ".to.part" / "can_bus").mkdir(parents=True)
    (tmp_path / ".to.part" / "can_bus" / "left.json").write_text("[]")
    first = export_nuscenes(data, data.scene_names(), to)
    before = contents(to)
    assert export_nuscenes(data, data.scene_names(), to) == first and contents(to) == before
    assert [path.name for path in tmp_path.iterdir()] == ["to"] and not (to / "can_bus" / "left.json").exists()
    with pytest.raises(InputError, match="is not empty"):
        export_nuscenes(data, OWN[:1], to)
    with pytest.raises(InputError, match="is not empty"):
        export_nuscenes(data, OWN, root)
    assert contents(to) == before


def test_each_of_several_roots_becomes_one(tmp_path: Path) -> None:
    for number, name in enumerate(("scene-9901", "scene-9902")):
        write_root(tmp_path / "roots" / f"v{number}", [short_scene(name, seconds=1.0)])
    data = open_data(tmp_path / "roots")
    written = export_nuscenes(data, data.scene_names(), tmp_path / "to")
    assert [scene.name for root in written for scene in root.names] == ["scene-9901", "scene-9902"]
    assert [list(find_logs_as_py123d(tmp_path / "to" / name)) for name in ("v0", "v1")] == [["scene-0003"]] * 2
    assert len(export_nuscenes(data, ["v1/scene-9902"], tmp_path / "one")) == 1
