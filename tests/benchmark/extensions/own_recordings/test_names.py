"""A root with other names, opened: scenes, records, splits made from it; files of names that are wrong."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import benchmark
from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.categories import read_categories, read_names
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.extensions.own_recordings.names import ATTRIBUTES, VISIBILITY_LEVELS
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from generation.nuscenes_writer import vocabulary
from tests.benchmark.cli.cli_runs import run_main
from tests.benchmark.extensions.own_recordings.made_root import VERSION, copy_root, make_root

TWO = {"front": "CAM_FRONT", "rear": "CAM_BACK"}
OWN_VIEWS = {"front": "CAM_FRONT", "front_left": "CAM_FRONT_LEFT", "front_right": "CAM_FRONT_RIGHT"}
OWN_VIEWS |= {"rear": "CAM_BACK", "rear_left": "CAM_BACK_LEFT", "rear_right": "CAM_BACK_RIGHT"}


class Forward:
    """Looks at one view, whose picture must be as it was recorded, and goes straight on."""

    name = "forward"

    def __init__(self) -> None:
        self.seen: set[str] = set()

    def reset(self, scene: SceneInfo) -> None:
        self.seen = set()

    def plan(self, observation: Observation) -> Plan:
        self.seen |= set(observation.views)
        assert observation.views["CAM_FRONT"].load().shape == (180, 320, 3)
        steps = 0.5 * np.arange(1, 7) * observation.ego.velocity[0]
        return Plan(np.column_stack([steps, np.zeros(6)]), PlanFrame.EGO)


def test_the_example_is_checked_and_opened_as_if_it_were_nuscenes() -> None:
    root = make_root()
    checked = run_main("data", "check", root)
    assert (checked.code, checked.out.strip()) == (0, f"0 errors, 0 warnings in {root}")
    data = open_data(root)
    scene = data.scene("scene-0001")
    assert [camera.name for camera in scene.cameras] == list(CAMERA_NAMES)
    tables = {name: json.loads((root / VERSION / f"{name}.json").read_text()) for name in ("calibrated_sensor",)}
    matrices = {row["token"]: row["camera_intrinsic"] for row in tables["calibrated_sensor"]}
    for own, view in OWN_VIEWS.items():
        (camera,) = (each for each in scene.cameras if each.name == view)
        assert camera.intrinsic.tolist() == matrices[own] and (camera.width, camera.height) == (320, 180)
    assert set(scene.agents.categories) == {"vehicle.car", "vehicle.truck"}
    assert set(scene.annotations.attribute.ravel().tolist()) == {"vehicle.moving"}
    assert set(scene.annotations.visibility.ravel().tolist()) == {4}
    assert len(scene.road_map.lanes) == 3 and data.has_lidar("scene-0001")
    assert scene.lidar.translation.tolist() == [1.0, 0.0, 1.7]
    # Another process opens the same.
    again = pickle.loads(pickle.dumps(data))  # noqa: S301
    assert again.categories == data.categories and again.fingerprint() == data.fingerprint()
    assert data.with_categories(data.categories) is data


def test_what_nothing_is_said_of_stays_as_it_is(tmp_path: Path) -> None:
    root = copy_root(tmp_path / "plain")
    (root / VERSION / "own_recordings.json").unlink()
    expansion = root / "maps" / "expansion" / "my-town.json"
    expansion.write_text(expansion.read_text().replace('"lanes"', '"lane"'))
    data = open_data(root)
    scene = data.scene("scene-0001")
    assert data.categories == () and {camera.name for camera in scene.cameras} == set(OWN_VIEWS)
    assert set(scene.agents.categories) == {"car", "truck"} and not data.has_lidar("scene-0001")
    checked = run_main("data", "check", root)
    assert checked.code == 0 and "has no LIDAR_TOP: its place is taken to be that on nuScenes' cars" in checked.out


def test_options_take_the_place_of_sections_of_the_file(tmp_path: Path) -> None:
    root, rig, labels = make_root(), tmp_path / "two.json", tmp_path / "labels.json"
    rig.write_text(json.dumps(TWO))
    labels.write_text(
        json.dumps({"categories": {"car": "vehicle.bus.rigid"}, "attributes": {"driving": "vehicle.parked"}})
    )
    beside, given = open_data(root), open_data(root, categories=read_names(str(labels), str(rig)))
    pairs, usual = dict(given.categories), dict(beside.categories)
    assert {name: to for name, to in pairs.items() if name.startswith("sensor:")} == {
        f"sensor:{own}": view for own, view in TWO.items()
    }
    assert pairs["car"] == "vehicle.bus.rigid" and "truck" not in pairs
    assert pairs["attribute:driving"] == "vehicle.parked"
    for name in ("layer:lanes", "visibility:seen", "lidar:"):
        assert pairs[name] == usual[name]
    assert given.fingerprint() != beside.fingerprint()
    reopened = beside.with_categories(given.categories)
    assert reopened.categories == given.categories and reopened.fingerprint() == given.fingerprint()


def test_identical_names_are_no_other_data_set(tmp_path: Path) -> None:
    root = copy_root(tmp_path / "named", {"cameras": OWN_VIEWS, "layers": {"lanes": "lane"}})
    data = open_data(root)
    sensors = root / VERSION / "sensor.json"
    sensors.write_text(
        json.dumps([{**row, "channel": OWN_VIEWS[row["token"]]} for row in json.loads(sensors.read_text())])
    )
    (root / VERSION / "own_recordings.json").write_text(json.dumps({"layers": {"lanes": "lane"}}))
    plain, named = open_data(root), open_data(root, categories=read_names(None, "nuscenes"))
    assert named.fingerprint() == plain.fingerprint() != data.fingerprint()
    assert ("sensor:CAM_FRONT", "CAM_FRONT") in named.categories


def test_a_rig_with_two_views_is_named_refused_and_marked(tmp_path: Path) -> None:
    root, rig = make_root(), tmp_path / "two.json"
    rig.write_text(json.dumps(TWO))
    missing = "CAM_FRONT_RIGHT, CAM_FRONT_LEFT, CAM_BACK_LEFT, CAM_BACK_RIGHT"
    checked = run_main("data", "check", root, "--cameras", rig)
    assert checked.code == 0 and f"warning: sensor: no camera is {missing}: planners that need" in checked.out
    where = ("--data", root, "--split", "val", "--limit", "1", "--cameras", rig, "--workers", "1", "--out", tmp_path)
    refused = run_main("eval", "--model", "uniad-mini", *where)
    driven = run_main("drive", "--model", "uniad-mini", "--no-baselines", "--sensor", "schematic", *where)
    for said in (refused, driven):
        # A slow machine shows how far a drive is.
        (sentence,) = (line for line in said.err.splitlines() if line.startswith("error: "))
        assert said.code == 2 and missing in sentence and "--cameras" in sentence
    assert not [*tmp_path.glob("runs/**/run.json"), *tmp_path.glob("drives/**/drive.json")]
    data = benchmark.open_data(root, cameras=rig)
    planner = Forward()
    record = benchmark.evaluate(data, "val", planner, tmp_path / "runs")
    assert (
        record.complete
        and {"CAM_FRONT", "CAM_BACK", "rear_left"} <= planner.seen
        and "CAM_BACK_LEFT" not in planner.seen
    )
    (caveat,) = (each.sentence for each in record.run.caveats if each.kind == "cameras")
    assert missing in caveat
    assert record.run.config["categories"] == dict(data.categories)
    rescored = run_main("rescore", "--data", root, "--out", tmp_path)
    assert rescored.code == 0, rescored.err
    kept = json.loads((record.directory / "run.json").read_text())["caveats"]
    assert [each["sentence"] for each in kept if each["kind"] == "cameras"] == [caveat]


def test_a_split_that_is_generated_has_nuscenes_names(tmp_path: Path) -> None:
    made = run_main(
        "generate", "--split", "val-r", "--renderer", "none", "--frames", "keyframes", "--data", make_root(),
        "--limit", "1", "--workers", "1", "--out", tmp_path,
    )  # fmt: skip
    assert made.code == 0, made.err
    (root,) = tmp_path.glob("data/*/val-r")
    assert "lane" in json.loads((root / "maps" / "expansion" / "my-town.json").read_text())
    data = open_data(root)
    (name,) = data.scene_names()
    scene, source = data.scene(name), open_data(make_root()).scene("scene-0001")
    assert data.categories == () and sorted(scene.road_map.lanes) == sorted(source.road_map.lanes)
    assert set(scene.annotations.visibility.ravel().tolist()) == {4}
    assert set(scene.annotations.attribute.ravel().tolist()) == {"vehicle.moving"}
    assert set(scene.agents.categories) == {"vehicle.car", "vehicle.truck"}
    assert run_main("data", "check", root).code == 0


def test_a_split_of_a_rig_with_two_views_and_four_other_cameras(tmp_path: Path) -> None:
    source = copy_root(tmp_path / "two", {"cameras": TWO, "layers": {"lanes": "lane"}, "categories": "short"})
    made = run_main(
        "generate", "--split", "val-r", "--size", "64x36", "--frames", "keyframes", "--data", source,
        "--limit", "1", "--workers", "1", "--out", tmp_path,
    )  # fmt: skip
    assert made.code == 0, made.err
    (root,) = tmp_path.glob("data/*/val-r")
    checked = run_main("data", "check", root)
    assert checked.code == 0 and "no camera is CAM_FRONT_RIGHT" in checked.out and "dead" not in checked.out
    data = benchmark.open_data(root)
    (name,) = data.scene_names()
    four = {"front_left", "front_right", "rear_left", "rear_right"}
    assert {camera.name for camera in data.scene(name).cameras} == {"CAM_FRONT", "CAM_BACK"} | four
    assert dict(data.categories) == {"sensor:CAM_FRONT": "CAM_FRONT", "sensor:CAM_BACK": "CAM_BACK"}


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("", "is not valid JSON"),
        ("{", "is not valid JSON"),
        ("[]", "is not a JSON object of names"),
        ("{}", "is not a JSON object of names"),
        ({"colours": {}}, "has the section 'colours'; sections are categories, attributes"),
        ({"layers": {"lanes": "lain"}}, "\"layers\" maps 'lanes' to 'lain'"),
        ({"layers": ["lanes"]}, '"layers" must be an object'),
        ({"attributes": {"driving": ["vehicle.moving"]}}, "\"attributes\" maps 'driving'"),
        ({"visibility": {"seen": "full"}}, "nuScenes has v0-40"),
        ({"categories": "long"}, "'long' is no built-in map"),
        ({"cameras": "nuplan"}, "the rig nuplan fits no camera"),
        ({"cameras": {"front": "CAM_FRONT", "rear": "CAM_FRONT"}}, "has two cameras for CAM_FRONT: front and rear"),
        ({"cameras": {"roof": "CAM_FRONT"}}, "names roof, which is no sensor here"),
    ],
)
def test_a_file_of_names_that_is_wrong_is_refused_in_one_sentence(tmp_path: Path, names: Any, said: str) -> None:
    root = copy_root(tmp_path / "wrong", names)
    run = run_main("data", "check", root)
    assert run.code == 2 and said in run.err and run.err.count("\n") == 1, run.err
    with pytest.raises(InputError):
        open_data(root)


def test_intrinsics_that_are_no_numbers_and_no_camera_at_all(tmp_path: Path) -> None:
    root = copy_root(tmp_path / "nan")
    path = root / VERSION / "calibrated_sensor.json"
    path.write_text(path.read_text().replace("250.0", "NaN", 1))
    checked = run_main("data", "check", root)
    assert checked.code == 1 and "camera_intrinsic" in checked.out
    run = run_main("eval", "--model", "stop", "--data", root, "--split", "val", "--out", tmp_path / "out")
    assert run.code == 2 and "camera_intrinsic" in run.err and run.err.count("\n") == 1
    without = copy_root(tmp_path / "none")
    for table in ("sensor", "calibrated_sensor", "sample_data"):
        (without / VERSION / f"{table}.json").write_text("[]")
    run = run_main("eval", "--model", "stop", "--data", without, "--split", "val", "--out", tmp_path / "out")
    assert run.code == 2 and run.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_names_of_nuscenes_are_those_that_are_written() -> None:
    assert set(vars(vocabulary)["_ATTRIBUTE_WORDS"]) == set(ATTRIBUTES)
    assert vars(vocabulary)["_VISIBILITY_LEVELS"] == VISIBILITY_LEVELS
    assert read_categories("short")["car"] == "vehicle.car"
