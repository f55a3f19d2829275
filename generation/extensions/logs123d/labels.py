"""Labels of 123D's sources, and nuScenes' categories for them."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Final

from benchmark.constants import CATEGORIES
from benchmark.datasets.scenarionet_tracks import name_vehicle
from benchmark.errors import InputError
from benchmark.machine.storage import read_json
from benchmark.untrusted.files import to_one_line
from generation.extensions.logs123d.log_files import Table

NUSCENES: Final = "NuScenesBoxDetectionLabel"
_CLASS: Final = "box_detection_label_class"
_NUSCENES_NAMES: Final = {category.upper().replace(".", "_"): category for category in CATEGORIES}
_PERSON, _ADULT = "human.pedestrian.", "human.pedestrian.adult"
_BY_NAME: Final[Mapping[str, str]] = {
    "CAR": "vehicle.car", "REGULAR_VEHICLE": "vehicle.car", "AUTOMOBILE": "vehicle.car", "PICKUP_TRUCK": "vehicle.car",
    "PASSENGER_CAR": "vehicle.car",
    "BUS": "vehicle.bus.rigid", "SCHOOL_BUS": "vehicle.bus.rigid", "TROLLEY_BUS": "vehicle.bus.rigid",
    "VEHICLE_BUS": "vehicle.bus.rigid", "ARTICULATED_BUS": "vehicle.bus.bendy",
    "TRUCK": "vehicle.truck", "BOX_TRUCK": "vehicle.truck", "LARGE_VEHICLE": "vehicle.truck",
    "TRUCK_CAB": "vehicle.truck", "HEAVY_TRUCK": "vehicle.truck", "MEDIUM_SIZED_TRUCK": "vehicle.truck",
    "SEMI_TRUCK": "vehicle.truck", "SEMI_TRUCK_CAB": "vehicle.truck",
    "TRAILER": "vehicle.trailer", "VEHICULAR_TRAILER": "vehicle.trailer", "SEMI_TRUCK_TRAILER": "vehicle.trailer",
    "MESSAGE_BOARD_TRAILER": "vehicle.trailer", "TRAFFIC_LIGHT_TRAILER": "vehicle.trailer",
    "CARAVAN": "vehicle.trailer", "TOWED_OBJECT": "vehicle.trailer",
    "OTHER_VEHICLE_CONSTRUCTION_VEHICLE": "vehicle.construction",
    # Which of the two it is, nothing says.
    "EMERGENCY_VEHICLE": "vehicle.emergency.police",
    "MOTORCYCLE": "vehicle.motorcycle", "MOTORIZED_SCOOTER": "vehicle.motorcycle",
    "VEHICLE_MOTORCYCLE": "vehicle.motorcycle",
    "VEHICLE_PERSONAL_MOBILITY_BYCICLE": f"{_PERSON}personal_mobility",
    "WHEELED_DEVICE": f"{_PERSON}personal_mobility", "PERSONAL_MOBILITY_DEVICE": f"{_PERSON}personal_mobility",
    "STROLLER": f"{_PERSON}stroller", "WHEELCHAIR": f"{_PERSON}wheelchair",
    "ROLLING_CONTAINERS": "movable_object.pushable_pullable", "TRASH_BIN": "movable_object.pushable_pullable",
}  # fmt: skip
"""Where the name says more than what kind of thing it is."""
_BY_KIND: Final[Mapping[str, str]] = {
    "TWO_WHEELER": "vehicle.bicycle",
    "PERSON": _ADULT,
    "ANIMAL": "animal",
    "TRAFFIC_CONE": "movable_object.trafficcone",
    "BARRIER": "movable_object.barrier",
    "GENERIC_OBJECT": "movable_object.debris",
    "OTHER": "movable_object.debris",
}
"""By 123D's own kinds; vehicles by their length, and the rest (`UNKNOWN_TO_NUSCENES`) not at all."""
UNKNOWN_TO_NUSCENES: Final = ("EGO", "TRAIN", "TRAFFIC_SIGN", "TRAFFIC_LIGHT")


@cache
def list_labels() -> Mapping[str, tuple[tuple[str, str], ...]]:
    """Name and kind of each code, by label class."""
    held = read_json(Path(__file__).parent / "assets" / "labels.json")
    return {name: tuple((label, kind) for label, kind in codes) for name, codes in held.items()}


def find_label_class(table: Table) -> str:
    """The class that a file of boxes names; one that is not known is refused by name."""
    given = table.metadata.get(_CLASS)
    name = str(given).rpartition(".")[2]
    if name not in list_labels():
        raise InputError(
            f"{table.path} has labels of the class {to_one_line(repr(given), 80)}, which is not known; known are "
            f"{', '.join(sorted(list_labels()))}"
        )
    return name


def name_label(label_class: str, code: int, table: Table) -> tuple[str, str]:
    """Name and kind of a code."""
    codes = list_labels()[label_class]
    if not 0 <= code < len(codes):
        raise table.damaged(f"it holds the label {code}, and {label_class} has 0 to {len(codes) - 1}")
    return codes[code]


def find_category(label_class: str, name: str, kind: str, length_m: float) -> str | None:
    """NuScenes' category of a label, vehicles without a type by length; ``None`` where nuScenes has none."""
    if label_class == NUSCENES:
        return _NUSCENES_NAMES[name]
    if kind in UNKNOWN_TO_NUSCENES:
        return None
    known = _BY_NAME.get(name) or _BY_KIND.get(kind)
    return known or name_vehicle(length_m)
