"""Files beside the tables, as far as they are read: messages of the CAN bus expansion, points of the map expansion."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.schema.rows import format_value
from benchmark.datasets.schema.tables import (
    EARTH_M,
    LINKS_OF_LIST,
    POSITION,
    ROTATION,
    TIME,
    TOKEN,
    ValueKind,
    number,
    numbers,
)
from benchmark.errors import InputError

_FASTEST: Final = 1e4
"""No car goes so fast, turns so fast or brakes so hard, in units of metres, radians and seconds."""
_LONGEST_LANE_M: Final = 1e5
_MOTION: Final = numbers(
    "three numbers that a car can reach", 3, lambda values: (np.abs(values) < _FASTEST).all(axis=-1)
)
_PLANAR: Final = numbers(
    "three numbers (x, y in metres within the earth, heading)",
    3,
    lambda values: (np.abs(values) <= EARTH_M).all(axis=-1),
)
_LENGTHS: Final = numbers(
    "three lengths, at least 0 and less than a hundred kilometres",
    3,
    lambda values: ((values >= 0) & (values < _LONGEST_LANE_M)).all(axis=-1),
)

CAN_BUS: Final[Mapping[str, Mapping[str, ValueKind]]] = {
    "pose": {"utime": TIME, "vel": _MOTION, "accel": _MOTION, "rotation_rate": _MOTION},
    "steeranglefeedback": {
        "utime": TIME,
        "value": number("a number that a steering wheel can reach", -_FASTEST, _FASTEST),
    },
}
"""Fields by message, in the order in which they are read."""
CAN_BUS_POSE: Final[Mapping[str, ValueKind]] = {"pos": POSITION, "orientation": ROTATION}
"""Further fields of the message ``pose``, which official code reads."""
MAP_NODE: Final[Mapping[str, ValueKind]] = {
    axis: number("a number, metres within the earth", -EARTH_M, EARTH_M) for axis in ("x", "y")
}
MAP_RECORD: Final[Mapping[str, ValueKind]] = {"token": TOKEN}
MAP_LINKS: Final[Mapping[str, ValueKind]] = {"incoming": LINKS_OF_LIST, "outgoing": LINKS_OF_LIST}
ARC_LINE: Final[Mapping[str, ValueKind]] = {
    "start_pose": _PLANAR,
    "end_pose": _PLANAR,
    "radius": number("a number, metres", -EARTH_M, EARTH_M),
    "segment_length": _LENGTHS,
}


def require_records(
    path: Path, what: str, records: Any, fields: Mapping[str, ValueKind]
) -> Sequence[Mapping[str, Any]]:
    """Refuse records of a file that lack a field or hold what they must not; ``what`` is the name of one of them."""
    if type(records) is not list or any(type(record) is not dict for record in records):
        raise InputError(f"{path} must hold a list of objects, each a {what}; fetch or make it again")
    for name, kind in fields.items():
        if records and all(name in record for record in records) and kind.column([entry[name] for entry in records]):
            continue
        for index, record in enumerate(records):
            if name not in record:
                raise InputError(f"{path}: {what} {index} has no field {name}; fetch or make it again")
            if not kind.holds(record[name]):
                raise InputError(
                    f"{path}: {name} of {what} {index} is {format_value(record[name])}, it must be {kind.words}; fetch "
                    "or make it again"
                )
    return records
