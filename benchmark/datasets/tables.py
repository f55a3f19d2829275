"""The 13 tables of a nuScenes-format root: which version folder, and whether devkit and benchmark can rely on them.

The checks here are those without which reading would crash or mislead. `benchmark.datasets.integrity` looks further.
"""

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import NUSCENES_TABLES
from benchmark.errors import InputError
from benchmark.machine.storage import read_json

Row = dict[str, Any]
Tables = Mapping[str, list[Row]]

_REQUIRED: Final = {
    "attribute": ("name",),
    "calibrated_sensor": ("sensor_token", "translation", "rotation", "camera_intrinsic"),
    "category": ("name",),
    "ego_pose": ("translation", "rotation"),
    "instance": ("category_token",),
    "log": ("logfile", "location"),
    "map": ("log_tokens", "filename"),
    "sample": ("scene_token", "timestamp", "next"),
    "sample_annotation": (
        "sample_token",
        "instance_token",
        "translation",
        "rotation",
        "size",
        "attribute_tokens",
        "num_lidar_pts",
        "num_radar_pts",
    ),
    "sample_data": (
        "sample_token",
        "ego_pose_token",
        "calibrated_sensor_token",
        "timestamp",
        "is_key_frame",
        "filename",
        "next",
    ),
    "scene": ("name", "log_token", "first_sample_token"),
    "sensor": ("channel", "modality"),
    "visibility": (),
}
_LINKS: Final = (
    ("scene", "log_token", "log"),
    ("scene", "first_sample_token", "sample"),
    ("sample", "scene_token", "scene"),
    ("sample", "next", "sample"),
    ("calibrated_sensor", "sensor_token", "sensor"),
    ("sample_data", "sample_token", "sample"),
    ("sample_data", "ego_pose_token", "ego_pose"),
    ("sample_data", "calibrated_sensor_token", "calibrated_sensor"),
    ("sample_data", "next", "sample_data"),
    ("instance", "category_token", "category"),
    ("sample_annotation", "sample_token", "sample"),
    ("sample_annotation", "instance_token", "instance"),
)
_LIST_LINKS: Final = (("sample_annotation", "attribute_tokens", "attribute"),)
"""Not the logs of a map: official v1.0-mini names logs there that only trainval has."""
_VECTORS: Final = (
    ("ego_pose", "translation", 3),
    ("ego_pose", "rotation", 4),
    ("calibrated_sensor", "translation", 3),
    ("calibrated_sensor", "rotation", 4),
    ("sample_annotation", "translation", 3),
    ("sample_annotation", "rotation", 4),
    ("sample_annotation", "size", 3),
)


def version_folders(root: Path) -> tuple[str, ...]:
    """Names of the folders in a root that hold nuScenes tables, sorted; a single table is enough to count.

    Args:
        root: Root folder of a data set.

    Returns:
        Folder names, possibly none.
    """
    found = []
    for folder in sorted(root.iterdir()):
        if not folder.is_dir() or folder.name.startswith("."):
            continue
        present = sum((folder / f"{table}.json").is_file() for table in NUSCENES_TABLES)
        if present == len(NUSCENES_TABLES) or (present and folder.name.startswith("v")):
            found.append(folder.name)
    return tuple(found)


def find_version(root: Path, version: str | None) -> str:
    """The version folder to read, with all 13 tables in it.

    Args:
        root: Root folder of a data set.
        version: Asked for by the user, or ``None`` to take the only one.

    Returns:
        The folder's name.

    Raises:
        InputError: If the root is no folder, holds no or several versions, or a table is missing.
    """
    if not root.exists():
        raise InputError(f"there is no folder {root}; give the root of a nuScenes-format data set")
    if not root.is_dir():
        raise InputError(f"{root} is not a folder; give the root of a nuScenes-format data set")
    if version is not None:
        if Path(version).name != version or not (root / version).is_dir():
            known = ", ".join(version_folders(root)) or "none"
            raise InputError(f"{root} has no version folder {version!r}; versions there: {known}")
        _require_all_tables(root / version)
        return version
    found = version_folders(root)
    if not found:
        raise InputError(
            f"{root} has no version folder with nuScenes tables (scene.json and 12 more); give the folder that "
            "contains for example v1.0-mini/"
        )
    if len(found) > 1:
        raise InputError(f"{root} has several versions ({', '.join(found)}); name one with --tables")
    _require_all_tables(root / found[0])
    return found[0]


def _require_all_tables(folder: Path) -> None:
    missing = [table for table in NUSCENES_TABLES if not (folder / f"{table}.json").is_file()]
    if missing:
        names = ", ".join(f"{table}.json" for table in missing)
        raise InputError(f"{folder} lacks {names}; all 13 nuScenes tables must be there (they may be empty lists)")


def read_tables(folder: Path) -> Tables:
    """Read all 13 tables without the devkit, to find out why it could not.

    Args:
        folder: Version folder.

    Returns:
        Rows by table name.

    Raises:
        InputError: If a table is absent, not JSON or not a list of objects with a token.
    """
    return {table: read_json(folder / f"{table}.json") for table in NUSCENES_TABLES}


def check_tables(tables: Tables, folder: Path) -> None:
    """Refuse tables on which reading would crash or give wrong numbers.

    Linear in the number of rows: rows are objects with unique tokens, needed fields exist, links lead somewhere, poses
    and sizes are finite numbers.

    Args:
        tables: Rows by table name.
        folder: Version folder, for messages.

    Raises:
        InputError: For the first fault, naming file and token.
    """
    tokens = {}
    for table, fields in _REQUIRED.items():
        path = folder / f"{table}.json"
        tokens[table] = _tokens(tables[table], path)
        for field in fields:
            _column(tables[table], field, path)
    _require_scenes(tables["scene"], folder)
    for link in (*_LINKS, *_LIST_LINKS):
        _require_known(tables[link[0]], link, tokens, folder)
    for table, field, length in _VECTORS:
        _require_finite(tables[table], field, length, folder / f"{table}.json")
    _require_maps(tables, folder)


def check_shared_tables(tables: Tables, folder: Path) -> dict[str, set[str]]:
    """What `check_tables` checks within the tables that are given, among them scene, log and map.

    Args:
        tables: Rows by table name.
        folder: Version folder, for messages.

    Returns:
        Tokens by table name.

    Raises:
        InputError: For the first fault, naming file and token.
    """
    tokens = {table: _tokens(rows, folder / f"{table}.json") for table, rows in tables.items()}
    for table, rows in tables.items():
        check_rows(table, rows, tokens, folder)
    _require_scenes(tables["scene"], folder)
    _require_maps(tables, folder)
    return tokens


def check_rows(table: str, rows: list[Row], tokens: Mapping[str, set[str]], folder: Path) -> None:
    """What `check_tables` checks of rows by themselves, whatever other rows their table has.

    Args:
        table: Name of the table.
        rows: Some of its rows, or all.
        tokens: Tokens of other tables by name; links to tables that are not among them are not checked.
        folder: Version folder, for messages.

    Raises:
        InputError: For the first fault, naming file and token.
    """
    path = folder / f"{table}.json"
    _tokens(rows, path)
    for field in _REQUIRED[table]:
        _column(rows, field, path)
    for link in (*_LINKS, *_LIST_LINKS):
        if link[0] == table and link[2] in tokens:
            _require_known(rows, link, tokens, folder)
    for of_table, field, length in _VECTORS:
        if of_table == table:
            _require_finite(rows, field, length, path)


def _tokens(rows: Any, path: Path) -> set[str]:
    if not isinstance(rows, list):
        raise InputError(f"{path} must hold a JSON list of rows, it holds {type(rows).__name__}; make the table again")
    for number, row in enumerate(rows):
        if not isinstance(row, dict) or not isinstance(row.get("token"), str):
            raise InputError(f"{path} row {number} is not an object with a token; make the table again")
    tokens = {row["token"] for row in rows}
    if len(tokens) != len(rows):
        twice = Counter(row["token"] for row in rows).most_common(1)[0][0]
        raise InputError(f"{path} has two rows with token {twice}; tokens must be unique, make the table again")
    return tokens


def _column(rows: list[Row], field: str, path: Path) -> list[Any]:
    try:
        return [row[field] for row in rows]
    except KeyError:
        row = next(row for row in rows if field not in row)
        raise InputError(f"{path} row {row['token']} has no field {field!r}; make the table again") from None


def _linked(row: Row, field: str) -> list[str]:
    """Tokens that a field names; one that is no text is shown as it is and known nowhere."""
    many = field.endswith("_tokens") and isinstance(row[field], list)
    values = row[field] if many else [row[field]]
    return [value if isinstance(value, str) else repr(value) for value in values]


def _require_known(rows: list[Row], link: tuple[str, str, str], tokens: Mapping[str, set[str]], folder: Path) -> None:
    table, field, target = link
    known, may_be_empty = tokens[target], field == "next"
    for row in rows:
        if row[field].__class__ is str and (row[field] in known or (may_be_empty and not row[field])):
            continue
        for linked in _linked(row, field):
            if linked not in known and not (may_be_empty and not linked):
                raise InputError(
                    f"{folder / f'{table}.json'} row {row['token']}: {field} {linked} is not in {target}.json; the "
                    "tables do not belong together or are incomplete"
                )


def _require_finite(rows: list[Row], field: str, length: int, path: Path) -> None:
    if not rows:
        return
    try:
        values = np.array([row[field] for row in rows], dtype=np.float64)
        if values.shape == (len(rows), length) and np.isfinite(values).all() and _sane(values, field):
            return
    except (TypeError, ValueError):
        pass
    for row in rows:
        try:
            value = np.array(row[field], dtype=np.float64)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape != (length,) or not np.isfinite(value).all() or not _sane(value[None], field):
            needed = {"rotation": "a non-zero quaternion", "size": "positive"}.get(field, "finite")
            raise InputError(
                f"{path} row {row['token']}: {field} is {row[field]}, it must be {length} numbers, {needed}; correct "
                "the table or leave the scene out"
            )


def _sane(values: np.ndarray[Any, np.dtype[np.float64]], field: str) -> bool:
    if field == "rotation":
        return bool((np.abs(values).sum(axis=-1) > 1e-6).all())
    return field != "size" or bool((values > 0).all())


def _require_scenes(scenes: list[Row], folder: Path) -> None:
    if not scenes:
        raise InputError(f"{folder / 'scene.json'} is empty; a data set needs at least one scene")
    seen: set[str] = set()
    for row in scenes:
        if not isinstance(row["name"], str) or row["name"] in seen:
            raise InputError(
                f"{folder / 'scene.json'} row {row['token']}: the name {row['name']!r} is no text or used twice; scene "
                "names must be unique"
            )
        seen.add(row["name"])


def _require_maps(tables: Tables, folder: Path) -> None:
    mapped = {log for row in tables["map"] for log in row["log_tokens"]}
    for log in tables["log"]:
        if log["token"] not in mapped:
            raise InputError(
                f"{folder / 'map.json'}: no map lists log {log['token']} in log_tokens; the devkit needs one for "
                "each log"
            )


def scene_number(name: str) -> int | None:
    """Number of an official scene name such as ``scene-0061``, or ``None`` for any other name."""
    match = re.fullmatch(r"scene-(\d{4})", name)
    return int(match.group(1)) if match else None
