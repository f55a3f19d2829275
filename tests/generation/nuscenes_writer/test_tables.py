"""Rows that the writer makes of a scene."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.constants import CAMERA_NAMES, CATEGORIES, NUMBERED_CATEGORIES, NUSCENES_TABLES
from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, SourceInfo, finish_data_set, write_scene
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary, write_root

Tables = dict[str, list[dict[str, Any]]]


def read(root: Path, version: str = "v1.0-trainval") -> Tables:
    return {table: json.loads((root / version / f"{table}.json").read_text()) for table in NUSCENES_TABLES}


def channel_rows(tables: Tables, channel: str) -> list[dict[str, Any]]:
    return [row for row in tables["sample_data"] if f"/{channel}/" in row["filename"]]


def without(scene: Scene, agent: int, keyframes: list[int]) -> Scene:
    valid = scene.annotations.valid.copy()
    valid[agent, keyframes] = False
    return replace(scene, annotations=replace(scene.annotations, valid=valid))


def test_counts_and_links_of_two_scenes(tmp_path: Path) -> None:
    scenes = [short_scene("scene-9901"), short_scene("scene-9902")]
    write_root(tmp_path, scenes)
    tables = read(tmp_path)
    assert {table: len(rows) for table, rows in tables.items()} == {
        "attribute": 8, "calibrated_sensor": 2 * 7, "category": 32, "ego_pose": 2 * 7 * 30, "instance": 2 * 3,
        "log": 2, "map": 1, "sample": 2 * 5, "sample_annotation": 2 * 3 * 5, "sample_data": 2 * 7 * 30, "scene": 2,
        "sensor": 7, "visibility": 4,
    }  # fmt: skip
    assert check_tables(tmp_path) == []
    # Every camera has intrinsics of its own, at the rendered size.
    channels = {row["token"]: row["channel"] for row in tables["sensor"]}
    found = {channels[row["sensor_token"]]: row["camera_intrinsic"] for row in tables["calibrated_sensor"]}
    assert found.pop("LIDAR_TOP") == []
    assert found == {camera.name: camera.resized(32, 18).intrinsic.tolist() for camera in scenes[0].cameras}


def test_keyframes_and_sweeps(tmp_path: Path) -> None:
    scene = short_scene(seconds=2.6)
    write_root(tmp_path, [scene])
    tables = read(tmp_path)
    samples = [row["token"] for row in tables["sample"]]
    for channel in (*CAMERA_NAMES, "LIDAR_TOP"):
        rows = channel_rows(tables, channel)
        assert [row["timestamp"] for row in rows] == scene.timestamps_us.tolist()
        assert [row["is_key_frame"] for row in rows] == [frame % 6 == 0 for frame in range(31)]
        assert [row["sample_token"] for row in rows] == [samples[frame // 6] for frame in range(31)]
        assert all(row["filename"].startswith("samples/") == row["is_key_frame"] for row in rows)
        assert all(row["ego_pose_token"] == row["token"] for row in rows)
    poses = {row["token"]: row for row in tables["ego_pose"]}
    row = channel_rows(tables, "CAM_BACK")[7]
    assert poses[row["token"]]["translation"] == scene.ego.position[7].tolist()
    assert (row["width"], row["height"]) == (32, 18)


def test_annotations_are_the_sources(tmp_path: Path) -> None:
    scene = short_scene()
    tilted = scene.annotations.rotation.copy()
    tilted[0, 0] = [0.6, 0.0, 0.0, 0.8]
    scene = replace(
        scene,
        annotations=replace(
            scene.annotations,
            rotation=tilted,
            num_lidar_pts=np.zeros((3, 5), np.int64),
            num_radar_pts=np.arange(15).reshape(3, 5),
            visibility=np.full((3, 5), 2),
            attribute=np.full((3, 5), "vehicle.parked"),
        ),
    )
    write_root(tmp_path, [scene])
    tables = read(tmp_path)
    attribute = {row["token"]: row["name"] for row in tables["attribute"]}
    rows = tables["sample_annotation"]
    assert [row["translation"] for row in rows] == scene.annotations.position.reshape(-1, 3).tolist()
    assert rows[0]["rotation"] == [0.6, 0.0, 0.0, 0.8]
    assert rows[0]["size"] == [1.9, 4.6, 1.7]
    assert [row["num_radar_pts"] for row in rows] == list(range(15))
    assert {row["num_lidar_pts"] for row in rows} == {0}
    assert {row["visibility_token"] for row in rows} == {"2"}
    assert {attribute[token] for row in rows for token in row["attribute_tokens"]} == {"vehicle.parked"}


def test_metrics_never_drop_the_adversary(tmp_path: Path) -> None:
    scene = short_scene()
    blind = replace(scene.annotations, num_lidar_pts=np.zeros((3, 5), np.int64), visibility=np.full((3, 5), 1))
    scene = with_adversary(replace(scene, annotations=blind), agent=1)
    write_root(tmp_path, [scene])
    tables = read(tmp_path)
    points: dict[str, list[int]] = {row["token"]: [] for row in tables["instance"]}
    for row in tables["sample_annotation"]:
        points[row["instance_token"]].append(row["num_lidar_pts"])
    assert list(points.values()) == [[0] * 5, [1] * 5, [0] * 5]
    provenance = json.loads((tmp_path / "v1.0-trainval/challenger.json").read_text())
    assert provenance["scenes"]["scene-9901"]["adversaries"] == [list(points)[1]]


def test_unknown_visibility_counts_as_seen(tmp_path: Path) -> None:
    scene = short_scene()
    unknown = replace(
        scene.annotations, num_lidar_pts=np.zeros((3, 5), np.int64), visibility=np.zeros((3, 5), np.int64)
    )
    write_root(tmp_path, [replace(scene, annotations=unknown)])
    rows = read(tmp_path)["sample_annotation"]
    assert {(row["visibility_token"], row["num_lidar_pts"]) for row in rows} == {("4", 1)}


@pytest.mark.parametrize(("keyframes", "counts"), [([1, 2], [5, 3, 5]), ([0, 1, 2, 3, 4], [5, 5])])
def test_an_object_with_a_gap_is_one_instance_and_none_where_it_is_on_no_keyframe(
    tmp_path: Path, keyframes: list[int], counts: list[int]
) -> None:
    write_root(tmp_path, [without(short_scene(), agent=1, keyframes=keyframes)])
    assert [row["nbr_annotations"] for row in read(tmp_path)["instance"]] == counts
    assert check_tables(tmp_path) == []


def test_keyframes_only_and_no_cameras_without_a_renderer(tmp_path: Path) -> None:
    write_root(tmp_path / "keyframes", [short_scene()], frames="keyframes")
    assert len(read(tmp_path / "keyframes")["sample_data"]) == 7 * 5
    assert not (tmp_path / "keyframes" / "sweeps").exists()
    assert check_tables(tmp_path / "keyframes") == []
    write_root(tmp_path, [short_scene()], renderer=None)
    tables = read(tmp_path)
    assert (len(tables["sample_data"]), len(tables["calibrated_sensor"])) == (30, 1)
    assert json.loads((tmp_path / "v1.0-trainval/challenger.json").read_text())["renderer"] is None
    assert check_tables(tmp_path) == []


def write_variants(plan: DataSetPlan, names: list[str]) -> list[str]:
    scenes = [with_adversary(short_scene(), agent) for agent in range(len(names))]
    return [
        write_scene(plan, scene, name=name, variant=variant, source_scene="scene-9901", report={"rank": variant})
        for variant, (name, scene) in enumerate(zip(names, scenes))
    ]


def test_suffixed_variants_share_a_root_without_sharing_anything_else(tmp_path: Path) -> None:
    plan = DataSetPlan(root=tmp_path, split="adv", renderer=SolidRenderer())
    names = ["scene-9901-a", "scene-9901-b"]
    finish_data_set(plan, write_variants(plan, names))
    tables = read(tmp_path)
    assert [row["name"] for row in tables["scene"]] == names
    assert len({row["token"] for row in tables["instance"]}) == 6
    files = [row["filename"] for row in tables["sample_data"]]
    assert len(set(files)) == len(files)
    assert all(name.removesuffix(".jpg").removesuffix(".pcd.bin")[-2:] in ("-a", "-b") for name in files)
    assert json.loads((tmp_path / "v1.0-trainval/splits.json").read_text()) == {"adv": names}
    assert all("devkit" in fault.sentence for fault in check_tables(tmp_path))


def test_per_variant_roots_are_complete_and_keep_the_names(tmp_path: Path) -> None:
    plan = DataSetPlan(root=tmp_path, split="adv", layout="per-variant", renderer=SolidRenderer())
    finish_data_set(plan, write_variants(plan, ["scene-9901", "scene-9901"]))
    adversaries = []
    for variant in range(2):
        root = tmp_path / f"v{variant}"
        assert [row["name"] for row in read(root)["scene"]] == ["scene-9901"]
        assert {row["token"] for row in read(root)["instance"]} == set(short_scene().agents.ids)
        entry = json.loads((root / "v1.0-trainval/challenger.json").read_text())["scenes"]["scene-9901"]
        assert entry["report"] == {"rank": variant}
        adversaries += entry["adversaries"]
    assert adversaries == list(short_scene().agents.ids[:2])
    assert check_tables(tmp_path) == []


def test_labels_and_files_of_the_source_are_kept(tmp_path: Path) -> None:
    source_root, root = tmp_path / "source", tmp_path / "derived"
    write_root(source_root, [short_scene()], version="v1.0-mini")
    for table in ("category", "attribute", "log", "visibility"):
        path = source_root / f"v1.0-mini/{table}.json"
        rows = json.loads(path.read_text())
        if table == "log":
            rows[0]["token"] = "source-log"
            maps = json.loads((path.parent / "map.json").read_text())
            maps[0]["log_tokens"] = ["source-log", "log-of-another-version"]
            (path.parent / "map.json").write_text(json.dumps(maps))
        elif table != "visibility":
            rows = [{**row, "token": f"source-{row['name']}"} for row in rows]
        path.write_text(json.dumps(rows))
    (source_root / "can_bus/scene-9901_pose.json").write_text('[{"utime":1}]')
    (source_root / "maps/expansion/boston-seaport.json").write_text('{"from":"source"}')
    source = SourceInfo("mini", "f" * 64, source_root)
    plan = DataSetPlan(root=root, split="adv", renderer=SolidRenderer(), source=source)
    scene = with_adversary(short_scene())
    key = write_scene(plan, scene, name="scene-9901-x", source_scene="scene-9901", report={})
    finish_data_set(plan, [key])
    tables = read(root)
    assert {row["category_token"] for row in tables["instance"]} == {"source-vehicle.car"}
    assert tables["scene"][0]["log_token"] == "source-log"
    assert tables["sample_annotation"][0]["attribute_tokens"] == ["source-vehicle.moving"]
    assert tables["map"] == json.loads((source_root / "v1.0-mini/map.json").read_text())
    assert (root / "can_bus/scene-9901-x_pose.json").read_text() == '[{"utime":1}]'
    assert (root / "maps/expansion/boston-seaport.json").read_text() == '{"from":"source"}'
    provenance = json.loads((root / "v1.0-trainval/challenger.json").read_text())
    assert provenance["source"] == {"fingerprint": "f" * 64, "name": "mini"}


def test_extra_splits_take_their_scenes_out_of_the_first(tmp_path: Path) -> None:
    plan = DataSetPlan(root=tmp_path, split="val", renderer=None)
    scenes = [short_scene(f"scene-990{number}") for number in range(3)]
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys, extra_splits={"train": ["scene-9902"]})
    splits = json.loads((tmp_path / "v1.0-trainval/splits.json").read_text())
    assert splits == {"train": ["scene-9902"], "val": ["scene-9900", "scene-9901"]}
    with pytest.raises(InputError, match="scene-1234"):
        finish_data_set(plan, keys, extra_splits={"train": ["scene-1234"]})


def test_foreign_labels_get_rows(tmp_path: Path) -> None:
    scene = short_scene()
    agents = replace(scene.agents, categories=("other.thing", "vehicle.car", "vehicle.car"))
    write_root(tmp_path, [replace(scene, agents=agents)], renderer=None)
    tables = read(tmp_path)
    assert [row["name"] for row in tables["category"]][-1] == "other.thing"
    (fault,) = check_tables(tmp_path)
    assert fault.severity == "warning" and "unknown categories ('other.thing')" in fault.sentence


def test_categories_have_the_numbers_of_the_table_of_32(tmp_path: Path) -> None:
    write_root(tmp_path / "made", [short_scene()])
    made = [row["name"] for row in read(tmp_path / "made")["category"]]
    assert made == list(NUMBERED_CATEGORIES) and made.index("human.pedestrian.adult") == 2
    assert (made.index("vehicle.bicycle"), made.index("vehicle.truck")) == (14, 23)
    # What derives from a root with the older table keeps its tokens and gets the same numbers.
    folder = tmp_path / "made" / "v1.0-trainval"
    kept = [{"token": f"old-{name}", "name": name, "description": ""} for name in CATEGORIES]
    own = {"token": "own", "name": "vehicle.hovercraft", "description": ""}
    (folder / "category.json").write_text(json.dumps([own, *kept]))
    source = SourceInfo("made", "0", root=tmp_path / "made")
    write_root(tmp_path / "derived", [short_scene()], source=source)
    rows = read(tmp_path / "derived")["category"]
    assert [row["name"] for row in rows] == [*NUMBERED_CATEGORIES, "vehicle.hovercraft"]
    assert rows[17]["token"] == "old-vehicle.car" and rows[32] == own
    used = {row["category_token"] for row in read(tmp_path / "derived")["instance"]}
    assert used == {"old-vehicle.car"} and check_tables(tmp_path / "derived") == []
