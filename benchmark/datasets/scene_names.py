"""Names of scenes: tables of generated roots number them for the devkit; all else calls them by recording and variant.

``challenger.json`` says, under each scene's name in the tables (``scene-2001``), its ``name`` (``scene-8006-342b7d08``)
and ``shift_us``, by how much its times were moved past those of other variants of the recording.
"""

import functools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from benchmark.datasets.stored_rows import iterate_rows
from benchmark.datasets.tables import find_variant_folders, find_version_folders
from benchmark.machine.storage import read_cached_json
from benchmark.untrusted.files import to_one_line

PROVENANCE: Final = "challenger.json"
NAME: Final = "name"
SHIFT_US: Final = "shift_us"
NUMBERED: Final = "numbered"
"""Added to what is said of a scene when its name replaces the one in the tables."""
_PLAIN: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,199}")
_DEVKIT_NAME: Final = re.compile(r"scene-\d{4}")


def is_devkit_name(name: str) -> bool:
    """Whether the devkit's readers of CAN bus and maps take the name: ``scene-`` and four digits."""
    return _DEVKIT_NAME.fullmatch(name) is not None


def read_names(folder: Path) -> Mapping[str, str]:
    """Names of a version folder's scenes by their names in its tables; empty where these are the same.

    A damaged file says nothing here; opening the data set refuses it.
    """
    path = folder / PROVENANCE
    try:
        status = path.stat()
    except OSError:
        return {}
    return _read_names(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=16)
def _read_names(path: Path, _changed_ns: int, _size: int) -> Mapping[str, str]:
    made = read_cached_json(path)
    names = find_names(made)
    return MappingProxyType({} if find_name_fault(made) else names)


def find_names(made: Any) -> dict[str, str]:
    """Names by names in the tables that unchecked ``challenger.json`` gives."""
    return {row: entry[NAME] for row, entry in _list_entries(made).items() if isinstance(entry.get(NAME), str)}


def find_name_fault(made: Any) -> str:
    """What is wrong with names and shifts of ``challenger.json``; empty if nothing is."""
    entries = _list_entries(made)
    for row, entry in entries.items():
        if NAME in entry and not (isinstance(entry[NAME], str) and _PLAIN.fullmatch(entry[NAME])):
            return f"the name of {to_one_line(row, 80)} must be letters, digits, dots, dashes and underscores"
        if type(entry.get(SHIFT_US, 0)) is not int:
            return f"the {SHIFT_US} of {to_one_line(row, 80)} must be whole microseconds"
    names = find_names(made)
    called = [names.get(row, row) for row in entries]
    twice = next((name for name in called if called.count(name) > 1), None) if len(set(called)) < len(called) else None
    return "" if twice is None else f"two scenes have the name {to_one_line(twice, 80)}"


def _list_entries(made: Any) -> dict[str, dict[str, Any]]:
    scenes = made.get("scenes") if isinstance(made, dict) else None
    return {row: entry for row, entry in scenes.items() if isinstance(entry, dict)} if isinstance(scenes, dict) else {}


def rename_scenes(made: Mapping[str, Any]) -> dict[str, Any]:
    """Sound ``challenger.json`` with its scenes under their names; each says the one that it has in the tables."""
    names = find_names(made)
    scenes = {
        names.get(row, row): {**entry, NUMBERED: row} if row in names else entry
        for row, entry in made["scenes"].items()
    }
    for name in names.values():
        del scenes[name][NAME]
    return {**made, "scenes": scenes}


def find_table_name(folder: Path, name: str) -> str:
    """Name that a scene has in the tables of a version folder."""
    return next((row for row, called in read_names(folder).items() if called == name), name)


def resolve_names(made: Mapping[str, Any] | None, wanted: Sequence[str]) -> tuple[str, ...]:
    """Names of scenes given by them or by those in the tables; ``made`` is a data set's `provenance`."""
    numbered = {str(entry[NUMBERED]): name for name, entry in _list_entries(made).items() if NUMBERED in entry}
    return tuple(numbered.get(name, name) for name in wanted)


def resolve_names_below(root: Path, wanted: Sequence[str] | None) -> tuple[str, ...] | None:
    """`resolve_names` of a root that is not opened, if it is there; ``None`` stays."""
    versions = find_version_folders(root) if wanted and root.is_dir() else ()
    known = {row: name for version in versions for row, name in read_names(root / version).items()}
    return None if wanted is None else tuple(known.get(name, name) for name in wanted)


def find_shift_us(made: Mapping[str, Any] | None, name: str) -> int:
    """Microseconds by which a scene's times are later than its recording's; ``made`` is a data set's `provenance`."""
    shift = _list_entries(made).get(name, {}).get(SHIFT_US, 0)
    return shift if type(shift) is int else 0


def find_table_name_below(root: Path, name: str) -> str:
    """`find_table_name` of a root that is not opened, if it is there."""
    versions = find_version_folders(root) if root.is_dir() else ()
    rows = (find_table_name(root / version, name) for version in versions)
    return next((row for row in rows if row != name), name)


def find_can_bus_file(root: Path, scene: str, message: str) -> Path:
    """Path of a scene's messages of one kind, whether they are there or not."""
    return root / "can_bus" / f"{find_table_name_below(root, scene)}_{message}.json"


def read_scene_times(root: Path, version: str) -> dict[str, tuple[int, int]]:
    """First and last sample time, microseconds, of the scenes of a root or of variant roots, by name."""
    folders = find_variant_folders(root)
    if folders:
        parts = {folder: read_scene_times(root / folder, version) for folder in folders}
        return {f"{folder}/{name}": times for folder, part in parts.items() for name, times in part.items()}
    times: dict[str, list[int]] = {}
    for row in iterate_rows(root / version / "sample.json", "scene_token"):
        times.setdefault(row["scene_token"], []).append(row["timestamp"])
    names = read_names(root / version)
    scenes = iterate_rows(root / version / "scene.json", "name", "token")
    return {
        names.get(row["name"], row["name"]): (min(times[row["token"]]), max(times[row["token"]]))
        for row in scenes
        if row["token"] in times
    }
