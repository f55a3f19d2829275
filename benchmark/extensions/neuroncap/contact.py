"""Collision check of NeuroNCAP's code: the first actor in the list whose box meets the ego's; and NeuroNCAP's car."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
import shapely

from benchmark.constants import (
    EGO_BOX_FROM_LIDAR_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    EGO_WHEELBASE_M,
    EGO_WIDTH_M,
)
from benchmark.extensions.neuroncap.actors import FURTHER_VEHICLES, HIT_CLASSES, Actor, compute_heading
from benchmark.geometry import Floats, box_corners, boxes_overlap
from benchmark.pdm.definition import COMFORT_CENTER_AHEAD_M, WHEELBASE_M
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

SLIPPED_LENGTH_M: Final = 4.018
"""Of the ego's box in the published code: a slip of digits."""


@dataclass(frozen=True, slots=True)
class NeuroncapCar:
    """Numbers of the car; `wheelbase_m` is of tracker and bicycle, length and width of the box of contact.

    `centre_ahead_m` of the rear axle is for the motion that is reported, `box_ahead_m` for the box of contact.
    """

    wheelbase_m: float
    centre_ahead_m: float
    box_ahead_m: float
    length_m: float
    width_m: float

    @classmethod
    def of(cls, switches: NeuroncapSwitches) -> Self:
        """The car of a reading."""
        as_code = switches.vehicle == "code"
        rounded = switches.ego_length == "code"
        return cls(
            wheelbase_m=WHEELBASE_M if as_code else EGO_WHEELBASE_M,
            centre_ahead_m=COMFORT_CENTER_AHEAD_M if as_code else EGO_CENTER_FROM_REAR_AXLE_M,
            box_ahead_m=EGO_BOX_FROM_LIDAR_M if switches.box_centre == "code" else EGO_CENTER_FROM_REAR_AXLE_M,
            length_m=float(np.float32(SLIPPED_LENGTH_M)) if rounded else EGO_LENGTH_M,
            width_m=float(np.float32(EGO_WIDTH_M)) if rounded else EGO_WIDTH_M,
        )


_ROOM_M: Final = 1.0
"""That the search radius has beyond the diagonals of both boxes."""


@dataclass(frozen=True, slots=True)
class EgoMoment:
    """Ego at one instant: (4, 4) rear axle to global, m/s along the heading."""

    time_us: int
    pose: Floats
    speed: float


@dataclass(frozen=True, slots=True)
class NeuroncapContact:
    """First touch of a run; `index` is the actor's in the engine's list, velocities are (3,) m/s.

    `iou` is the shared area of the two boxes over their joint area.
    """

    index: int
    uuid: str
    time_us: int
    iou: float
    ego_velocity: Floats
    actor_velocity: Floats
    is_target: bool

    def impact_speed(self, switches: NeuroncapSwitches) -> float:
        """Size of the difference of velocities, m/s; with ``impact_norm`` as paper in the plane."""
        difference = self.ego_velocity - self.actor_velocity
        return float(np.linalg.norm(difference if switches.impact_norm == "code" else difference[:2]))


def compute_box(pose: Floats, length: float, width: float, ahead: float = 0.0) -> Floats:
    """(5,) box of a (4, 4) pose, its centre so far ahead of it."""
    centre = pose[:2, 3] + ahead * pose[:2, 0]
    return np.array([*centre, length, width, compute_heading(pose)])


def can_be_hit(kind: str, switches: NeuroncapSwitches) -> bool:
    """Whether actors of a class count."""
    return kind in HIT_CLASSES or (switches.classes == "paper" and kind in FURTHER_VEHICLES)


def find_contact(
    ego: EgoMoment, actors: Sequence[Actor], car: NeuroncapCar, switches: NeuroncapSwitches
) -> NeuroncapContact | None:
    """The first actor of the list, in the engine's order, that the ego's box meets; touching counts."""
    own = compute_box(ego.pose, car.length_m, car.width_m, car.box_ahead_m)
    for index, actor in enumerate(actors):
        if not can_be_hit(actor.kind, switches) or not actor.is_there(ego.time_us):
            continue
        if switches.contact_prefilter == "code" and _is_far(ego, actor, car):
            continue
        width, length = actor.size[:2].tolist()
        other = compute_box(actor.pose_at(ego.time_us), length, width)
        if bool(boxes_overlap(own, other)):
            return NeuroncapContact(
                index=index,
                uuid=actor.uuid,
                time_us=ego.time_us,
                iou=_compute_iou(own, other),
                ego_velocity=ego.pose[:3, 0] * ego.speed,
                actor_velocity=actor.velocity_at(ego.time_us),
                is_target=actor.is_target,
            )
    return None


def _is_far(ego: EgoMoment, actor: Actor, car: NeuroncapCar) -> bool:
    """Whether the published code leaves an actor out: by distance from the rear axle in space."""
    reach = 0.5 * np.hypot(car.length_m, car.width_m) + 0.5 * np.linalg.norm(actor.size) + _ROOM_M
    return bool(np.linalg.norm(actor.position_at(ego.time_us) - ego.pose[:3, 3]) > reach)


def _compute_iou(first: Floats, second: Floats) -> float:
    one, other = shapely.polygons(box_corners(np.stack([first, second])))
    shared = shapely.area(shapely.intersection(one, other))
    return float(shared / (shapely.area(one) + shapely.area(other) - shared))
