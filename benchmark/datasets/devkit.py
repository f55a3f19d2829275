"""The devkit's object of one scene where tables can be taken apart, or of all: its rows take kilobytes per image."""

from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.cached_tables import read_tables_cached
from benchmark.datasets.categories import CategoryNames, choose_names, rename_rows
from benchmark.datasets.devkit_import import FURTHER_TABLES, build_devkit
from benchmark.datasets.scene_tables import (
    GROWING_TABLES,
    SceneTables,
    count_by_category,
    find_camera_mounts,
    read_rows,
)
from benchmark.datasets.schema import FaultList, StrictFaultList, check_table
from benchmark.datasets.schema.opening_checks import check_scene, check_shared_and_samples
from benchmark.datasets.schema.table_checks import CheckedTables
from benchmark.datasets.tables import Row, Tables
from benchmark.errors import InputError


class OpenTables(ABC):
    """Checked tables of a data set, with the names of categories that were replaced."""

    categories: CategoryNames

    @abstractmethod
    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene``, ``log`` or ``category``."""

    @abstractmethod
    def annotation_count(self, scene: Row) -> int:
        """Number of annotations of a scene."""

    @abstractmethod
    def annotations_by_category(self, scene: Row) -> Counter[str]:
        """Number of annotations of each category in a scene; takes a reading of its rows."""

    @abstractmethod
    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes, relative to the root."""

    @abstractmethod
    def of_scene(self, scene: Row, adversaries: Collection[str] = ()) -> Any:
        """``NuScenes`` of the devkit with the rows of some scenes; ``adversaries`` are instances made to be so."""


class PerSceneTables(OpenTables):
    """The devkit is given the rows of one scene at a time; only the last one is kept."""

    def __init__(self, root: Path, version: str, tables: SceneTables, categories: CategoryNames) -> None:
        self._root, self._version, self._tables = root, version, tables.renamed(categories) if categories else tables
        self.categories = categories
        self._kept: tuple[str, Any] = ("", None)

    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene``, ``log`` or ``category``."""
        return self._tables.shared[table]

    def annotation_count(self, scene: Row) -> int:
        """Number of annotations of a scene."""
        return self._tables.annotation_count(scene["token"])

    def annotations_by_category(self, scene: Row) -> Counter[str]:
        """Number of annotations of each category in a scene."""
        return self._tables.annotations_by_category(scene["token"])

    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes."""
        return self._tables.keyframe_images()

    def of_scene(self, scene: Row, adversaries: Collection[str] = ()) -> Any:
        """``NuScenes`` of the devkit with the rows of this scene alone."""
        token = scene["token"]
        if self._kept[0] != token:
            self._kept = ("", None)
            self._kept = (token, build_devkit(self._root, self._version, self._tables.of_scene(token, adversaries)))
        return self._kept[1]


class AllSceneTables(OpenTables):
    """The devkit holds all rows."""

    def __init__(self, nusc: Any, tables: Tables, folder: Path, categories: CategoryNames) -> None:
        self._nusc, self._folder = nusc, folder
        self._tables, self.categories = tables, categories
        self._shared = CheckedTables.of_sound_rows(
            {name: tables[name] for name in tables if name not in GROWING_TABLES}
        )
        self._unchecked = _group_rows_by_scene(tables)

    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene``, ``log`` or ``category``."""
        return self._tables[table]

    def annotation_count(self, scene: Row) -> int:
        """Number of annotations of a scene."""
        return self.annotations_by_category(scene).total()

    def annotations_by_category(self, scene: Row) -> Counter[str]:
        """Number of annotations of each category in a scene."""
        return self._by_category[scene["token"]]

    @cached_property
    def _by_category(self) -> dict[str, Counter[str]]:
        """The same by token of the scene."""
        shared = {"category": self._tables["category"]}
        rows_of = _group_rows_by_scene(self._tables)
        return {token: count_by_category({**shared, **rows}) for token, rows in rows_of.items()}

    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes."""
        cameras, rows = find_camera_mounts(self._tables), self._tables["sample_data"]
        return (row["filename"] for row in rows if row["is_key_frame"] and row["calibrated_sensor_token"] in cameras)

    def of_scene(self, scene: Row, adversaries: Collection[str] = ()) -> Any:
        """``NuScenes`` of the devkit with all rows."""
        if scene["token"] in self._unchecked:
            rows = self._unchecked[scene["token"]]
            check_scene(self._shared, rows, scene, adversaries, StrictFaultList(folder=self._folder))
            del self._unchecked[scene["token"]]
        return self._nusc


def open_tables(
    root: Path, version: str, rates: FaultList | None = None, categories: Mapping[str, str] | None = None
) -> OpenTables:
    """Check all 13 tables of a data set, and open them scene by scene where they can be taken apart.

    ``rates`` gets scenes with another rate of keyframes than nuScenes; ``categories`` is the map of
    `benchmark.datasets.categories.read_names`.
    """
    folder = root / version
    rates = StrictFaultList(folder=folder) if rates is None else rates
    if not any((folder / f"{table}.json").exists() for table in FURTHER_TABLES):
        tables = read_tables_cached(folder, rates)
        if tables is not None:
            _require_masks(root, tables.shared["map"])
            return PerSceneTables(root, version, tables, choose_names(folder, tables.shared, categories))
    rows = _read_all_tables(folder, rates)
    _require_masks(root, rows["map"])
    names = choose_names(folder, rows, categories)
    rows = rename_rows(rows, names)
    return AllSceneTables(build_devkit(root, version, rows), rows, folder, names)


def _read_all_tables(folder: Path, rates: FaultList) -> Tables:
    faults = StrictFaultList(folder=folder)
    rows = {table: check_table(table, read_rows(folder, table), faults)[0] for table in NUSCENES_TABLES}
    check_shared_and_samples(CheckedTables.of_sound_rows(rows), faults, rates)
    return rows


def _group_rows_by_scene(tables: Tables) -> dict[str, dict[str, list[Row]]]:
    rows_of_scene: dict[str, dict[str, list[Row]]] = {
        scene["token"]: {table: [] for table in GROWING_TABLES} for scene in tables["scene"]
    }
    scene_of = {row["token"]: row["scene_token"] for row in tables["sample"]}
    for row in tables["sample"]:
        rows_of_scene[row["scene_token"]]["sample"].append(row)
    for table, link, target in (
        ("sample_data", "ego_pose_token", "ego_pose"),
        ("sample_annotation", "instance_token", "instance"),
    ):
        scenes_naming: defaultdict[str, set[str]] = defaultdict(set)
        for row in tables[table]:
            scene = scene_of[row["sample_token"]]
            rows_of_scene[scene][table].append(row)
            scenes_naming[row[link]].add(scene)
        for row in tables[target]:
            for scene in scenes_naming[row["token"]]:
                rows_of_scene[scene][target].append(row)
    return rows_of_scene


def _require_masks(root: Path, maps: list[Row]) -> None:
    for row in maps:
        if not (root / row["filename"]).is_file():
            raise InputError(
                f"map mask {root / row['filename']} of map.json is missing; add it for the devkit (any small PNG works)"
            )
