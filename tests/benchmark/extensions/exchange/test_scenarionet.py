"""A scene as a ScenarioNet file and back, by functions and by commands: equal; and edited in between."""

import json
import pickle
import pickletools
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scenario_map import ADVERSARIES, OWN, ExchangedScene
from benchmark.datasets.scenarionet import read_exchanged_scene, read_scenarionet
from benchmark.errors import InputError
from benchmark.extensions.exchange.exporting import (
    build_scenario,
    export_scenarionet,
    pickle_plain,
    read_exchange_scene,
)
from benchmark.geometry import quaternion_from_yaw
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.nuscenes_writer.plan import to_digestible
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.benchmark.datasets.test_scenarionet import FILES, needs_shared, recording, write
from tests.benchmark.extensions.exchange.wild_scenes import wild_scene
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.irregular_time import with_key_frames
from tests.generation.labels.recorded_roads import recorded, write_source
from tests.generation.nuscenes_writer.written_roots import with_adversary
from tests.hand_made import Car, scene_on_straight_road


def there_and_back(made: ExchangedScene, folder: Path) -> ExchangedScene:
    path = folder / "sd_there.pkl"
    path.write_bytes(pickle_plain(build_scenario(made)))
    return read_exchanged_scene(path)


def differing(first: Scene, second: Scene) -> list[str]:
    return [
        item.name
        for item in fields(Scene)
        if to_digestible(getattr(first, item.name)) != to_digestible(getattr(second, item.name))
    ]


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32))
def test_any_scene_comes_back_bit_for_bit(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    scene = wild_scene(seed)
    report = {"launch_frame": 3, "labels": {"manoeuvre": "cut-in-left", "gap": 0.1 + 0.2}, "none": None}
    back = there_and_back(ExchangedScene(scene, "scene-0061", report), tmp_path_factory.mktemp("wild"))
    assert differing(scene, back.scene) == []
    assert (back.source_scene, back.report) == ("scene-0061", report)
    assert back.scene.adversaries == scene.adversaries


@needs_shared
@pytest.mark.parametrize("path", FILES[:3], ids=lambda path: path.stem[-10:])
def test_recorded_scenes_come_back_bit_for_bit(path: Path, tmp_path: Path) -> None:
    scene = read_scenarionet(path)
    back = there_and_back(ExchangedScene(scene, scene.name), tmp_path).scene
    assert scene.adversaries == () and differing(scene, back) == []


def test_the_file_holds_plain_values_alone_and_is_the_same_twice() -> None:
    made = ExchangedScene(wild_scene(7), "scene-0061")
    data = pickle_plain(build_scenario(made))
    strings = [str(argument) for code, argument, _ in pickletools.genops(data) if code.name == "SHORT_BINUNICODE"]
    asked = {
        (strings[index], name)
        for index, name in enumerate(strings[1:])
        if strings[index].startswith("numpy") or strings[index] in ("builtins", "collections")
    }
    assert asked <= {(f"numpy.{core}.multiarray", "_reconstruct") for core in ("core", "_core")} | {
        ("numpy", "ndarray"), ("numpy", "dtype"),
    }  # fmt: skip
    again = pickle.loads(pickle.dumps(made))  # noqa: S301 - made by this test
    assert pickle_plain(build_scenario(again)) == data


def require_as_scenarionet_says(value: dict[str, Any]) -> None:
    """What MetaDrive's own check asks, written down once more."""
    assert {"id", "version", "length", "metadata", "tracks", "map_features", "dynamic_map_states"} <= value.keys()
    metadata, length = value["metadata"], value["length"]
    assert {"metadrive_processed", "coordinate", "ts"} <= metadata.keys() and metadata["ts"].shape == (length,)
    kinds = {"VEHICLE", "PEDESTRIAN", "CYCLIST", "TRAFFIC_CONE", "TRAFFIC_BARRIER", "TRAFFIC_OBJECT", "OTHER"}
    for name, track in value["tracks"].items():
        state = track["state"]
        assert track["type"] in kinds and track["metadata"]["object_id"] == name and track["metadata"]["type"]
        assert {"position", "heading", "velocity", "valid", "length", "width", "height"} <= state.keys()
        assert all(len(array) == length and array.ndim in (1, 2) for array in state.values())
        gone = state["valid"] == 0
        assert gone.sum() < length and all(not array[gone].any() for array in state.values())
    for feature in value["map_features"].values():
        if "polygon" in feature and "polyline" in feature:
            assert np.linalg.norm(feature["polygon"].mean(axis=0) - feature["polyline"].mean(axis=0)) < 100
    assert metadata["sdc_id"] in value["tracks"]


@pytest.mark.parametrize("seed", range(3))
def test_files_are_as_scenarionet_says(seed: int) -> None:
    require_as_scenarionet_says(build_scenario(ExchangedScene(wild_scene(seed), "scene-0061")))


def test_metadrive_accepts_them(tmp_path: Path) -> None:
    description = pytest.importorskip("metadrive.scenario.scenario_description").ScenarioDescription
    value = build_scenario(ExchangedScene(wild_scene(3), "scene-0061"))
    description.sanity_check(pickle.loads(pickle_plain(value)), valid_check=True)  # noqa: S301 - made by this test


def test_what_stands_in_the_file_is_what_others_expect() -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(120.0, 201.75, 9.0, np.pi, "vehicle.bicycle")))
    scene = replace(scene, adversaries=scene.agents.ids[:1])
    value = build_scenario(ExchangedScene(scene, scene.name))
    first, second = scene.agents.ids
    assert value["metadata"][ADVERSARIES] == [first]
    assert [track["metadata"]["is_adversary"] for track in value["tracks"].values()] == [False, True, False]
    assert value["tracks"][second]["type"] == "CYCLIST" and value["tracks"]["ego"]["type"] == "VEHICLE"
    ego = value["tracks"]["ego"]["state"]
    assert np.allclose(ego["position"][:, 0] - scene.ego.position[:, 0], EGO_CENTER_FROM_REAR_AXLE_M)
    # Microseconds of the clock are rounded.
    assert np.allclose(value["tracks"][first]["state"]["velocity"], [8.0, 0.0], atol=1e-3)
    assert np.allclose(value["tracks"][second]["state"]["velocity"], [-9.0, 0.0], atol=1e-3)
    summary = value["metadata"]["number_summary"]
    assert (summary["num_objects"], summary["num_moving_objects"]) == (3, 3)
    assert value["metadata"]["object_summary"][first]["moving_distance"] == pytest.approx(8.0 * scene.seconds[-1])


def edited(folder: Path, change: Any, seed: int = 12) -> tuple[Scene, Scene]:
    """A scene, and what is read of its file after a change to what the file holds."""
    scene = wild_scene(seed)
    assert len(scene.agents) > 2
    value = pickle.loads(pickle_plain(build_scenario(ExchangedScene(scene, "scene-0061"))))  # noqa: S301 - made by this test
    change(value)
    return scene, read_scenarionet(write(folder, value))


def test_an_edited_track_is_annotated_where_it_is_now(tmp_path: Path) -> None:
    scene = wild_scene(12)
    name = scene.agents.ids[1]

    def change(value: dict[str, Any]) -> None:
        value["tracks"][name]["state"]["position"][:, 0] += 2.0

    before, after = edited(tmp_path, change)
    there = before.agents.valid[1]
    assert np.allclose((after.agents.position - before.agents.position)[1, there], [2.0, 0.0, 0.0])
    at = before.annotations.valid[1]
    position = after.agents.position[1, before.keyframes]
    assert np.array_equal(after.annotations.position[1, at], position[at])
    yaw = after.agents.yaw[1, before.keyframes]
    assert np.allclose(after.annotations.rotation[1, at], quaternion_from_yaw(yaw)[at])
    assert (after.annotations.num_lidar_pts[1, at] > 0).all() and np.array_equal(after.annotations.valid[1], at)
    others = np.arange(len(before.agents)) != 1
    for field in ("position", "rotation", "size", "num_lidar_pts", "attribute"):
        assert np.array_equal(getattr(after.annotations, field)[others], getattr(before.annotations, field)[others])


def test_tracks_may_be_removed_and_added_and_the_ego_moved(tmp_path: Path) -> None:
    scene = wild_scene(12)

    def change(value: dict[str, Any]) -> None:
        tracks = value["tracks"]
        value["metadata"][ADVERSARIES] = ["new"]
        tracks["new"] = {**tracks[scene.agents.ids[1]], "metadata": {"type": "vehicle.car", "object_id": "new"}}
        del tracks[scene.agents.ids[0]]
        tracks["ego"]["state"]["position"][:, 1] += 3.0

    before, after = edited(tmp_path, change)
    assert after.agents.ids == (*before.agents.ids[1:], "new") and after.adversaries == ("new",)
    assert np.allclose(after.ego.position - before.ego.position, [0.0, 3.0, 0.0])
    assert np.allclose(np.cos(after.ego.yaw - before.ego.yaw), 1.0)
    assert after.annotations.num_lidar_pts[-1].max() == 1


def test_without_the_own_block_it_is_a_file_like_any_other(tmp_path: Path) -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(60.0, 194.75, 10.0)))
    scene = replace(scene, adversaries=scene.agents.ids[1:])
    value = build_scenario(ExchangedScene(scene, scene.name))
    del value["metadata"][OWN]
    read = read_scenarionet(write(tmp_path, value))
    frames = len(read.timestamps_us)
    assert read.agents.ids == scene.agents.ids and read.adversaries == scene.adversaries
    assert np.allclose(read.agents.position[..., :2], scene.agents.position[:, :frames, :2], atol=1e-4)
    assert np.allclose(read.ego.position, scene.ego.position[:frames], atol=1e-4)
    assert set(read.road_map.lanes) == set(scene.road_map.lanes)
    difference = read.road_map.drivable_area.symmetric_difference(scene.road_map.drivable_area)
    # Cut 200 m around the path of the ego.
    whole = scene.road_map.drivable_area
    assert difference.intersection(whole.buffer(-0.1)).area < 0.51 * whole.area
    assert read.road_map.is_drivable(read.ego.position[:, :2]).all()


def test_files_of_others_may_say_who_is_adversarial(tmp_path: Path) -> None:
    value = recording()
    value["metadata"][ADVERSARIES] = [1, "1"]
    assert read_scenarionet(write(tmp_path, value)).adversaries == ("1",)
    for wrong, message in (
        ("1", "must be a list"),
        (["9"], "names 9, which is not an object"),
        ([None], "must be a name"),
    ):
        value["metadata"][ADVERSARIES] = wrong
        with pytest.raises(InputError, match=message):
            read_scenarionet(write(tmp_path, value))


@pytest.mark.parametrize(
    ("where", "wrong", "message"),
    [
        (("metadata", OWN, "schema"), 2, "another version"),
        (("metadata", OWN), 5, "another version"),
        (("metadata", OWN, "keyframes"), np.array([0, 10**6]), "keyframes that are not steps"),
        (("metadata", OWN, "timestamps_us"), np.arange(3), "times that do not match"),
        (("metadata", OWN, "ego_rotation"), None, "damaged"),
        (("metadata", OWN, "cameras"), [{}], "damaged"),
        (("metadata", OWN, "report"), "[1]", "a report that is not an object"),
        (("metadata", OWN, "report"), "{" * 100, "damaged"),
        (("metadata", OWN, "name"), 1.5, "must be a name"),
        (("metadata", OWN, "map"), {}, "its map is not in"),
        (("metadata", OWN, "map", "canvas_m"), [np.nan, 1.0], "not metres"),
        (("metadata", OWN, "sweeps"), {"lidar": 1, "cameras": 2}, "damaged"),
        (("map_features", "lane-1", "polyline"), np.zeros((600_000, 2)), "more than any road network"),
        (("map_features", "lane-1", OWN), 5, "its map is not in"),
        (("map_features", "lane-1", "polyline"), "x", "its map is not in"),
    ],
)  # fmt: skip
def test_a_damaged_block_is_one_sentence(tmp_path: Path, where: tuple[str, ...], wrong: Any, message: str) -> None:
    def change(value: dict[str, Any]) -> None:
        for key in where[:-1]:
            value = value[key]
        value[where[-1]] = wrong

    with pytest.raises(InputError, match=message) as caught:
        edited(tmp_path, change)
    assert "sd_test.pkl" in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_a_folder_is_the_same_with_any_number_of_workers(tmp_path: Path) -> None:
    data = town_of_two()
    written = {}
    for workers in (1, 2):
        to = tmp_path / str(workers)
        files = export_scenarionet(data, data.scene_names(), to, workers=workers)
        assert [file.scene for file in files] == ["scene-9901", "scene-9902"]
        written[workers] = {path.name: path.read_bytes() for path in sorted(to.iterdir())}
    assert written[1] == written[2] and len(written[1]) == 4
    summary = pickle.loads(written[1]["dataset_summary.pkl"])  # noqa: S301 - made by this test
    assert list(summary) == [file.path.name for file in files]
    assert all(OWN not in metadata and metadata["sdc_id"] == "ego" for metadata in summary.values())


def test_a_folder_with_other_scenes_is_refused(tmp_path: Path) -> None:
    data = town_of_two()
    export_scenarionet(data, ["scene-9901"], tmp_path, workers=1)
    export_scenarionet(data, ["scene-9901"], tmp_path, workers=1)
    with pytest.raises(InputError, match=r"holds sd_.*scene-9901\.pkl, which is not part of this export"):
        export_scenarionet(data, ["scene-9902"], tmp_path, workers=1)
    with pytest.raises(InputError, match="no scene to export"):
        export_scenarionet(data, [], tmp_path / "none", workers=1)


def test_scenes_of_variant_roots_have_names_and_objects_of_their_own() -> None:
    data = town_of_two()
    scene = replace(
        data.scenes["scene-9901"], name="v0/scene-9901", adversaries=data.scenes["scene-9901"].agents.ids[:1]
    )
    twins = {f"v{number}/scene-9901": replace(scene, name=f"v{number}/scene-9901") for number in range(2)}
    data.scenes = dict(twins)
    first, second = (read_exchange_scene(data, name).scene for name in twins)
    assert (first.name, second.name) == ("scene-9901-v0", "scene-9901-v1")
    assert not set(first.agents.ids) & set(second.agents.ids)
    assert first.adversaries == first.agents.ids[:1]


def test_what_counts_frames_refuses_other_rates(tmp_path: Path) -> None:
    root = TinyRoot.of(tmp_path, [with_key_frames(scene_on_straight_road(), np.arange(91))], cameras=()).write()
    with pytest.raises(InputError, match=r"key frames of scene-9901 are 0\.0833 s apart .* only eval and rescore"):
        read_exchange_scene(NuScenesData.open(root), "scene-9901")


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


@pytest.mark.path
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
    assert not list((tmp_path / "back").rglob("scene.json"))


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
