"""The two files beside the tables: ``splits.json`` and ``challenger.json``."""

from collections import defaultdict
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

from benchmark.constants import VEHICLE_CATEGORIES
from benchmark.datasets.scene_names import PROVENANCE, find_name_fault
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables, Row
from benchmark.datasets.tables import find_splits_file
from benchmark.errors import InputError
from benchmark.machine.storage import read_json

SPLITS: Final = "splits.json"


def check_splits(folder: Path, root: Path, tables: CheckedTables, faults: FaultList) -> None:
    """Note splits that name scenes which are not there."""
    path = find_splits_file(folder, root)
    content = None if path is None else _read(path, faults)
    if content is None:
        return
    known = {row["name"] for row in tables.having("scene", "name")}
    for split, names in sorted(content.items()):
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            faults.add("splits that are no lists", SPLITS, "", f"split {split!r} must be a list of scene names")
            continue
        for name in names:
            if name not in known:
                faults.add("unknown scenes", SPLITS, "", f"split {split!r} names {name!r}, which is not in scene.json")
        if len(set(names)) != len(names):
            faults.add("scenes twice in a split", SPLITS, "", f"split {split!r} names a scene twice")


def check_provenance(folder: Path, tables: CheckedTables, faults: FaultList) -> None:
    """Note adversaries that are not there, not vehicles, or would be dropped by metrics."""
    content = _read(folder / PROVENANCE, faults)
    if content is None:
        return
    if not isinstance(content.get("split"), str):
        faults.add("no split", PROVENANCE, "", f"{PROVENANCE} does not name the split that it was built for")
    scenes = content.get("scenes")
    if not isinstance(scenes, dict):
        faults.add("no scenes", PROVENANCE, "", f"{PROVENANCE} has no object named scenes")
        return
    if wrong := find_name_fault(content):
        faults.add("wrong names", PROVENANCE, "", wrong)
    by_name = {row["name"]: row for row in tables.having("scene", "name")}
    annotations = _by_instance(tables)
    for name, entry in sorted(scenes.items()):
        scene = by_name.get(name)
        if scene is None:
            faults.add("unknown scenes", PROVENANCE, "", f"{name} is not in scene.json")
            continue
        adversaries = entry.get("adversaries", []) if isinstance(entry, dict) else None
        if isinstance(entry, dict) and not isinstance(entry.get("source_scene", ""), str):
            faults.add("no source scenes", PROVENANCE, "", f"the source_scene of {name} must be the name of a scene")
        if not isinstance(adversaries, list) or not all(
            isinstance(token, str) and token.isprintable() for token in adversaries
        ):
            faults.add(
                "scenes without adversaries list", PROVENANCE, "", f"the adversaries of {name} must be a list of tokens"
            )
            continue
        for token in adversaries:
            _check_adversary(tables, scene, token, annotations.get(token, []), faults)
    for name in sorted(set(by_name) - set(scenes)):
        faults.add("scenes left out", PROVENANCE, "", f"{name} is in scene.json but not in {PROVENANCE}")


def check_adversaries(tables: CheckedTables, scene: Row, adversaries: Collection[str], faults: FaultList) -> None:
    """Note adversaries of a scene that are not there, not vehicles, or would be dropped by metrics."""
    annotations = _by_instance(tables) if adversaries else {}
    for token in adversaries:
        _check_adversary(tables, scene, token, annotations.get(token, []), faults)


def _by_instance(tables: CheckedTables) -> Mapping[str, list[Row]]:
    annotations: defaultdict[str, list[Row]] = defaultdict(list)
    for row in tables.having("sample_annotation", "instance_token", "sample_token", "num_lidar_pts"):
        annotations[row["instance_token"]].append(row)
    return annotations


def _check_adversary(
    tables: CheckedTables, scene: Row, instance_token: str, annotations: list[Row], faults: FaultList
) -> None:
    name = scene["name"]
    instance = tables.get("instance", instance_token)
    if instance is None:
        sentence = f"adversary {instance_token} of {name} is not in instance.json"
        faults.add("unknown adversaries", PROVENANCE, instance_token, sentence)
        return
    category = tables.get("category", instance.get("category_token", ""), "name")
    if category is not None and category["name"] not in VEHICLE_CATEGORIES:
        sentence = f"the adversary of {name} is a {category['name']}, not a vehicle"
        faults.add("adversaries that are no vehicles", PROVENANCE, instance_token, sentence)
    for row in annotations:
        sample = tables.get("sample", row["sample_token"], "scene_token")
        if sample is not None and sample["scene_token"] != scene["token"]:
            sentence = f"the adversary of {name} is annotated in another scene"
            faults.add("adversaries of other scenes", PROVENANCE, instance_token, sentence)
            break
    for row in annotations:
        if row["num_lidar_pts"] < 1:
            sentence = f"this annotation of the adversary of {name} claims no lidar point; metrics drop it"
            faults.add("adversaries without points", "sample_annotation", row["token"], sentence)


def _read(path: Path, faults: FaultList) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        content = read_json(path)
    except InputError as error:
        faults.add("unreadable file", path.name, "", f"{path.name} cannot be read: {error}")
        return None
    if not isinstance(content, dict):
        faults.add("not an object", path.name, "", f"{path.name} must be a JSON object")
        return None
    return content
