"""Rigs: which of a data set's cameras is which of the six views that planners ask for, by name or by direction."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmark.constants import CAMERA_NAMES, LIDAR_NAME
from benchmark.datasets.categories import SENSOR, CategoryNames
from benchmark.datasets.tables import Row, Tables
from benchmark.errors import InputError, did_you_mean
from benchmark.geometry import Floats, rotation_matrix
from benchmark.untrusted.files import SETTINGS
from benchmark.untrusted.text_files import read_json

FARTHEST_DEG: Final = 40.0
"""A camera that looks farther away than this from where a view looks is none for it."""
_DEGREES_OF_VIEW: Final = 4.0
"""So many degrees of another field of view weigh as much as one of another direction."""
_HIGHEST_M: Final = 5.0


@dataclass(frozen=True, slots=True)
class ViewDirection:
    """Where a view looks: heading in the ego frame, to the left positive, and horizontal field of view, degrees."""

    yaw_deg: float
    fov_deg: float | None = None


NUSCENES_VIEWS: Final[Mapping[str, ViewDirection]] = {
    "CAM_FRONT": ViewDirection(0.0, 65.0),
    "CAM_FRONT_RIGHT": ViewDirection(-55.0, 65.0),
    "CAM_FRONT_LEFT": ViewDirection(55.0, 65.0),
    "CAM_BACK": ViewDirection(180.0, 90.0),
    "CAM_BACK_LEFT": ViewDirection(110.0, 65.0),
    "CAM_BACK_RIGHT": ViewDirection(-110.0, 65.0),
}
_NAMES: Final[Mapping[str, Mapping[str, str]]] = {
    "nuscenes": {name: name for name in CAMERA_NAMES},
    "nuplan": {
        "CAM_F0": "CAM_FRONT",
        "CAM_R0": "CAM_FRONT_RIGHT",
        "CAM_L0": "CAM_FRONT_LEFT",
        "CAM_B0": "CAM_BACK",
        "CAM_L1": "CAM_BACK_LEFT",
        "CAM_R1": "CAM_BACK_RIGHT",
    },
    "argoverse2": {
        "ring_front_center": "CAM_FRONT",
        "ring_front_right": "CAM_FRONT_RIGHT",
        "ring_front_left": "CAM_FRONT_LEFT",
        "ring_rear_left": "CAM_BACK",
        "ring_side_left": "CAM_BACK_LEFT",
        "ring_side_right": "CAM_BACK_RIGHT",
    },
    "waymo": {
        "FRONT": "CAM_FRONT",
        "FRONT_RIGHT": "CAM_FRONT_RIGHT",
        "FRONT_LEFT": "CAM_FRONT_LEFT",
        "SIDE_LEFT": "CAM_BACK_LEFT",
        "SIDE_RIGHT": "CAM_BACK_RIGHT",
        "LEFT": "CAM_BACK_LEFT",
        "RIGHT": "CAM_BACK_RIGHT",
    },
}
_DIRECTIONS: Final[Mapping[str, Mapping[str, ViewDirection]]] = {
    "front": {"CAM_FRONT": NUSCENES_VIEWS["CAM_FRONT"]},
    "directions": NUSCENES_VIEWS,
}
READY: Final = (*_NAMES, *_DIRECTIONS)
"""Built-in rigs for ``--cameras``: by the names that a data set gives its cameras, or by where they look."""


@dataclass(frozen=True, slots=True)
class Rig:
    """Cameras of a car, and the views that they are.

    Attributes:
        where: What messages call it.
        names: View, or LIDAR_TOP, by a sensor's own name.
        directions: Where a view looks that no camera is named for.
        complete: Whether a data set must have every sensor that is named; ready rigs take those that there are.
        place: Of LIDAR_TOP in the ego frame where there is no lidar: ``x y z``, metres.
    """

    where: str
    names: Mapping[str, str] = field(default_factory=dict)
    directions: Mapping[str, ViewDirection] = field(default_factory=dict)
    complete: bool = False
    place: str | None = None


def read_rig(named: str) -> Rig:
    """Rig of ``--cameras``: one of `READY`, or a JSON file that `parse_rig` takes."""
    if named in READY:
        return Rig(f"the rig {named}", _NAMES.get(named, {}), _DIRECTIONS.get(named, {}))
    path = Path(named)
    if not path.is_file():
        raise InputError(
            f"--cameras {named!r} is no built-in rig or file; {did_you_mean(named, READY)}built in are "
            f"{', '.join(READY)}"
        )
    return parse_rig(read_json(path, SETTINGS), str(path))


def parse_rig(read: Any, where: str) -> Rig:
    """Rig from ``{"own name": "VIEW", "VIEW": {"yaw_deg": 180, "fov_deg": 90}}``, or from an object around it.

    The latter has it, or the name of a ready rig, as ``cameras``, and may have the place of the lidar's origin as
    ``lidar``. Raises `InputError` for anything else, an unknown view, and two cameras for one.
    """
    place = None
    if isinstance(read, dict) and {"cameras", "lidar"} & set(read):
        place = None if "lidar" not in read else _parse_place(read["lidar"], where)
        read = read.get("cameras", "")
        if isinstance(read, str):
            ready = read_rig(read) if read in READY else Rig(where) if not read else None
            if ready is None:
                raise InputError(f'{where}: "cameras" names the rig {read!r}; built in are {", ".join(READY)}')
            return Rig(ready.where, ready.names, ready.directions, ready.complete, place)
    if not isinstance(read, dict) or not read:
        raise InputError(
            f'{where} is not a JSON object of cameras; a rig is {{"own name": "CAM_FRONT", ...}} or '
            '{"CAM_FRONT": {"yaw_deg": 0, "fov_deg": 65}, ...}'
        )
    names = {own: view for own, view in read.items() if not isinstance(view, dict)}
    for own, view in names.items():
        if view not in (*CAMERA_NAMES, LIDAR_NAME):
            raise InputError(
                f"{where} maps {own!r} to {view!r}; views are {', '.join(CAMERA_NAMES)}, and {LIDAR_NAME} of a lidar"
            )
    directions = {view: _parse_direction(view, of, where) for view, of in read.items() if isinstance(of, dict)}
    views = [*names.values(), *directions]
    if twice := next((view for view in views if views.count(view) > 1), None):
        both = [own for own, view in names.items() if view == twice] + ["a direction"] * (twice in directions)
        raise InputError(f"{where} has two cameras for {twice}: {' and '.join(both[:2])}; leave one out")
    return Rig(where, names, directions, complete=True, place=place)


def _parse_direction(view: str, of: Mapping[str, Any], where: str) -> ViewDirection:
    if view not in CAMERA_NAMES:
        raise InputError(f"{where} gives a direction for {view!r}; views are {', '.join(CAMERA_NAMES)}")
    numbers = [of.get("yaw_deg"), of.get("fov_deg", 90.0)]
    yaw, fov = (float(n) if isinstance(n, int | float) and not isinstance(n, bool) else math.nan for n in numbers)
    if set(of) - {"yaw_deg", "fov_deg"} or not (abs(yaw) <= 360.0 and 0.0 < fov < 360.0):
        raise InputError(
            f'{where}: {view} must be {{"yaw_deg": number, "fov_deg": number}} in degrees, to the left positive; the '
            "field of view may be left out"
        )
    return ViewDirection(yaw, fov if "fov_deg" in of else None)


def _parse_place(value: Any, where: str) -> str:
    numbers = value if isinstance(value, list) else []
    sound = [n for n in numbers if isinstance(n, int | float) and not isinstance(n, bool) and abs(n) <= _HIGHEST_M]
    if len(numbers) != 3 or len(sound) != 3:
        raise InputError(
            f'{where}: "lidar" must be the x, y and z of its origin in the ego frame, metres within {_HIGHEST_M:g}, '
            "such as [0.94, 0, 1.84]"
        )
    return " ".join(repr(float(number)) for number in sound)


@dataclass(frozen=True, slots=True)
class _OwnCamera:
    name: str
    yaw_deg: float
    fov_deg: float


def choose_views(rig: Rig, tables: Tables) -> dict[str, str]:
    """Views, and LIDAR_TOP, by the names of a data set's sensors.

    Names are looked up without regard to case. Directions are given one to one, so that the sum of the squared
    differences is least, none above 40 degrees.

    Args:
        rig: The rig.
        tables: ``sensor`` and ``calibrated_sensor``.

    Raises:
        InputError: If a sensor that must be there is not, two would be one view, or none is any.
    """
    # Writers name sensors, too, that no car of theirs has.
    mounted = {row["sensor_token"] for row in tables["calibrated_sensor"]}
    modality = {str(row["channel"]): str(row["modality"]) for row in tables["sensor"] if row["token"] in mounted}
    cameras = [name for name, kind in modality.items() if kind == "camera"]
    if not rig.names and not rig.directions:
        return {}
    wanted = {name.casefold(): view for name, view in rig.names.items()}
    chosen = {name: wanted[name.casefold()] for name in modality if name.casefold() in wanted}
    there = f"the data set has {', '.join(sorted(cameras)) or 'no camera'}"
    absent = [name for name in rig.names if name.casefold() not in {own.casefold() for own in modality}]
    if rig.complete and absent:
        raise InputError(f"{rig.where} names {absent[0]}, which is no sensor here: {there}; correct the name")
    for name, view in chosen.items():
        if (modality[name] == "lidar") != (view == LIDAR_NAME):
            raise InputError(f"{rig.where} makes {name} {view}, but it is a {modality[name]}; correct the view")
        if view == LIDAR_NAME:
            _require_ahead(name, tables)
    free = [_find_direction(name, tables) for name in cameras if name not in chosen] if rig.directions else []
    chosen |= _assign(free, {view: at for view, at in rig.directions.items() if view not in chosen.values()})
    if not chosen:
        raise InputError(f"{rig.where} fits no camera: {there}; use --cameras directions or a JSON file of their names")
    _require_one_each(chosen, modality, rig.where)
    return chosen


def _require_one_each(chosen: Mapping[str, str], modality: Mapping[str, str], where: str) -> None:
    """Refuse two sensors of one name, those that keep their own included."""
    meant: dict[str, list[str]] = {}
    for name in modality:
        meant.setdefault(chosen.get(name, name), []).append(name)
    if twice := next((view for view, names in meant.items() if len(names) > 1), None):
        raise InputError(
            f"{where}: two sensors would be {twice}, {' and '.join(sorted(meant[twice])[:2])}; say in a JSON file "
            "which one is"
        )


def _assign(cameras: Sequence[_OwnCamera], views: Mapping[str, ViewDirection]) -> dict[str, str]:
    """Views by camera; the least sum of squared differences, of as many as there can be."""
    if not cameras or not views:
        return {}
    ordered = sorted(cameras, key=lambda camera: camera.name)
    costs = np.array([[_differ(camera, at) for at in views.values()] for camera in ordered])
    # A pair that cannot be costs more than all others together, and is left out afterwards.
    chosen = zip(*linear_sum_assignment(np.where(np.isfinite(costs), costs, 1e6)), strict=True)
    return {ordered[row].name: [*views][column] for row, column in chosen if math.isfinite(costs[row, column])}


def _differ(camera: _OwnCamera, view: ViewDirection) -> float:
    away = abs(turn_between(camera.yaw_deg, view.yaw_deg))
    if away > FARTHEST_DEG:
        return math.inf
    wider = 0.0 if view.fov_deg is None else (camera.fov_deg - view.fov_deg) / _DEGREES_OF_VIEW
    return float(away**2 + wider**2)


def _find_direction(name: str, tables: Tables) -> _OwnCamera:
    """Where a camera looks, by its calibrations; those of different logs must not differ by more than a view may."""
    looks = [(*find_angles(row["rotation"]), row["camera_intrinsic"]) for row in _calibrations(name, tables)]
    if len(looks[0][2]) != 3:
        raise InputError(f"{name} has no intrinsics to tell its view by; say in a JSON file which one it is")
    yaw, _, intrinsic = looks[0]
    if any(abs(turn_between(other, yaw)) > FARTHEST_DEG for other, *_ in looks):
        raise InputError(f"{name} looks in different directions in different logs; say in a JSON file which view it is")
    # The principal point is about the centre of the picture.
    fov = 2.0 * math.degrees(math.atan2(float(intrinsic[0][2]), float(intrinsic[0][0])))
    return _OwnCamera(name, yaw, fov)


def _require_ahead(name: str, tables: Tables) -> None:
    for row in _calibrations(name, tables):
        if rotation_matrix(np.array(row["rotation"], np.float64))[0, 1] < math.cos(math.radians(FARTHEST_DEG)):
            raise InputError(
                f"{name} cannot be {LIDAR_NAME}, whose y axis points ahead: plans would be turned; leave it out and "
                'say where it sits with "lidar": [x, y, z]'
            )


def _calibrations(name: str, tables: Tables) -> list[Row]:
    tokens = {row["token"] for row in tables["sensor"] if row["channel"] == name}
    return [row for row in tables["calibrated_sensor"] if row["sensor_token"] in tokens]


def find_angles(rotation: Sequence[float] | Floats) -> tuple[float, float]:
    """Heading (to the left positive) and pitch (upwards positive) of an optical axis, degrees, from its quaternion."""
    x, y, z = rotation_matrix(np.array(rotation, np.float64))[:, 2].tolist()
    return math.degrees(math.atan2(y, x)), math.degrees(math.asin(max(-1.0, min(1.0, z))))


def turn_between(yaw_deg: float, from_deg: float) -> float:
    """The turn from one heading to another, degrees from -180 to 180."""
    return (yaw_deg - from_deg + 180.0) % 360.0 - 180.0


def name_missing_views(names: CategoryNames) -> list[str]:
    """Sentence on the views that no sensor of a mapping is; none where all six are there."""
    there = {to for own, to in names if own.startswith(SENSOR)}
    missing = [view for view in CAMERA_NAMES if view not in there]
    if not missing:
        return []
    return [f"no camera is {', '.join(missing)}: planners that need all six views are refused"]
