"""The lane graph of a town while it is built and when it is done."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.road_map import Divider, Lane, RoadMap
from generation.sources.town.layout import Layout

LANE_WIDTH_M = 3.5
PARKING_WIDTH_M = 2.5
WALKWAY_WIDTH_M = 2.6


class Role(StrEnum):
    """Purpose of a lane."""

    ROAD = "road"
    STRAIGHT = "straight"
    LEFT = "left"
    RIGHT = "right"
    RING_ENTRY = "ring-entry"
    RING = "ring"
    RING_EXIT = "ring-exit"
    CAR_PARK = "car-park"


@dataclass(frozen=True, slots=True)
class TownLane:
    """One lane with what traffic needs to know.

    Attributes:
        name: Identifier, the same as in the road map.
        line: (M, 2) centreline in driving direction.
        road: Name of its road, or of its node inside junctions.
        index: 0 next to the opposite direction.
        siblings: Names of all lanes of its direction by ``index``; stations correspond.
    """

    name: str
    line: Floats
    role: Role
    road: str
    index: int
    siblings: tuple[str, ...]
    speed_mps: float
    polygon: Polygon | None


@dataclass(frozen=True, slots=True)
class Arm:
    """A road where it meets a node.

    ``heading`` points away from the node, radians; lanes are named from the middle outwards.
    """

    road: str
    heading: float
    incoming: tuple[str, ...]
    outgoing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StandingPlace:
    """Pose of the box centre, (3,) x, y, yaw, where something can be parked.

    It is a bay of a car park, or else a strip at the kerb.
    """

    pose: Floats
    in_car_park: bool


@dataclass(slots=True)
class Draft:
    """Everything that the builders of roads and junctions add to.

    Attributes:
        prefix: Put before identifiers of the map.
        links: Pairs of lanes that follow each other.
        junctions: Names in ``surfaces`` that are junctions.
        crossing_walks: (2, 2) walking lines across the crossings, from kerb to kerb.
        walks: (M, 2) lines along the pavements.
        green: Traffic islands, kept free of pavement.
    """

    prefix: str
    lanes: dict[str, TownLane] = field(default_factory=dict)
    links: list[tuple[str, str]] = field(default_factory=list)
    surfaces: dict[str, Polygon] = field(default_factory=dict)
    junctions: list[str] = field(default_factory=list)
    dividers: list[Divider] = field(default_factory=list)
    crossings: dict[str, Polygon] = field(default_factory=dict)
    crossing_walks: list[Floats] = field(default_factory=list)
    stop_lines: dict[str, Polygon] = field(default_factory=dict)
    car_parks: dict[str, Polygon] = field(default_factory=dict)
    walks: list[Floats] = field(default_factory=list)
    standing: list[StandingPlace] = field(default_factory=list)
    green: list[Polygon] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Town:
    """A finished town.

    Attributes:
        successors: Names of the lanes after each lane, sorted.
        predecessors: Names of the lanes before each lane, sorted.
        crossing_walks: (2, 2) walking lines across the pedestrian crossings.
        walks: (M, 2) lines along the pavements, 1 m spacing.
    """

    layout: Layout
    road_map: RoadMap
    lanes: dict[str, TownLane]
    successors: dict[str, tuple[str, ...]]
    predecessors: dict[str, tuple[str, ...]]
    crossing_walks: tuple[Floats, ...]
    walks: tuple[Floats, ...]
    standing: tuple[StandingPlace, ...]


def strip(right: Floats, left: Floats) -> Polygon:
    """Surface between two sides, (M, 2) each in the same direction."""
    return Polygon(np.concatenate([right, left[::-1]]))


def linked_lanes(draft: Draft, end: int) -> dict[str, tuple[str, ...]]:
    """Names of the lanes after (``end`` 0) or before (1) each lane, sorted."""
    found: dict[str, list[str]] = {name: [] for name in draft.lanes}
    for link in draft.links:
        found[link[end]].append(link[1 - end])
    return {name: tuple(sorted(others)) for name, others in found.items()}


def map_lanes(draft: Draft) -> dict[str, Lane]:
    """The lanes as the road map holds them, connected both ways; connectors have no polygon, as in nuScenes."""
    after, before = linked_lanes(draft, 0), linked_lanes(draft, 1)
    lanes = {}
    for name, lane in draft.lanes.items():
        connector = lane.role not in (Role.ROAD, Role.RING, Role.CAR_PARK)
        identifier = draft.prefix + name
        lanes[identifier] = Lane(
            identifier,
            lane.line,
            None if connector else lane.polygon,
            tuple(draft.prefix + other for other in after[name]),
            tuple(draft.prefix + other for other in before[name]),
            connector,
        )
    return lanes
