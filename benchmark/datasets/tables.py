"""Where the 13 tables of a nuScenes-format root are; what must be in them is in `benchmark.datasets.schema`."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmark.constants import NUSCENES_TABLES
from benchmark.errors import InputError

Row = dict[str, Any]
Tables = Mapping[str, list[Row]]


def find_version_folders(root: Path) -> tuple[str, ...]:
    """Names of the folders in a root that hold nuScenes tables, sorted; a single table is enough to count."""
    names = []
    for folder in sorted(root.iterdir()):
        if not folder.is_dir() or folder.name.startswith("."):
            continue
        present = sum((folder / f"{table}.json").is_file() for table in NUSCENES_TABLES)
        if present == len(NUSCENES_TABLES) or (present and folder.name.startswith("v")):
            names.append(folder.name)
    return tuple(names)


def find_variant_folders(root: Path) -> tuple[str, ...]:
    """Names of the variant roots in a folder: ``v0``, ``v1``, ... in numeric order.

    None unless at least one holds a version folder. An unfinished variant beside finished ones is among them, so that
    opening fails and nothing is computed from a part of the data.
    """
    if not root.is_dir():
        return ()
    numbered = [path for path in root.iterdir() if re.fullmatch(r"v\d+", path.name) and path.is_dir()]
    if not any(map(find_version_folders, numbered)):
        return ()
    return tuple(path.name for path in sorted(numbered, key=lambda path: int(path.name[1:])))


def find_version(root: Path, version: str | None) -> str:
    """Name of the version folder to read, with all 13 tables in it; without a ``version``, the only one."""
    if not root.exists():
        raise InputError(f"there is no folder {root}; give the root of a nuScenes-format data set")
    if not root.is_dir():
        raise InputError(f"{root} is not a folder; give the root of a nuScenes-format data set")
    if version is not None:
        if Path(version).name != version or not (root / version).is_dir():
            known = ", ".join(find_version_folders(root)) or "none"
            raise InputError(f"{root} has no version folder {version!r}; versions there: {known}")
        _require_all_tables(root / version)
        return version
    versions = find_version_folders(root)
    if not versions:
        raise InputError(
            f"{root} has no version folder with nuScenes tables (scene.json and 12 more); give the folder that "
            "contains for example v1.0-mini/"
        )
    if len(versions) > 1:
        raise InputError(f"{root} has several versions ({', '.join(versions)}); name one with --tables")
    _require_all_tables(root / versions[0])
    return versions[0]


def _require_all_tables(folder: Path) -> None:
    missing = [table for table in NUSCENES_TABLES if not (folder / f"{table}.json").is_file()]
    if missing:
        names = ", ".join(f"{table}.json" for table in missing)
        raise InputError(f"{folder} lacks {names}; all 13 nuScenes tables must exist (they may be empty lists)")


def find_splits_file(folder: Path, root: Path) -> Path | None:
    """Path of ``splits.json`` in the version folder, else in the root; ``None`` where neither has one."""
    return next((path for path in (folder / "splits.json", root / "splits.json") if path.is_file()), None)


def parse_scene_number(name: str) -> int | None:
    """Number of an official scene name such as ``scene-0061``, or ``None`` for any other name."""
    match = re.fullmatch(r"scene-(\d{4})", name)
    return int(match.group(1)) if match else None
