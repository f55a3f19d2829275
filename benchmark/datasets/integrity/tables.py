"""Reading the tables as they are: which rows and fields can be relied on by the checks that follow."""

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.integrity.faults import FaultList

Row = dict[str, Any]


_TOO_LATE_US: Final = 1e17
"""A thousand years ahead: a time beyond it is in nanoseconds."""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_vector(length: int) -> Callable[[Any], bool]:
    def test(value: Any) -> bool:
        return isinstance(value, list) and len(value) == length and all(map(_is_number, value))

    return test


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_strings(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)


def _is_rows_of_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(row, list) and all(map(_is_number, row)) for row in value)


@dataclass(frozen=True, slots=True)
class _Kind:
    words: str
    holds: Callable[[Any], bool]


_TEXT: Final = _Kind("text", lambda value: isinstance(value, str))
_TOKEN: Final = _Kind("a token", lambda value: isinstance(value, str))
_TOKENS: Final = _Kind("a list of tokens", _is_strings)
_COUNT: Final = _Kind("a whole number", _is_count)
_TIME: Final = _Kind("microseconds since 1970", lambda value: _is_number(value) and abs(value) < _TOO_LATE_US)
_FLAG: Final = _Kind("true or false", lambda value: isinstance(value, bool))
_VECTOR: Final = _Kind("three numbers", _is_vector(3))
_QUATERNION: Final = _Kind("four numbers (w, x, y, z)", _is_vector(4))
_MATRIX: Final = _Kind("a list of rows of numbers", _is_rows_of_numbers)

FIELDS: Final[dict[str, dict[str, _Kind]]] = {
    "attribute": {"name": _TEXT},
    "calibrated_sensor": {
        "sensor_token": _TOKEN,
        "translation": _VECTOR,
        "rotation": _QUATERNION,
        "camera_intrinsic": _MATRIX,
    },
    "category": {"name": _TEXT},
    "ego_pose": {"translation": _VECTOR, "rotation": _QUATERNION, "timestamp": _TIME},
    "instance": {
        "category_token": _TOKEN,
        "nbr_annotations": _COUNT,
        "first_annotation_token": _TOKEN,
        "last_annotation_token": _TOKEN,
    },
    "log": {"logfile": _TEXT, "vehicle": _TEXT, "date_captured": _TEXT, "location": _TEXT},
    "map": {"category": _TEXT, "filename": _TEXT, "log_tokens": _TOKENS},
    "sample": {"timestamp": _TIME, "scene_token": _TOKEN, "prev": _TOKEN, "next": _TOKEN},
    "sample_annotation": {
        "sample_token": _TOKEN,
        "instance_token": _TOKEN,
        "visibility_token": _TOKEN,
        "attribute_tokens": _TOKENS,
        "translation": _VECTOR,
        "size": _VECTOR,
        "rotation": _QUATERNION,
        "prev": _TOKEN,
        "next": _TOKEN,
        "num_lidar_pts": _COUNT,
        "num_radar_pts": _COUNT,
    },
    "sample_data": {
        "sample_token": _TOKEN,
        "ego_pose_token": _TOKEN,
        "calibrated_sensor_token": _TOKEN,
        "timestamp": _TIME,
        "fileformat": _TEXT,
        "is_key_frame": _FLAG,
        "height": _COUNT,
        "width": _COUNT,
        "filename": _TEXT,
        "prev": _TOKEN,
        "next": _TOKEN,
    },
    "scene": {
        "name": _TEXT,
        "description": _TEXT,
        "log_token": _TOKEN,
        "nbr_samples": _COUNT,
        "first_sample_token": _TOKEN,
        "last_sample_token": _TOKEN,
    },
    "sensor": {"channel": _TEXT, "modality": _TEXT},
    "visibility": {"level": _TEXT},
}


@dataclass(frozen=True, slots=True)
class CheckedTables:
    """Tables after the check of their form.

    Attributes:
        rows: Rows that are objects with a token of their own, by table.
        by_token: The same by table and token.
        unreadable: Tables that are missing or no list of rows; nothing more is said about links into them.
        unsound: Fields that are absent or of the wrong type, by identity of the row.
    """

    rows: dict[str, list[Row]]
    by_token: dict[str, dict[str, Row]]
    unreadable: frozenset[str]
    unsound: dict[int, frozenset[str]]

    def having(self, table: str, *fields: str) -> Iterator[Row]:
        """Rows in which these fields have their type and only finite numbers."""
        for row in self.rows[table]:
            bad = self.unsound.get(id(row))
            if bad is None or bad.isdisjoint(fields):
                yield row

    def get(self, table: str, token: str, *fields: str) -> Row | None:
        """A row by its token, if it exists and these fields of it can be relied on; what is no text names none."""
        row = self.by_token[table].get(token) if isinstance(token, str) else None
        if row is None:
            return None
        bad = self.unsound.get(id(row))
        return row if bad is None or bad.isdisjoint(fields) else None


def read_checked(folder: Path, faults: FaultList) -> CheckedTables:
    """Read all 13 tables and note what is wrong with their form.

    Args:
        folder: Version folder.
        faults: Gets missing and unreadable tables, missing fields, wrong types, numbers that are not finite, and
            tokens that are used twice.

    Returns:
        What can be checked further.
    """
    rows: dict[str, list[Row]] = {}
    unsound: dict[int, frozenset[str]] = {}
    unreadable = set()
    for table in NUSCENES_TABLES:
        content = _content(folder / f"{table}.json", table, faults)
        if content is None:
            unreadable.add(table)
        rows[table] = _with_tokens(table, content or [], faults)
        for row in rows[table]:
            bad = _unsound_fields(table, row, faults)
            if bad:
                unsound[id(row)] = bad
    by_token = {table: {row["token"]: row for row in rows[table]} for table in rows}
    return CheckedTables(rows, by_token, frozenset(unreadable), unsound)


def _content(path: Path, table: str, faults: FaultList) -> list[Any] | None:
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError:
        faults.add(
            "missing table", table, "", f"{path.name} is missing; a data set has all 13 tables, if need be empty"
        )
        return None
    except (OSError, ValueError, RecursionError) as error:
        faults.add("unreadable table", table, "", f"{path.name} cannot be read as JSON: {error}")
        return None
    if not isinstance(content, list):
        kind = type(content).__name__
        faults.add("not a list", table, "", f"{path.name} must be a list of rows, it is a JSON {kind}")
        return None
    return content


def _with_tokens(table: str, content: list[Any], faults: FaultList) -> list[Row]:
    seen: set[str] = set()
    rows: list[Row] = []
    for number, row in enumerate(content):
        if not isinstance(row, dict):
            faults.add("rows that are no objects", table, "", f"row {number} is a {type(row).__name__}, not an object")
        elif not isinstance(row.get("token"), str) or not row["token"]:
            faults.add("rows without token", table, "", f"row {number} has no token")
        elif row["token"] in seen:
            faults.add("tokens used twice", table, row["token"], "two rows have this token")
        else:
            seen.add(row["token"])
            rows.append(row)
    return rows


def _unsound_fields(table: str, row: Row, faults: FaultList) -> frozenset[str]:
    bad = set()
    for name, kind in FIELDS[table].items():
        if name not in row:
            faults.add(f"rows without {name}", table, row["token"], f"the field {name} is missing")
            bad.add(name)
        elif not _is_finite(row[name]):
            faults.add(f"{name} not finite", table, row["token"], f"{name} holds NaN or infinity")
            bad.add(name)
        elif not kind.holds(row[name]):
            shown = json.dumps(row[name])
            shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
            faults.add(f"wrong type of {name}", table, row["token"], f"{name} is {shown}, it must be {kind.words}")
            bad.add(name)
    return frozenset(bad)


def _is_finite(value: Any) -> bool:
    if isinstance(value, float):
        return math.isfinite(value)
    return all(map(_is_finite, value)) if isinstance(value, list) else True
