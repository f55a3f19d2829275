"""Maps from other category names to nuScenes'; without them most protocols see no road users.

The same pairs carry names of cameras, attributes, visibility levels and map layers, chosen by an extension.
"""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from benchmark.constants import CATEGORIES, NUMBERED_CATEGORIES
from benchmark.datasets.tables import Row, Tables
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.extension import call_extension
from benchmark.untrusted.files import SETTINGS
from benchmark.untrusted.text_files import read_json

CategoryNames = tuple[tuple[str, str], ...]
"""Pairs of a data set's own name and nuScenes' name for it; own names of other things than categories have a prefix.

They begin with one of `PREFIXES`, and ``sensor:`` alone names the rig of ``--cameras``, before any table is read.
"""
_RENAMED: Final = {
    "category": ("", "name"),
    "sensor": ("sensor:", "channel"),
    "attribute": ("attribute:", "name"),
    "visibility": ("visibility:", "level"),
}
"""Tables with names: the prefix of the pairs, and the field."""
SENSOR: Final = "sensor:"
LAYER: Final = "layer:"
LIDAR_PLACE: Final = "lidar:"
"""Where LIDAR_TOP sits in the ego frame where there is none: x, y, z in metres, between spaces."""
PREFIXES: Final = (SENSOR, "attribute:", "visibility:", LAYER, LIDAR_PLACE)
NAMES_FILE: Final = "own_recordings.json"
"""Beside the tables: names that hold for every command."""

KNOWN: Final = frozenset(NUMBERED_CATEGORIES)
"""Names that mean what they say: the 23 of annotations, and those of lidarseg, which no annotation has."""

_SHORT: Final = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "construction_vehicle": "vehicle.construction",
    "motorcycle": "vehicle.motorcycle",
    "motorbike": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "cyclist": "vehicle.bicycle",
    "motorcyclist": "vehicle.motorcycle",
    "pedestrian": "human.pedestrian.adult",
    "person": "human.pedestrian.adult",
    "animal": "animal",
    "barrier": "movable_object.barrier",
    "traffic_cone": "movable_object.trafficcone",
    "cone": "movable_object.trafficcone",
    "debris": "movable_object.debris",
    "vehicle": "vehicle.car",
    "vehicle_bus": "vehicle.bus.rigid",
}
_LYFT: Final = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "emergency_vehicle": "vehicle.emergency.ambulance",
    "other_vehicle": "vehicle.construction",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "pedestrian": "human.pedestrian.adult",
    "animal": "animal",
}
_T4: Final = {
    "vehicle.bus (bendy & rigid)": "vehicle.bus.rigid",
    "vehicle.bus": "vehicle.bus.rigid",
    "vehicle.emergency (ambulance & police)": "vehicle.emergency.ambulance",
    "vehicle.ambulance": "vehicle.emergency.ambulance",
    "vehicle.fire": "vehicle.truck",
    "vehicle.police": "vehicle.emergency.police",
    "vehicle.motorbike": "vehicle.motorcycle",
    "pedestrian.adult": "human.pedestrian.adult",
    "pedestrian.child": "human.pedestrian.child",
    "pedestrian.construction_worker": "human.pedestrian.construction_worker",
    "pedestrian.personal_mobility": "human.pedestrian.personal_mobility",
    "pedestrian.police_officer": "human.pedestrian.police_officer",
    "pedestrian.stroller": "human.pedestrian.stroller",
    "pedestrian.wheelchair": "human.pedestrian.wheelchair",
    "movable_object.traffic_cone": "movable_object.trafficcone",
    "static_object.bicycle rack": "static_object.bicycle_rack",
    "static_object.bollard": "movable_object.barrier",
    "car": "vehicle.car",
    "police_car": "vehicle.emergency.police",
    "ambulance": "vehicle.emergency.ambulance",
    "fire_truck": "vehicle.truck",
    "kart": "vehicle.construction",
    "forklift": "vehicle.construction",
    "construction_vehicle": "vehicle.construction",
    "other_vehicle": "vehicle.construction",
    "truck": "vehicle.truck",
    "tractor_unit": "vehicle.truck",
    "semi_trailer": "vehicle.trailer",
    "trailer": "vehicle.trailer",
    "bus": "vehicle.bus.rigid",
    "motorcycle": "vehicle.motorcycle",
    "motorbike": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "motorbike_without_rider": "vehicle.motorcycle",
    "bicycle_without_rider": "vehicle.bicycle",
    "pedestrian": "human.pedestrian.adult",
    "other_pedestrian": "human.pedestrian.adult",
    "police_officer": "human.pedestrian.police_officer",
    "construction_worker": "human.pedestrian.construction_worker",
    "personal_mobility": "human.pedestrian.personal_mobility",
    "stroller": "human.pedestrian.stroller",
    "wheelchair": "human.pedestrian.wheelchair",
    "barrier": "movable_object.barrier",
    "traffic_cone": "movable_object.trafficcone",
    "pushable_pullable": "movable_object.pushable_pullable",
    "debris": "movable_object.debris",
}
_ARGOVERSE_2: Final = {
    "REGULAR_VEHICLE": "vehicle.car",
    "LARGE_VEHICLE": "vehicle.truck",
    "TRUCK": "vehicle.truck",
    "BOX_TRUCK": "vehicle.truck",
    "TRUCK_CAB": "vehicle.truck",
    "VEHICULAR_TRAILER": "vehicle.trailer",
    "MESSAGE_BOARD_TRAILER": "vehicle.trailer",
    "TRAFFIC_LIGHT_TRAILER": "vehicle.trailer",
    "BUS": "vehicle.bus.rigid",
    "SCHOOL_BUS": "vehicle.bus.rigid",
    "ARTICULATED_BUS": "vehicle.bus.bendy",
    "RAILED_VEHICLE": "vehicle.bus.bendy",
    "MOTORCYCLE": "vehicle.motorcycle",
    "MOTORCYCLIST": "vehicle.motorcycle",
    "BICYCLE": "vehicle.bicycle",
    "BICYCLIST": "vehicle.bicycle",
    "WHEELED_DEVICE": "human.pedestrian.personal_mobility",
    "WHEELED_RIDER": "human.pedestrian.personal_mobility",
    "PEDESTRIAN": "human.pedestrian.adult",
    "OFFICIAL_SIGNALER": "human.pedestrian.police_officer",
    "STROLLER": "human.pedestrian.stroller",
    "WHEELCHAIR": "human.pedestrian.wheelchair",
    "DOG": "animal",
    "ANIMAL": "animal",
    "BOLLARD": "movable_object.barrier",
    "CONSTRUCTION_BARREL": "movable_object.barrier",
    "CONSTRUCTION_CONE": "movable_object.trafficcone",
    "SIGN": "movable_object.barrier",
    "STOP_SIGN": "movable_object.barrier",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN": "movable_object.barrier",
    "MOBILE_PEDESTRIAN_SIGN": "movable_object.barrier",
}
READY: Final[Mapping[str, Mapping[str, str]]] = {
    "short": _SHORT,
    "lyft": _LYFT,
    "t4": _T4,
    "argoverse2": _ARGOVERSE_2,
}
"""Built-in maps for ``--categories`` (docs/data.md)."""


def read_categories(named: str) -> dict[str, str]:
    """Map of ``--categories``: one of `READY`, in any spelling, or a JSON file ``{"name": "nuscenes.category"}``."""
    if named in READY:
        return {**{name: name for name in CATEGORIES}, **READY[named]}
    path = Path(named)
    if not path.is_file():
        raise InputError(
            f"--categories {named!r} is no built-in map or file; {did_you_mean(named, READY)}built in are "
            f"{', '.join(READY)}"
        )
    read = read_json(path, SETTINGS)
    if isinstance(read, dict) and any(isinstance(value, dict) for value in read.values()):
        return dict(call_extension("names", "file", read, str(path)))
    wrong = None
    if not isinstance(read, dict) or not read:
        wrong = "is not a JSON object of names"
    else:
        wrong = next((f"maps {name!r} to {to!r}" for name, to in read.items() if to not in CATEGORIES), None)
    if wrong is not None:
        raise InputError(
            f'{path} {wrong}; a map of categories is {{"name": "nuscenes.category"}} with the names of nuScenes, such '
            f"as {CATEGORIES[-3]}"
        )
    return dict(read)


def read_names(categories: str | None, cameras: str | None) -> dict[str, str] | None:
    """Names of ``--categories`` and the rig of ``--cameras``; ``None`` where neither is given."""
    if cameras is not None:
        call_extension("names", "rig", cameras)
    named = {} if categories is None else read_categories(categories)
    return {**named, **({} if cameras is None else {SENSOR: cameras})} or None


def choose_names(folder: Path, tables: Tables, given: Mapping[str, str] | None) -> CategoryNames:
    """Names of a version folder's tables that mean others: those given, and those of a file beside the tables."""
    if (folder / NAMES_FILE).is_file() or any(name.startswith(PREFIXES) for name in given or ()):
        return tuple(call_extension("names", "choose", folder, tables, given or {}))
    return () if given is None else select_category_names((row["name"] for row in tables["category"]), given)


def rename_rows(tables: Tables, names: CategoryNames) -> dict[str, list[Row]]:
    """Tables with other names in the rows that have names."""
    new = dict(names)
    renamed = {
        table: [{**row, field: new.get(f"{prefix}{row.get(field)}", row.get(field))} for row in tables[table]]
        for table, (prefix, field) in _RENAMED.items()
    }
    return {**tables, **renamed}


def select_category_names(own: Iterable[str], given: Mapping[str, str]) -> CategoryNames:
    """Part of a map that renames categories of a data set, sorted.

    A name that is not in the map is looked up without regard to case and to what stands between its words, so that
    ``CAR`` and ``vehicle_car`` are found.
    """
    loose = {_normalise_name(name): to for name, to in reversed([*given.items()])}
    replacements = {
        name: given.get(name) or (None if name in KNOWN else loose.get(_normalise_name(name))) for name in own
    }
    return tuple(sorted((name, to) for name, to in replacements.items() if to is not None and to != name))


def _normalise_name(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.casefold()).strip("_")
