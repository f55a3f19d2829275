"""Contacts of the ego with another: kind, who is to blame, how hard; and the time that is left before one.

``docs/severity.md``, "A pair at one instant". Kinds and blame are nuPlan's. Ego velocities are speed times heading;
objects that are not agents stand.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.geometry import Bools, Floats, box_gap, boxes_overlap
from benchmark.interactions.tracks import Integers

EGO_MASS_KG: Final = 1600.0
_MASSES_KG: Final = {
    "vehicle.car": 1800.0,
    "vehicle.emergency.police": 1800.0,
    "vehicle.truck": 12000.0,
    "vehicle.construction": 12000.0,
    "vehicle.bus.rigid": 14000.0,
    "vehicle.bus.bendy": 18000.0,
    "vehicle.trailer": 10000.0,
    "vehicle.emergency.ambulance": 3500.0,
    "vehicle.motorcycle": 250.0,
    "vehicle.bicycle": 90.0,
}
_PERSON_KG: Final = 75.0
_OTHER_KG: Final = 1600.0
FATAL_M_S: Final = 31.74
"""Change of velocity at which a crash is surely fatal for those inside (Joksch 1993: 71 miles an hour)."""
STOPPED_M_S: Final = 0.05
AHEAD_RAD: Final = np.deg2rad(30.0)
BEHIND_RAD: Final = np.deg2rad(150.0)
_STANDING_M_S: Final = 0.005
_STEPS_AHEAD_S: Final = 0.1 * np.arange(1, 30)
_NOT_AGENTS: Final = ("movable_object.", "static_object.")


class ContactKind(StrEnum):
    """Kind of a contact between the ego and another road user."""

    STOPPED_EGO = "stopped_ego"
    STOPPED_TRACK = "stopped_track"
    FRONT = "front"
    REAR = "rear"
    LATERAL = "lateral"


KINDS: Final = tuple(ContactKind)
STOPPED_EGO, STOPPED_TRACK, FRONT, REAR, LATERAL = range(len(KINDS))
"""Kinds as numbers."""
NOT_AT_FAULT_KINDS: Final = (STOPPED_EGO, REAR)
"""Kinds that are never the ego's fault; another may be."""


@dataclass(frozen=True, slots=True)
class ContactPairs:
    """P pairs of an ego and another, each at one instant: (P, 5) boxes, (P,) ego speed along its heading in m/s.

    ``other_velocity`` is (P, 2), m/s; use `moving` for objects that are no agents. ``is_agent`` is (P,).
    """

    ego: Floats
    ego_speed: Floats
    other: Floats
    other_velocity: Floats
    is_agent: Bools

    @property
    def ego_velocity(self) -> Floats:
        """(P, 2) m/s."""
        yaw = self.ego[:, 4]
        return np.asarray(self.ego_speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]))

    @property
    def moving(self) -> Floats:
        """(P, 2) velocity of the other, zero for what is no agent."""
        return np.where(self.is_agent[:, None], self.other_velocity, 0.0)

    @property
    def other_speed(self) -> Floats:
        """(P,) m/s."""
        return np.asarray(np.hypot(*self.moving.T))

    @property
    def impact_speed(self) -> Floats:
        """(P,) size of the difference of velocities, m/s."""
        return np.asarray(np.hypot(*(self.ego_velocity - self.moving).T))

    @property
    def gap(self) -> Floats:
        """(P,) distance of the rectangles, metres; 0 in contact."""
        return box_gap(self.ego, self.other)

    @property
    def kinds(self) -> Integers:
        """(P,) indices into `KINDS`."""
        return classify_contacts(self.ego, self.ego_speed, self.other, self.other_speed, self.is_agent)

    @property
    def time_to_contact(self) -> Floats:
        """(P,) seconds until the rectangles touch if both keep velocity and heading; infinite if they never do."""
        return compute_time_to_contact(self.ego, self.ego_velocity, self.other, self.moving)

    @property
    def time_to_contact_nuplan(self) -> Floats:
        """(P,) ``ttc_nuplan@code``: 0.1 to 2.9 s in steps, the other moved along its heading; else infinite."""
        heading = np.column_stack([np.cos(self.other[:, 4]), np.sin(self.other[:, 4])])
        ego, other = (np.repeat(boxes[:, None], len(_STEPS_AHEAD_S), axis=1) for boxes in (self.ego, self.other))
        ego[..., :2] += _STEPS_AHEAD_S[:, None] * self.ego_velocity[:, None]
        other[..., :2] += _STEPS_AHEAD_S[:, None] * (self.other_speed[:, None] * heading)[:, None]
        touching = boxes_overlap(ego, other) & (self.ego_speed > _STANDING_M_S)[:, None]
        return np.where(touching.any(axis=1), _STEPS_AHEAD_S[touching.argmax(axis=1)], np.inf)

    @property
    def delta_v_nuplan(self) -> Floats:
        """(P,) ``delta_v_nuplan@code``: equal masses, and sizes of velocities along the headings."""
        first, second = np.abs(self.ego_speed), self.other_speed
        turn = self.ego[:, 4] - self.other[:, 4]
        squared = first**2 + second**2 - 2 * first * second * np.cos(turn)
        return np.asarray(0.5 * np.sqrt(np.maximum(squared, 0.0)))


def is_agent_category(category: str) -> bool:
    """Whether objects of a category move by themselves."""
    return not category.startswith(_NOT_AGENTS)


def mass_kg(category: str) -> float:
    """Mass that is assumed of an object of a category."""
    return _PERSON_KG if category.startswith("human.") else _MASSES_KG.get(category, _OTHER_KG)


def compute_delta_v(impact_speed: Floats, other_kg: Floats) -> tuple[Floats, Floats]:
    """Changes of velocity of the ego and of the other, of ``other_kg``, in a plastic impact, m/s."""
    total = other_kg + EGO_MASS_KG
    return np.asarray(other_kg / total * impact_speed), np.asarray(EGO_MASS_KG / total * impact_speed)


def compute_fatal_probability(delta_v_m_s: Floats) -> Floats:
    """Probability that an occupant dies, by the fourth power of the change of velocity (Joksch 1993)."""
    return np.minimum((delta_v_m_s / FATAL_M_S) ** 4, 1.0)


def classify_contacts(ego: Floats, ego_speed: Floats, other: Floats, other_speed: Floats, agents: Bools) -> Integers:
    """Indices into `KINDS`, whether the rectangles touch or not; ``agents`` are others that move by themselves."""
    front = ego.copy()
    front[..., 0] += 0.5 * ego[..., 2] * np.cos(ego[..., 4])
    front[..., 1] += 0.5 * ego[..., 2] * np.sin(ego[..., 4])
    front[..., 2] = 0.0
    conditions = [
        ego_speed <= STOPPED_M_S,
        ~agents | (other_speed <= STOPPED_M_S),
        compute_bearing(ego, other) > BEHIND_RAD,
        boxes_overlap(front, other),
    ]
    return np.select(conditions, [STOPPED_EGO, STOPPED_TRACK, REAR, FRONT], LATERAL)


def compute_bearing(ego: Floats, other: Floats) -> Floats:
    """Angle from the ego's heading to the direction from its rear axle to another's centre, 0 ahead to pi behind."""
    cos, sin = np.cos(ego[..., 4]), np.sin(ego[..., 4])
    offset = other[..., :2] - ego[..., :2]
    along = offset[..., 0] * cos + offset[..., 1] * sin + EGO_CENTER_FROM_REAR_AXLE_M
    across = offset[..., 1] * cos - offset[..., 0] * sin
    return np.asarray(np.arctan2(np.abs(across), along))


def is_at_fault(kind: ContactKind, unsure: bool) -> bool:
    """Whether the ego is to blame for a first contact.

    ``unsure`` is the ego in several lanes or off the drivable area: then a lateral contact is its fault too.
    """
    return kind in (ContactKind.FRONT, ContactKind.STOPPED_TRACK) or (kind is ContactKind.LATERAL and unsure)


def compute_time_to_contact(first: Floats, first_velocity: Floats, second: Floats, second_velocity: Floats) -> Floats:
    """Seconds until (..., 5) boxes first touch if both keep velocity and heading, infinite if they never do.

    Along each of the four edge normals their projections overlap for a while; they touch while all four do.
    """
    offset, velocity = second[..., :2] - first[..., :2], second_velocity - first_velocity
    turn = second[..., 4] - first[..., 4]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    enter, leave = np.zeros(turn.shape), np.full(turn.shape, np.inf)
    for own, other in ((first, second), (second, first)):
        axis_cos, axis_sin = np.cos(own[..., 4]), np.sin(own[..., 4])
        reaches = (
            0.5 * (own[..., 2] + other[..., 2] * cos + other[..., 3] * sin),
            0.5 * (own[..., 3] + other[..., 2] * sin + other[..., 3] * cos),
        )
        for axis, reach in enumerate(reaches):
            x, y = (axis_cos, axis_sin) if axis == 0 else (-axis_sin, axis_cos)
            away = offset[..., 0] * x + offset[..., 1] * y
            rate = velocity[..., 0] * x + velocity[..., 1] * y
            low, high = _solve_interval(away, rate, reach)
            enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    return np.where(enter <= leave, enter, np.inf)


def _solve_interval(away: Floats, rate: Floats, reach: Floats) -> tuple[Floats, Floats]:
    """When ``abs(away + rate t) <= reach``: from and to; an empty interval ends at minus infinity."""
    still = rate == 0.0
    safe = np.where(still, 1.0, rate)
    with np.errstate(over="ignore"):
        first, second = (-reach - away) / safe, (reach - away) / safe
    inside = np.abs(away) <= reach
    low = np.where(still, -np.inf, np.minimum(first, second))
    high = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(first, second))
    return low, high
