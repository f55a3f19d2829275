"""Names of recordings that mean nuScenes': labels, map layers, cameras; given, or in a file beside the tables."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from benchmark.constants import CATEGORIES, MAP_LAYERS
from benchmark.datasets.categories import (
    LAYER,
    LIDAR_PLACE,
    NAMES_FILE,
    PREFIXES,
    SENSOR,
    CategoryNames,
    read_categories,
    select_category_names,
)
from benchmark.datasets.tables import Tables
from benchmark.errors import InputError
from benchmark.extensions.own_recordings.rigs import Rig, choose_views, parse_rig, read_rig
from benchmark.untrusted.files import SETTINGS
from benchmark.untrusted.text_files import read_json

ATTRIBUTES: Final = (
    "cycle.with_rider",
    "cycle.without_rider",
    "pedestrian.moving",
    "pedestrian.sitting_lying_down",
    "pedestrian.standing",
    "vehicle.moving",
    "vehicle.parked",
    "vehicle.stopped",
)
VISIBILITY_LEVELS: Final = ("v0-40", "v40-60", "v60-80", "v80-100")
_SECTIONS: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "categories": ("", CATEGORIES),
    "attributes": ("attribute:", ATTRIBUTES),
    "visibility": ("visibility:", VISIBILITY_LEVELS),
    "layers": (LAYER, (*MAP_LAYERS, "connectivity", "arcline_path_3", "canvas_edge")),
}
"""Sections of a file of names: the prefix of their pairs, and what their names may mean."""
_OF_RIGS: Final = ("cameras", "lidar")


def flatten_names(read: Any, where: str) -> dict[str, str]:
    """Pairs of a file of names, all but its cameras; ``categories`` may be a ready map's name.

    Raises `InputError` for a section that there is not, and for what nuScenes has not.
    """
    known = (*_SECTIONS, *_OF_RIGS)
    if not isinstance(read, dict) or not read:
        raise InputError(f"{where} is not a JSON object of names; its sections are {', '.join(known)}")
    if unknown := next((name for name in read if name not in known), None):
        raise InputError(f"{where} has the section {unknown!r}; sections are {', '.join(known)}")
    pairs: dict[str, str] = {}
    for section, (prefix, meant) in _SECTIONS.items():
        names = read.get(section, {})
        if section == "categories" and isinstance(names, str):
            pairs |= read_categories(names)
            continue
        if not isinstance(names, dict):
            raise InputError(f'{where}: "{section}" must be an object {{"own name": "nuScenes\' name"}}')
        for own, to in names.items():
            if to not in meant:
                raise InputError(
                    f'{where}: "{section}" maps {own!r} to {to!r}; nuScenes has {", ".join(meant[:4])}'
                    f"{', ...' if len(meant) > 4 else ''}"
                )
            pairs[f"{prefix}{own}"] = to
    return pairs


def choose_names(folder: Path, tables: Tables, given: Mapping[str, str]) -> CategoryNames:
    """Pairs that hold for a version folder; of each section those given, or else those of the file beside the tables.

    Args:
        folder: The version folder.
        tables: Its tables that do not grow with the scenes.
        given: Of ``--categories`` and ``--cameras``, or pairs that were chosen before.

    Raises:
        InputError: If the file is wrong, or a rig does not fit.
    """
    path = folder / NAMES_FILE
    read = read_json(path, SETTINGS) if path.is_file() else None
    beside = {} if read is None else flatten_names(read, str(path))
    rig = Rig(str(path)) if read is None or not set(_OF_RIGS) & set(read) else parse_rig(read, str(path))
    pairs: dict[str, str] = {}
    for prefix in ("", *PREFIXES):
        part = _select_section(given, prefix) or _select_section(beside, prefix)
        if prefix == "" and part:
            pairs |= select_category_names((row["name"] for row in tables["category"]), part)
        elif prefix == SENSOR:
            pairs |= _choose_sensors(part, rig, tables)
        elif prefix in (LAYER, LIDAR_PLACE):
            pairs |= part
        else:
            table, field = ("attribute", "name") if prefix.startswith("attribute") else ("visibility", "level")
            own = {f"{prefix}{row[field]}" for row in tables[table]}
            pairs |= {name: to for name, to in part.items() if name in own}
    place = (read_rig(given[SENSOR]).place if SENSOR in given else None) or rig.place
    if place is not None:
        pairs.setdefault(LIDAR_PLACE, place)
    return tuple(sorted(pairs.items()))


def _choose_sensors(given: Mapping[str, str], beside: Rig, tables: Tables) -> dict[str, str]:
    if given and SENSOR not in given:
        own = {f"{SENSOR}{row['channel']}" for row in tables["sensor"]}
        return {name: view for name, view in given.items() if name in own}
    rig = read_rig(given[SENSOR]) if given else beside
    return {f"{SENSOR}{name}": view for name, view in choose_views(rig, tables).items()}


def _select_section(pairs: Mapping[str, str], prefix: str) -> dict[str, str]:
    if prefix:
        return {name: to for name, to in pairs.items() if name.startswith(prefix)}
    return {name: to for name, to in pairs.items() if not name.startswith(PREFIXES)}
