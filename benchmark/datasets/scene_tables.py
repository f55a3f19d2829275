"""Tables of a nuScenes-format root scene by scene, so that memory does not hold the rows of all scenes.

Rows of the five tables that grow with the scenes stay in their files: one pass checks them against the schema and notes
where those of each scene are; what they say together is checked when they are read.
"""

import gc
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.categories import CategoryNames, rename_rows
from benchmark.datasets.scene_names import read_names
from benchmark.datasets.schema import LINKS, FaultList, StrictFaultList, check_rows, check_table
from benchmark.datasets.schema.links import check_link, note_dead_link
from benchmark.datasets.schema.opening_checks import check_scene, check_shared_and_samples
from benchmark.datasets.schema.table_checks import CheckedTables
from benchmark.datasets.stored_rows import TableRowIndex, TableScan
from benchmark.datasets.tables import Row, Tables

Numbers = NDArray[np.int64]

GROWING_TABLES: Final = ("sample", "ego_pose", "sample_data", "instance", "sample_annotation")
_NO_ROW: Final = -1
_LOST: Final = -2


@dataclass(frozen=True, slots=True)
class SceneTables:
    """Checked tables, most of whose rows are read when their scene is.

    ``stored`` tells where rows of each growing table are, ``rows_of_scenes`` the row numbers of each scene, in the
    order of the table ``scene``.
    """

    keyframe_images: Callable[[], Sequence[str]]
    stored: Mapping[str, TableRowIndex]
    rows_of_scenes: Mapping[str, Sequence[Numbers]]
    _shared: CheckedTables
    _faults: StrictFaultList
    _sound: set[str] = field(default_factory=set)

    @property
    def shared(self) -> Tables:
        """Rows of the tables that do not grow with the scenes."""
        return self._shared.rows

    def of_scene(self, token: str, adversaries: Collection[str] = ()) -> dict[str, list[Row]]:
        """Rows of a scene, the caller's own, in the order of the files, and the shared tables whole."""
        number = next(index for index, row in enumerate(self.shared["scene"]) if row["token"] == token)
        rows = {table: self.stored[table].read(self.rows_of_scenes[table][number]) for table in GROWING_TABLES}
        if token not in self._sound:
            check_scene(self._shared, rows, self.shared["scene"][number], adversaries, self._faults)
            self._sound.add(token)
        return {table: [dict(row) for row in shared] for table, shared in self.shared.items()} | rows

    def annotation_count(self, token: str) -> int:
        """Number of annotations of a scene; none is read."""
        return len(self.numbers_of_scene("sample_annotation", token))

    def annotations_by_category(self, token: str) -> Counter[str]:
        """Number of annotations of each category in a scene."""
        numbers = {table: self.numbers_of_scene(table, token) for table in ("instance", "sample_annotation")}
        rows = {
            table: self.stored[table].read(np.array(row_numbers, np.int64)) for table, row_numbers in numbers.items()
        }
        return count_by_category({**self.shared, **rows})

    def renamed(self, names: CategoryNames) -> Self:
        """The same tables with other names."""
        return replace(self, _shared=CheckedTables.of_sound_rows(rename_rows(self.shared, names)))

    def numbers_of_scene(self, table: str, token: str) -> tuple[int, ...]:
        """Numbers, in the whole table, of the rows of a growing table that `of_scene` gives, in the same order."""
        number = next(index for index, row in enumerate(self.shared["scene"]) if row["token"] == token)
        return tuple(self.rows_of_scenes[table][number].tolist())


def count_by_category(tables: Tables) -> Counter[str]:
    """Number of annotations of each category, from the tables category, instance and sample_annotation."""
    names = {row["token"]: row["name"] for row in tables["category"]}
    categories = {row["token"]: names[row["category_token"]] for row in tables["instance"]}
    return Counter(categories[row["instance_token"]] for row in tables["sample_annotation"])


def read_scene_tables(folder: Path, rates: FaultList) -> SceneTables | None:
    """Pass over the tables of a version folder; ``rates`` gets scenes with another rate of keyframes than nuScenes.

    ``None`` if by a chance of one in millions of millions two tokens look alike: then tables must be read whole.
    """
    collecting = gc.isenabled()
    # Rows hold no reference cycles, so a garbage collection over millions of them is time lost.
    gc.disable()
    try:
        return _TablesPass(folder, rates).result()
    except _HashCollisionError:
        return None
    finally:
        if collecting:
            gc.enable()


class _HashCollisionError(Exception):
    """Two tokens have the same hash."""


@dataclass(slots=True)
class _GrowingColumn:
    """One field of a growing table: hashes of its texts, or numbers of the rows that these name."""

    parts: list[Numbers] = field(default_factory=list)

    def add(self, values: Sequence[str]) -> None:
        self.parts.append(np.fromiter(map(hash, values), np.int64, len(values)))

    def whole(self) -> Numbers:
        return np.concatenate([np.zeros(0, np.int64), *self.parts])


class _TablesPass:
    def __init__(self, folder: Path, rates: FaultList) -> None:
        self._folder = folder
        self._faults = StrictFaultList(folder=folder)
        self._rates = rates
        self._stored: dict[str, TableRowIndex] = {}
        self._images: list[str] = []
        self._shared = read_shared(folder, self._faults)
        self._cameras = find_camera_mounts(self._shared.rows)

    def result(self) -> SceneTables:
        """Raises InputError for the first fault."""
        samples: list[Row] = []
        sample_rows = self._by_token("sample", self._pass("sample", ("token",), samples.extend)["token"])
        check_shared_and_samples(
            CheckedTables.of_sound_rows({**self._shared.rows, "sample": samples}), self._faults, self._rates
        )
        scenes = {row["token"]: number for number, row in enumerate(self._shared.rows["scene"])}
        scene_of_sample = np.array([scenes[row["scene_token"]] for row in samples], dtype=np.int64)
        del samples
        poses = self._by_token("ego_pose", self._pass("ego_pose", ("token",))["token"])
        data = self._pass("sample_data", ("token", "next", "sample_token", "ego_pose_token"), self._note_images)
        scene_of_data = scene_of_sample[self._follow("sample_data", "sample_token", data, sample_rows)]
        following = self._follow("sample_data", "next", data, self._by_token("sample_data", data["token"]))
        self._require_same_scene(scene_of_data, following)
        pose_of_data = self._follow("sample_data", "ego_pose_token", data, poses)
        del data, poses, following
        instances = self._by_token("instance", self._pass("instance", ("token",))["token"])
        annotations = self._pass("sample_annotation", ("token", "sample_token", "instance_token"))
        self._by_token("sample_annotation", annotations["token"])
        at_sample = self._follow("sample_annotation", "sample_token", annotations, sample_rows)
        scene_of_annotation = scene_of_sample[at_sample]
        instance_of_annotation = self._follow("sample_annotation", "instance_token", annotations, instances)
        count = len(scenes)
        data_rows, annotation_rows = _grouped(scene_of_data, count), _grouped(scene_of_annotation, count)
        of_scene = {
            "sample": _grouped(scene_of_sample, count),
            "sample_data": data_rows,
            "ego_pose": [_to_int32(np.unique(pose_of_data[rows])) for rows in data_rows],
            "sample_annotation": annotation_rows,
            "instance": [_to_int32(np.unique(instance_of_annotation[rows])) for rows in annotation_rows],
        }
        images = tuple(self._images)
        return SceneTables(lambda: images, self._stored, of_scene, self._shared, self._faults)

    def _pass(
        self, table: str, wanted: tuple[str, ...], look: Callable[[list[Row]], None] | None = None
    ) -> dict[str, Numbers]:
        """Check a table's rows, and their links to shared tables; hashes of the texts in some of their fields."""
        reading, columns = TableScan(self._folder / f"{table}.json"), {name: _GrowingColumn() for name in wanted}
        known = {name: rows.keys() for name, rows in self._shared.by_token.items()}
        links = [link for link in LINKS if link.table == table and link.target in known]
        count = 0
        for rows in reading.batches():
            check_rows(table, rows, self._faults, first=count)
            count += len(rows)
            for link in links:
                check_link(link, rows, known[link.target], self._faults)
            for name, column in columns.items():
                column.add(list(map(itemgetter(name), rows)))
            if look is not None:
                look(rows)
        self._stored[table] = reading.stored()
        return {name: column.whole() for name, column in columns.items()}

    def _note_images(self, rows: list[Row]) -> None:
        cameras = (row for row in rows if row["calibrated_sensor_token"] in self._cameras)
        self._images += [row["filename"] for row in cameras if row["is_key_frame"]]

    def _row(self, table: str, number: int) -> Row:
        return self._stored[table].read(np.array([number]))[0]

    def _by_token(self, table: str, hashes: Numbers) -> "_RowsByToken":
        """Rows of a table by token; refuses a token that is there twice."""
        rows = _RowsByToken(hashes)
        if rows.alike:
            first, second = (self._row(table, number)["token"] for number in rows.alike)
            if first != second:
                raise _HashCollisionError
            self._faults.add("tokens used twice", table, first, "two rows have this token")
        return rows

    def _follow(self, table: str, name: str, columns: dict[str, Numbers], targets: "_RowsByToken") -> Numbers:
        """Numbers of the rows that a field names; refuses one that leads nowhere."""
        link = next(link for link in LINKS if (link.table, link.field) == (table, name))
        row_numbers = targets.find(columns[name], or_none=link.may_be_empty)
        lost = np.flatnonzero(row_numbers == _LOST)
        if len(lost):
            row = self._row(table, int(lost[0]))
            note_dead_link(link, row["token"], row[name], self._faults)
        return row_numbers

    def _require_same_scene(self, scene_of: Numbers, following: Numbers) -> None:
        linked = np.flatnonzero(following != _NO_ROW)
        strayed = linked[scene_of[linked] != scene_of[following[linked]]]
        if len(strayed):
            row = self._row("sample_data", int(strayed[0]))
            sentence = f"next {row['next']} is a row of another scene"
            self._faults.add("chains that leave their owner", "sample_data", row["token"], sentence)


class _RowsByToken:
    """Numbers of rows by hash of their token, one hash for each row; ``alike`` are two rows with the same hash."""

    def __init__(self, hashes: Numbers) -> None:
        self._order = np.argsort(hashes, kind="stable")
        self._sorted = hashes[self._order]
        equal_at = np.flatnonzero(self._sorted[1:] == self._sorted[:-1])[:1]
        self.alike = tuple(int(number) for at in equal_at for number in self._order[at : at + 2])

    def find(self, hashes: Numbers, *, or_none: bool = False) -> Numbers:
        """Numbers of the rows that are named; where it may name none, -1 for the empty text; -2 for no row."""
        if not len(self._sorted):
            row_numbers = np.full(len(hashes), _LOST)
        else:
            at = np.searchsorted(self._sorted, hashes)
            at[at == len(self._sorted)] = 0
            row_numbers = np.where(self._sorted[at] == hashes, self._order[at], _LOST)
        if or_none:
            row_numbers[hashes == hash("")] = _NO_ROW
        return row_numbers


def read_shared(folder: Path, faults: FaultList) -> CheckedTables:
    """The tables that do not grow with the scenes."""
    names = [table for table in NUSCENES_TABLES if table not in GROWING_TABLES]
    return CheckedTables.of_sound_rows(
        {table: check_table(table, read_rows(folder, table), faults)[0] for table in names}
    )


def read_rows(folder: Path, table: str) -> list[Row]:
    """All rows of a table; scenes have the names by which they are known (`benchmark.datasets.scene_names`)."""
    rows = list(chain.from_iterable(TableScan(folder / f"{table}.json").batches()))
    names = read_names(folder) if table == "scene" else {}
    return [{**row, "name": names.get(str(row.get("name")), row.get("name"))} for row in rows] if names else rows


def find_camera_mounts(tables: Tables) -> frozenset[str]:
    """Tokens of the calibrated cameras, from the tables sensor and calibrated_sensor."""
    modality = {row["token"]: row["modality"] for row in tables["sensor"]}
    mounts = tables["calibrated_sensor"]
    return frozenset(row["token"] for row in mounts if modality.get(row["sensor_token"]) == "camera")


def _grouped(scene_of: Numbers, count: int) -> list[Numbers]:
    """Row numbers of each scene, increasing."""
    order = np.argsort(scene_of, kind="stable")
    return [_to_int32(rows) for rows in np.split(order, np.searchsorted(scene_of[order], np.arange(1, count)))]


def _to_int32(rows: NDArray[Any]) -> Any:
    """The same numbers in half the memory."""
    return rows.astype(np.int32)
