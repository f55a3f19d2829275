"""The embedded town's first version in parts, and what it is in numbers that no processor rounds otherwise."""

import hashlib
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmark.datasets.roots import DataSet, open_data
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.scenes import write_scene_if_missing
from generation.sources.first_town import read_first_scene
from generation.splits.packaged import NamedSplit

FIRST_TOWN = "mini@1"
"""What tests give as ``--data`` that pin a scene of the first town, or one of the splits mini-adv-1 to mini-adv-3."""

FIRST_SPLITS = ("mini-adv-1", "mini-adv-2", "mini-adv-3")


def list_numbers(split: NamedSplit) -> list[int]:
    """Numbers of the recordings of the town that a split was made from."""
    return sorted({int(scene.source.removeprefix("scene-")) - 8000 for scene in split.frozen.scenes})


def write_first_town(root: Path, *numbers: int) -> DataSet:
    """Recordings of the first town by number, without images."""
    plan = DataSetPlan(root=root, version="v1.0-mini", split="val", renderer=None, source=None)
    scenes = [read_first_scene(number) for number in numbers]
    written = [write_scene_if_missing(plan, each, name=each.name, source_scene=each.name, report={}) for each in scenes]
    finish_data_set(plan, [scene.key for scene in written])
    return open_data(root, name=FIRST_TOWN)


def digest_exactly(scene: Scene) -> str:
    """SHA-256 of all that is in the packed file: no sine is in it."""
    agents, notes, road = scene.agents, scene.annotations, scene.road_map
    arrays = (
        scene.timestamps_us, scene.keyframes, scene.ego.position, agents.position, agents.yaw, agents.size,
        agents.valid, notes.position, notes.size, notes.valid, notes.visibility, notes.num_lidar_pts,
        notes.num_radar_pts,
        *(lane.centerline for lane in road.lanes.values()), *(divider.line for divider in road.dividers),
    )  # fmt: skip
    surfaces = (road.walkways, road.ped_crossings, road.road_segments, road.stop_lines, road.carparks)
    shapes = (road.drivable_area, *(shape for layer in surfaces for shape in layer.values()))
    words = repr((scene.token, scene.name, scene.description, scene.log, scene.date, scene.vehicle, road.location,
                  agents.ids, agents.categories, notes.attribute.tolist(), list(road.lanes)))  # fmt: skip
    return hashlib.sha256(
        b"".join([words.encode(), *(array.tobytes() for array in arrays), *(shape.wkb for shape in shapes)])
    ).hexdigest()


def digest_files(root: Path) -> dict[str, str]:
    """SHA-256 of the tables, maps and CAN bus of a data set by path: numbers to a nanometre, pictures as pixels."""
    paths = [path for path in sorted(root.rglob("*")) if path.suffix in (".json", ".png")]
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(_read_alike(path)).hexdigest()
        for path in paths
        if ".challenger" not in path.parts
    }


def _read_alike(path: Path) -> bytes:
    content = path.read_bytes()
    if path.suffix == ".png":
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED).tobytes()
    return json.dumps(_round(json.loads(content)), sort_keys=True).encode()


def _round(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, 9) + 0.0
    if isinstance(value, list):
        return [_round(each) for each in value]
    return {name: _round(each) for name, each in value.items()} if isinstance(value, dict) else value
