"""Tables of a nuScenes-format root scene by scene, so that memory does not hold the rows of all scenes.

Five tables grow with the number of scenes. Their rows stay in their files: one pass checks them and notes where the
rows of each scene are. This works only for tables in which nothing leads from one scene into another.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.stored_rows import PassOverRows, StoredRows
from benchmark.datasets.tables import Row, Tables, check_rows, check_shared_tables
from benchmark.errors import InputError

Numbers = NDArray[np.int64]

GROWING_TABLES: Final = ("sample", "ego_pose", "sample_data", "instance", "sample_annotation")
_NO_ROW: Final = -1


@dataclass(frozen=True, slots=True)
class SceneTables:
    """Checked tables, most of whose rows are read when their scene is.

    Attributes:
        shared: Rows of the tables that do not grow with the scenes.
        keyframe_images: File names of all camera keyframes.
    """

    shared: Tables
    keyframe_images: tuple[str, ...]
    _stored: dict[str, StoredRows]
    _of_scene: dict[str, list[Numbers]]

    def of_scene(self, token: str) -> dict[str, list[Row]]:
        """Rows that belong to a scene, in the order of the files; the shared tables whole.

        Args:
            token: Of the scene.

        Returns:
            Rows by table name, the caller's own.

        Raises:
            InputError: If a file has changed or cannot be read.
        """
        number = next(index for index, row in enumerate(self.shared["scene"]) if row["token"] == token)
        copied = {table: [dict(row) for row in rows] for table, rows in self.shared.items()}
        return copied | {table: self._stored[table].read(self._of_scene[table][number]) for table in GROWING_TABLES}


def read_scene_tables(folder: Path) -> SceneTables | None:
    """Pass over the tables of a version folder.

    Args:
        folder: Version folder.

    Returns:
        The tables, or ``None`` if `tables.check_tables` would refuse them, if something leads from one scene into
        another, or if that cannot be told: then they must be read whole.

    Raises:
        InputError: If a file cannot be read.
    """
    try:
        return _Reading(folder).result()
    except (InputError, KeyError, TypeError, ValueError, RecursionError):
        # Whoever reads them whole finds what it was, and says so.
        return None


@dataclass(slots=True)
class _Column:
    """One field of a growing table: hashes of its texts, or numbers of the rows that these name."""

    parts: list[Numbers] = field(default_factory=list)

    def add(self, values: Sequence[str]) -> None:
        if not all(value.__class__ is str for value in values):
            raise ValueError("a token that is no text")
        self.parts.append(np.fromiter(map(hash, values), np.int64, len(values)))

    def whole(self) -> Numbers:
        return np.concatenate([np.zeros(0, np.int64), *self.parts])


class _Reading:
    """The pass over all tables of a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._stored: dict[str, StoredRows] = {}
        self._images: list[str] = []
        names = [table for table in NUSCENES_TABLES if table not in GROWING_TABLES]
        self._shared: dict[str, list[Row]] = {
            table: list(chain.from_iterable(PassOverRows(folder / f"{table}.json").batches())) for table in names
        }
        self._known = check_shared_tables(self._shared, folder)
        modality = {row["token"]: row["modality"] for row in self._shared["sensor"]}
        mounts = self._shared["calibrated_sensor"]
        self._cameras = {row["token"] for row in mounts if modality[row["sensor_token"]] == "camera"}

    def result(self) -> SceneTables:
        """Raises ValueError or InputError where the tables must be read whole."""
        scenes = {row["token"]: number for number, row in enumerate(self._shared["scene"])}
        sample = self._pass("sample", ("token", "next", "scene_token"))
        sample_rows = _RowsByToken(sample["token"])
        scene_rows = _RowsByToken(np.fromiter(map(hash, scenes), np.int64, len(scenes)))
        scene_of_sample = scene_rows.find(sample["scene_token"])
        _require_same_scene(scene_of_sample, sample_rows.find(sample["next"], or_none=True))
        first = np.array([hash(row["first_sample_token"]) for row in self._shared["scene"]], dtype=np.int64)
        if not np.array_equal(scene_of_sample[sample_rows.find(first)], np.arange(len(scenes))):
            raise ValueError("the first sample of a scene is another's")
        poses = _RowsByToken(self._pass("ego_pose", ("token",))["token"])
        data = self._pass("sample_data", ("token", "next", "sample_token", "ego_pose_token"), self._note_images)
        scene_of_data = scene_of_sample[sample_rows.find(data["sample_token"])]
        _require_same_scene(scene_of_data, _RowsByToken(data["token"]).find(data["next"], or_none=True))
        pose_of_data = poses.find(data["ego_pose_token"])
        del data, poses
        instances = _RowsByToken(self._pass("instance", ("token",))["token"])
        annotations = self._pass("sample_annotation", ("token", "sample_token", "instance_token"))
        _RowsByToken(annotations["token"])
        scene_of_annotation = scene_of_sample[sample_rows.find(annotations["sample_token"])]
        instance_of_annotation = instances.find(annotations["instance_token"])
        count = len(scenes)
        data_rows, annotation_rows = _grouped(scene_of_data, count), _grouped(scene_of_annotation, count)
        of_scene = {
            "sample": _grouped(scene_of_sample, count),
            "sample_data": data_rows,
            "ego_pose": [_small(np.unique(pose_of_data[rows])) for rows in data_rows],
            "sample_annotation": annotation_rows,
            "instance": [_small(np.unique(instance_of_annotation[rows])) for rows in annotation_rows],
        }
        return SceneTables(self._shared, tuple(self._images), self._stored, of_scene)

    def _pass(
        self, table: str, wanted: tuple[str, ...], look: Callable[[list[Row]], None] | None = None
    ) -> dict[str, Numbers]:
        """Check a table's rows one by one; hashes of the texts in some of its fields."""
        reading, columns = PassOverRows(self._folder / f"{table}.json"), {name: _Column() for name in wanted}
        for rows in reading.batches():
            check_rows(table, rows, self._known, self._folder)
            for name, column in columns.items():
                column.add([row[name] for row in rows])
            if look is not None:
                look(rows)
        self._stored[table] = reading.stored()
        return {name: column.whole() for name, column in columns.items()}

    def _note_images(self, rows: list[Row]) -> None:
        cameras = (row for row in rows if row["calibrated_sensor_token"] in self._cameras)
        names = [row["filename"] for row in cameras if row["is_key_frame"]]
        if not all(isinstance(name, str) for name in names):
            raise ValueError("a file name that is no text")
        self._images += names


class _RowsByToken:
    """Numbers of rows by hash of their token.

    Args:
        hashes: One for each row.

    Raises:
        ValueError: If two are equal: a token that is there twice, or a chance of one in millions of millions.
    """

    def __init__(self, hashes: Numbers) -> None:
        self._order = np.argsort(hashes, kind="stable")
        self._sorted = hashes[self._order]
        if (self._sorted[1:] == self._sorted[:-1]).any():
            raise ValueError("a token that is there twice")

    def find(self, hashes: Numbers, *, or_none: bool = False) -> Numbers:
        """Numbers of the rows that are named; where it may name none, -1 for the empty text.

        Raises:
            ValueError: If there is no such row.
        """
        if not len(self._sorted) and len(hashes):
            raise ValueError("a link that leads nowhere")
        at = np.searchsorted(self._sorted, hashes)
        at[at == len(self._sorted)] = 0
        empty = (hashes == hash("")) & or_none
        if not ((self._sorted[at] == hashes) | empty).all():
            raise ValueError("a link that leads nowhere")
        return np.where(empty, _NO_ROW, self._order[at])


def _require_same_scene(scene_of: Numbers, following: Numbers) -> None:
    linked = following != _NO_ROW
    if (scene_of[linked] != scene_of[following[linked]]).any():
        raise ValueError("a link from one scene to another")


def _grouped(scene_of: Numbers, count: int) -> list[Numbers]:
    """Row numbers of each scene, increasing."""
    order = np.argsort(scene_of, kind="stable")
    return [_small(rows) for rows in np.split(order, np.searchsorted(scene_of[order], np.arange(1, count)))]


def _small(rows: NDArray[Any]) -> Any:
    """The same numbers in half the memory."""
    return rows.astype(np.int32)
