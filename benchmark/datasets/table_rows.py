"""Tables read row by row and counted, without the devkit: only tokens are held in memory."""

import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO

from benchmark.datasets.tables import Row
from benchmark.errors import InputError

_CHUNK_CHARACTERS: Final = 1 << 20
_LONGEST_ROW_CHARACTERS: Final = 1 << 24
"""What cannot be decoded within so much is no row: the rest of a broken table is not read into memory."""


@dataclass(frozen=True, slots=True)
class TableCounts:
    """Numbers of table rows that belong to some scenes: the paper's table "Overview of the Adv-nuSc Dataset".

    Attributes:
        instances: Rows of ``instance`` with an annotation in the scenes.
        ego_poses: Rows of ``ego_pose`` that sensor data of the scenes name.
        scenes: Rows of ``scene``.
        samples: Rows of ``sample``.
        sample_data: Rows of ``sample_data``.
        annotations: Rows of ``sample_annotation``.
    """

    instances: int
    ego_poses: int
    scenes: int
    samples: int
    sample_data: int
    annotations: int


def count_rows(folder: Path, names: Collection[str] | None) -> TableCounts:
    """Count the rows that belong to some scenes.

    Args:
        folder: Version folder with the tables.
        names: Names of the scenes; ``None`` for every row of the tables, whatever it belongs to.

    Returns:
        The numbers.

    Raises:
        InputError: If a table is absent, not a JSON list of objects, or lacks a field that links it.
    """
    every = names is None
    scenes = {
        row["token"]
        for row in table_rows(folder / "scene.json", "token", "name")
        if names is None or row["name"] in names
    }
    samples, sample_count = _linked(folder / "sample.json", "scene_token", None if every else scenes, "token")
    wanted = None if every else samples
    poses, data_count = _linked(folder / "sample_data.json", "sample_token", wanted, "ego_pose_token")
    instances, annotation_count = _linked(folder / "sample_annotation.json", "sample_token", wanted, "instance_token")
    return TableCounts(
        instances=_linked(folder / "instance.json", "token", None if every else instances, "token")[1],
        ego_poses=_linked(folder / "ego_pose.json", "token", None if every else poses, "token")[1],
        scenes=len(scenes),
        samples=sample_count,
        sample_data=data_count,
        annotations=annotation_count,
    )


def _linked(path: Path, field: str, wanted: Collection[str] | None, gives: str) -> tuple[set[str], int]:
    """Values of one field in the rows whose other field is wanted (``None``: all rows), and how many rows these are."""
    found, count = set(), 0
    for row in table_rows(path, field, gives):
        if wanted is None or row[field] in wanted:
            count += 1
            found.add(row[gives])
    return found, count


def table_rows(path: Path, *needed: str) -> Iterator[Row]:
    """Rows of one table, one after the other, as the file is read.

    Args:
        path: The table.
        needed: Fields that must be there and be text.

    Yields:
        Rows.

    Raises:
        InputError: If the file is absent, not a JSON list of objects, or a row lacks a field.
    """
    for number, row in enumerate(_values(path)):
        if not isinstance(row, dict) or not all(isinstance(row.get(field), str) for field in needed):
            raise InputError(f"{path} row {number} is not an object with {' and '.join(needed)}; make the table again")
        yield row


def _values(path: Path) -> Iterator[Any]:
    """Values of a JSON list, decoded as the file is read."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            yield from _listed(stream, path)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path} is not valid JSON ({error}); it may be truncated, fetch or make it again") from error


def _listed(stream: TextIO, path: Path) -> Iterator[Any]:
    """Values of a list; a `ValueError` where there is something other than values, commas and one end."""
    decoder, text, at, wanted = json.JSONDecoder(), "", 0, "the list"
    while True:
        while at < len(text) and text[at].isspace():
            at += 1
        if at == len(text):
            text, at = stream.read(_CHUNK_CHARACTERS), 0
            if not text and wanted == "nothing more":
                return
            if not text:
                raise ValueError(f"it ends where {wanted} should be")
        elif wanted == "the list":
            if text[at] != "[":
                raise InputError(f"{path} must hold a JSON list of rows; make the table again")
            at, wanted = at + 1, "the first row"
        elif text[at] == "]" and wanted in ("the first row", "a comma"):
            at, wanted = at + 1, "nothing more"
        elif wanted == "a comma" and text[at] == ",":
            at, wanted = at + 1, "a row"
        elif wanted in ("a comma", "nothing more"):
            raise ValueError(f"there is {text[at]!r} where {wanted} should be")
        else:
            try:
                value, at = decoder.raw_decode(text, at)
            except ValueError:
                chunk = stream.read(_CHUNK_CHARACTERS)
                if not chunk or len(text) - at > _LONGEST_ROW_CHARACTERS:
                    raise
                text, at = text[at:] + chunk, 0
                continue
            wanted = "a comma"
            yield value
