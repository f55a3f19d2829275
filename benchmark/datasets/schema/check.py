"""All checks of one data set, in the order in which a reader trips over the faults: tables, maps, truth, motion."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import MAP_LAYERS, NUSCENES_TABLES, OFFICIAL_LOCATIONS
from benchmark.datasets.annotated_objects import AnnotationCount, find_labelled_keyframes, has_size
from benchmark.datasets.categories import KNOWN, LIDAR_PLACE, SENSOR, CategoryNames, choose_names, rename_rows
from benchmark.datasets.devkit_import import FURTHER_TABLES, build_devkit
from benchmark.datasets.drawn_later import Artist
from benchmark.datasets.map_layers import find_expansion_file, read_road_map
from benchmark.datasets.scene_names import PROVENANCE
from benchmark.datasets.schema import Fault, FaultList
from benchmark.datasets.schema.files import check_files
from benchmark.datasets.schema.links import check_chains, check_links, check_sample_chains
from benchmark.datasets.schema.provenance import check_provenance, check_splits
from benchmark.datasets.schema.table_checks import CheckedTables, Row, read_checked
from benchmark.datasets.schema.values import (
    check_copied_intrinsics,
    check_gaps,
    check_images,
    check_rates,
    check_sensors,
    check_shared,
    check_tutorial,
)
from benchmark.datasets.tables import find_variant_folders, find_version_folders
from benchmark.datasets.truth_facts import (
    MISFIT_SHARE,
    MOTIONLESS_S,
    AnnotationSteps,
    are_boxes_across,
    are_rotations_xyzw,
    count_objects_across,
)
from benchmark.errors import InputError
from benchmark.geometry import Floats, yaw_of_quaternion
from benchmark.machine.extension import call_extension
from benchmark.machine.storage import read_cached_json, read_json
from benchmark.report.words import pluralise
from benchmark.road_map import RoadMap

_QUATERNIONS = "make sense only as x, y, z, w; nuScenes stores w, x, y, z: reorder them"


@dataclass(frozen=True, slots=True)
class EgoSamplePoses:
    """Poses of the ego at S samples of all scenes, scene by scene, in time order.

    ``scene`` holds the number of each sample's scene, ``logs`` its token of the log; ``position`` is (S, 3), global, in
    metres, ``rotation`` (S, 4), quaternions as they stand in the table.
    """

    scene: NDArray[np.int64]
    logs: tuple[str, ...]
    seconds: Floats
    position: Floats
    rotation: Floats

    @classmethod
    def of(cls, tables: CheckedTables) -> "EgoSamplePoses":
        """By any keyframe row of each sample."""
        pose_of: dict[str, Row] = {}
        for row in tables.having("sample_data", "sample_token", "ego_pose_token", "is_key_frame"):
            if row["is_key_frame"] and row["sample_token"] not in pose_of:
                pose = tables.get("ego_pose", row["ego_pose_token"], "translation", "rotation")
                if pose is not None:
                    pose_of[row["sample_token"]] = pose
        numbers = {row["token"]: number for number, row in enumerate(tables.having("scene", "log_token"))}
        logs = [row["log_token"] for row in tables.having("scene", "log_token")]
        samples = [
            (numbers[row["scene_token"]], row["timestamp"], pose_of[row["token"]])
            for row in tables.having("sample", "scene_token", "timestamp")
            if row["scene_token"] in numbers and row["token"] in pose_of
        ]
        samples.sort(key=lambda sample: sample[:2])
        return cls(
            scene=np.array([scene for scene, _, _ in samples], np.int64),
            logs=tuple(logs[scene] for scene, _, _ in samples),
            seconds=_seconds([time_us for _, time_us, _ in samples]),
            position=_columns([pose["translation"] for _, _, pose in samples], 3),
            rotation=_columns([pose["rotation"] for _, _, pose in samples], 4),
        )


def check_motion(tables: CheckedTables, ego: EgoSamplePoses, faults: FaultList) -> None:
    """Note boxes that jump, boxes that lie across their motion, and rotations in the order x, y, z, w."""
    driven = AnnotationSteps.of(ego.scene, ego.seconds, ego.position).directions(len(ego.scene))
    if are_rotations_xyzw(ego.rotation, driven):
        faults.add("rotations in another order", "ego_pose", "", f"the rotations {_QUATERNIONS}", severity="warning")
    rows, times_us = _annotations(tables)
    if not rows:
        return
    rotation = _columns([row["rotation"] for row in rows], 4)
    if are_rotations_xyzw(rotation):
        sentence = f"the rotations {_QUATERNIONS}"
        faults.add("rotations in another order", "sample_annotation", "", sentence, severity="warning")
    places: defaultdict[str, int] = defaultdict(lambda: len(places))
    owner = np.array([places[row["instance_token"]] for row in rows], np.int64)
    steps = AnnotationSteps.of(owner, _seconds(times_us), _columns([row["translation"] for row in rows], 3))
    for step in np.flatnonzero(steps.jumps).tolist():
        row = rows[int(steps.row[step]) + 1]
        name = row["instance_token"]
        sentence = f"since its previous annotation, instance {name} would have moved at {steps.speed[step]:.0f} m/s"
        faults.add("boxes that jump", "sample_annotation", row["token"], sentence, severity="warning")
    # A table has width before length.
    size = _columns([row["size"] for row in rows], 3)[:, [1, 0]]
    moving, across = count_objects_across(steps, yaw_of_quaternion(rotation), size)
    if are_boxes_across(moving, across):
        sentence = (
            f"the boxes of {across} of {pluralise(moving, 'moving object')} lie across their motion: width and length "
            "are exchanged, or headings turned by 90 degrees"
        )
        faults.add("boxes across their motion", "sample_annotation", "", sentence, severity="warning")


def _annotations(tables: CheckedTables) -> tuple[list[Row], list[int]]:
    """Annotations that can be relied on, those of an instance together in time order, and their times."""
    fields = ("instance_token", "sample_token", "translation", "size", "rotation")
    annotations: list[tuple[str, int, Row]] = []
    for row in tables.having("sample_annotation", *fields):
        sample = tables.get("sample", row["sample_token"], "timestamp")
        if sample is not None:
            annotations.append((row["instance_token"], sample["timestamp"], row))
    annotations.sort(key=lambda annotation: annotation[:2])
    return [row for _, _, row in annotations], [time_us for _, time_us, _ in annotations]


def _seconds(times_us: Sequence[int]) -> Floats:
    """Since the first of all, so that nothing is lost to the size of the numbers."""
    times = np.array(times_us, np.int64)
    return np.asarray((times - (times.min() if len(times) else 0)) * 1e-6)


def _columns(values: Sequence[Any], width: int) -> Floats:
    return np.array(values, np.float64).reshape(-1, width)


_LABELS: Final = "scenes without labels"


def check_truth(tables: CheckedTables, faults: FaultList) -> None:
    """Warn of scenes and objects of which commands that judge say nothing, or less."""
    if "sample_annotation" in tables.unreadable:
        return
    _check_labels(tables, faults)
    _check_boxes(tables, faults)
    _check_categories(tables, faults)
    _check_poses(tables, faults)


def _check_labels(tables: CheckedTables, faults: FaultList) -> None:
    """Scenes that are not labelled, or in a part only."""
    boxes = Counter(row["sample_token"] for row in tables.having("sample_annotation", "sample_token", "size"))
    samples: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for row in tables.having("sample", "scene_token", "timestamp"):
        samples[row["scene_token"]].append((row["timestamp"], row["token"]))
    for scene in tables.having("scene", "name"):
        counts = np.array([boxes[token] for _, token in sorted(samples[scene["token"]])], np.int64)
        missing = np.flatnonzero(~find_labelled_keyframes(counts))
        if not len(missing):
            continue
        if not counts.any():
            sentence = f"{scene['name']} has no annotations: contacts cannot be detected, and rates exclude it"
        else:
            sentence = (
                f"{scene['name']} has no annotations at {len(missing)} of {pluralise(len(counts), 'sample')}, the "
                f"first of them number {missing[0]}: contacts cannot be detected there"
            )
        faults.add(_LABELS, "scene", scene["token"], sentence, severity="warning")


def _check_boxes(tables: CheckedTables, faults: FaultList) -> None:
    """Boxes without a size, and instances without a box."""
    for row in tables.having("sample_annotation", "size"):
        if not has_size(row):
            sentence = f"its size is {row['size']}: the box is ignored"
            faults.add("boxes without a size", "sample_annotation", row["token"], sentence, severity="warning")
    tracked = {row["instance_token"] for row in tables.having("sample_annotation", "instance_token")}
    for row in tables.rows["instance"]:
        if row["token"] not in tracked:
            sentence = "the instance has no annotation and is ignored"
            faults.add("instances without a track", "instance", row["token"], sentence, severity="warning")


def _check_categories(tables: CheckedTables, faults: FaultList) -> None:
    """Categories that are not nuScenes', once for the whole data set."""
    names = {row["token"]: row["name"] for row in tables.having("category", "name")}
    category_of = {
        row["token"]: names.get(row["category_token"]) for row in tables.having("instance", "category_token")
    }
    counts_by_name = Counter(
        category_of.get(row["instance_token"]) for row in tables.having("sample_annotation", "instance_token")
    )
    unknown = {name: count for name, count in counts_by_name.items() if name is not None and name not in KNOWN}
    if unknown:
        counts = AnnotationCount(counts_by_name.total(), unknown)
        consequence = "cannot detect contacts" if counts.is_mostly_unknown else "ignore them"
        sentence = f"{counts.sentence}: protocols that depend on categories {consequence}; map them with --categories"
        faults.add("unknown categories", "category", "", sentence, severity="warning")


def _check_poses(tables: CheckedTables, faults: FaultList) -> None:
    """Scenes in which the ego pose never changes."""
    poses: defaultdict[str, set[tuple[float, ...]]] = defaultdict(set)
    times_us: defaultdict[str, list[int]] = defaultdict(list)
    for row in tables.having("sample_data", "sample_token", "ego_pose_token", "is_key_frame"):
        sample = tables.get("sample", row["sample_token"], "scene_token", "timestamp")
        pose = tables.get("ego_pose", row["ego_pose_token"], "translation", "rotation")
        if row["is_key_frame"] and sample is not None and pose is not None:
            poses[sample["scene_token"]].add((*pose["translation"], *pose["rotation"]))
            times_us[sample["scene_token"]].append(sample["timestamp"])
    for scene in tables.having("scene", "name"):
        times = times_us[scene["token"]]
        if len(poses[scene["token"]]) == 1 and (max(times) - min(times)) * 1e-6 >= MOTIONLESS_S:
            sentence = f"the ego pose of {scene['name']} is the same at every sample, as if it were missing"
            faults.add("ego poses that never move", "scene", scene["token"], sentence, severity="warning")


_EXPANSION_KEYS: Final = (*MAP_LAYERS, "canvas_edge", "connectivity", "arcline_path_3")
_ELSEWHERE: Final = ("../maps/expansion", "maps", "../maps", "expansion", "../expansion")
"""Folders in which expansions are found that were unpacked in the wrong one."""


def check_maps(
    root: Path, tables: CheckedTables, ego: EgoSamplePoses, faults: FaultList, names: CategoryNames = ()
) -> None:
    """Note map expansions that are missing, lie in another folder, are broken or of another place."""
    logs: defaultdict[str, set[str]] = defaultdict(set)
    for row in tables.having("log", "location"):
        logs[row["location"]].add(row["token"])
    for location in sorted(logs):
        path = find_expansion_file(root, location)
        if path is None:
            _note_missing(root, location, faults)
            continue
        road_map = _read_checked_map(path, location, faults, names)
        if road_map is not None and not road_map.drivable_area.is_empty:
            _check_fit(road_map, ego, logs[location], faults)


def _note_missing(root: Path, location: str, faults: FaultList) -> None:
    """Note a missing expansion, and where it lies if it lies near."""
    name = f"maps/expansion/{location}.json"
    folders = _ELSEWHERE if Path(location).name == location else ()
    near = next(
        (f"{folder}/{location}.json" for folder in folders if (root / folder / f"{location}.json").is_file()), None
    )
    consequence = "planners and generation that need the vector map cannot use the data set"
    if near is not None:
        consequence = f"it lies at {near}: move or link it, as without it {consequence}"
    elif location not in OFFICIAL_LOCATIONS:
        return
    faults.add("missing map expansions", name, "", f"{name} is missing; {consequence}", severity="warning")


def _read_checked_map(path: Path, location: str, faults: FaultList, names: CategoryNames) -> RoadMap | None:
    name = f"maps/expansion/{location}.json"
    try:
        road_map = read_road_map(path, names)
    except InputError as error:
        faults.add("broken map expansions", name, "", str(error))
        return None
    missing = [layer for layer in _EXPANSION_KEYS if layer not in read_json(path)]
    if missing and location in OFFICIAL_LOCATIONS:
        sentence = f"{name} lacks {', '.join(missing)}, which other readers of map expansions need"
        faults.add("incomplete map expansions", name, "", sentence, severity="warning")
    return road_map


def _check_fit(road_map: RoadMap, ego: EgoSamplePoses, logs: set[str], faults: FaultList) -> None:
    """Note logs whose ego drives beside the roads of their map."""
    off = ~road_map.is_drivable(ego.position[:, :2])
    for log in sorted(logs):
        in_log = np.array([ego_log == log for ego_log in ego.logs], np.bool_)
        share = float(off[in_log].mean()) if in_log.any() else 0.0
        if share > MISFIT_SHARE:
            sentence = (
                f"the recorded ego is off the drivable area of {road_map.location} in {100 * share:.0f} % of the "
                f"{np.count_nonzero(in_log)} samples of this log: the map or the location is wrong"
            )
            faults.add("maps that do not fit", "log", log, sentence, severity="warning")


def check_further_tables(folder: Path, root: Path, tables: CheckedTables, faults: FaultList) -> None:
    """Note that the devkit does not open a root with such tables; asked only where nothing else is wrong."""
    present = [table for table in FURTHER_TABLES if (folder / f"{table}.json").exists()]
    if not present or any(fault.severity == "error" for fault in faults.faults):
        return
    try:
        build_devkit(root, folder.name, tables.rows)
    except InputError as error:
        faults.add("tables that the devkit refuses", present[0], "", str(error))


def check_tables(root: Path, *, version: str | None = None, categories: Mapping[str, str] | None = None) -> list[Fault]:
    """Everything that is wrong with a nuScenes-format data set.

    Linear in the number of rows. Of each kind of fault in each table the first few are told and the rest counted.

    Args:
        root: Root of the data set; a folder that directly holds tables, or one root a variant (``v0``, ``v1``, ...:
            the tables of the faults then begin with the variant's name), will do too.
        version: Version folder, or ``None`` to take the only one.
        categories: What other names mean (`benchmark.datasets.categories.read_names`).

    Returns:
        The faults, errors first; empty if there are none.

    Raises:
        InputError: If there is no such folder, no tables in it, or several versions to choose from.
    """
    if not root.is_dir():
        raise InputError(f"there is no folder {root}; give the root of a nuScenes-format data set")
    variants = find_variant_folders(root)
    if variants and not find_version_folders(root):
        faults = [
            replace(fault, table=f"{variant}/{fault.table}")
            for variant in variants
            for fault in check_tables(root / variant, version=version, categories=categories)
        ]
        return sorted(faults, key=lambda fault: fault.severity)
    folder, data_root = _table_folder(root, version)
    return _check(folder, data_root, categories or {})


def _replace_names(
    folder: Path, tables: CheckedTables, categories: Mapping[str, str], faults: FaultList
) -> CategoryNames:
    """Replace other names by nuScenes' in the rows themselves; views that no camera has are noted."""
    shared = ("category", "sensor", "calibrated_sensor", "attribute", "visibility")
    sound = {table: [row for row in tables.rows[table] if id(row) not in tables.unsound] for table in shared}
    try:
        names = choose_names(folder, sound, categories)
    except InputError:
        # What tables lack is told of them first.
        if not any(fault.severity == "error" for fault in faults.faults):
            raise
        return ()
    for table, renamed in rename_rows(tables.rows, names).items() if names else ():
        for row, new in zip(tables.rows[table], renamed):
            row.update(new)
    if any(name.startswith(SENSOR) for name, _ in names):
        for sentence in call_extension("names", "missing views", names):
            faults.add("views without a camera", "sensor", "", sentence, severity="warning")
    return names


def _check(folder: Path, data_root: Path, categories: Mapping[str, str]) -> list[Fault]:
    faults = FaultList()
    tables = read_checked(folder, faults)
    names = _replace_names(folder, tables, categories, faults)
    check_links(tables, faults)
    check_sample_chains(tables, faults)
    check_rates(tables, faults)
    check_gaps(tables, faults)
    check_tutorial(tables, faults)
    check_chains(tables, faults)
    check_shared(tables, faults)
    check_images(tables, faults)
    if not any(name.startswith(SENSOR) for name, _ in names):
        # Another rig may have equal lenses.
        check_copied_intrinsics(tables, faults)
    check_sensors(tables, faults, lidar_is_placed=LIDAR_PLACE in dict(names))
    drawn_later = Artist.of(data_root, read_cached_json(folder / PROVENANCE)) is not None
    check_files(data_root, tables, faults, drawn_later=drawn_later)
    ego = EgoSamplePoses.of(tables)
    check_maps(data_root, tables, ego, faults, names)
    check_motion(tables, ego, faults)
    check_truth(tables, faults)
    check_splits(folder, data_root, tables, faults)
    check_provenance(folder, tables, faults)
    check_further_tables(folder, data_root, tables, faults)
    return faults.told()


def _table_folder(root: Path, version: str | None) -> tuple[Path, Path]:
    """Folder of the tables, and folder that file names are relative to."""
    if version is not None:
        if Path(version).name != version or not (root / version).is_dir():
            known = ", ".join(find_version_folders(root)) or "none"
            raise InputError(f"{root} has no version folder {version!r}; versions there: {known}")
        return root / version, root
    if any((root / f"{table}.json").is_file() for table in NUSCENES_TABLES):
        return root, root.parent
    versions = find_version_folders(root)
    if not versions:
        raise InputError(f"{root} holds no nuScenes tables (scene.json and 12 more); give the root of a data set")
    if len(versions) > 1:
        raise InputError(f"{root} has several versions ({', '.join(versions)}); name one with --tables")
    return root / versions[0], root
