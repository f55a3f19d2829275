"""The lane graph of a town: first its junctions and the roads that join them, then lanes, while built and when done."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.road_map import Divider, Lane, RoadMap
from generation.sources.town.curves import build_turn

CANVAS_M = 560.0
_NODE_REACH_M = 170.0
_EXIT_REACH_M = 262.0
_STATION_M = 2.0

EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, np.pi, -np.pi / 2


class TownNodeKind(StrEnum):
    """Kind of a node of the road graph."""

    CROSSING = "crossing"
    ROUNDABOUT = "roundabout"
    EXIT = "exit"
    CAR_PARK = "car-park"


@dataclass(frozen=True, slots=True)
class TownNode:
    """A place where roads meet or end, (2,) metres; its name is unique in the town."""

    name: str
    kind: TownNodeKind
    position: Floats


@dataclass(frozen=True, slots=True)
class TownRoad:
    """A road between two nodes with a parking strip on both sides or none; ``lanes`` are per direction.

    ``reference`` (M, 2) lies between the directions; ``speed_mps`` is the usual speed of traffic.
    """

    name: str
    ends: tuple[str, str]
    reference: Floats
    lanes: int
    kerb_parking: bool
    speed_mps: float


@dataclass(frozen=True, slots=True)
class TownLayout:
    """Nodes and roads of one town, by name."""

    nodes: dict[str, TownNode]
    roads: dict[str, TownRoad]


@dataclass(frozen=True, slots=True)
class _RoadPlan:
    first: str
    first_heading: float
    last: str
    last_heading: float
    lanes: int
    parking: bool
    speed_mps: float


_OUTER = (("N", WEST, "W", NORTH), ("W", SOUTH, "S", WEST), ("S", EAST, "E", SOUTH), ("E", NORTH, "N", EAST))
_AVENUE_ROADS = (
    _RoadPlan("N", NORTH, "XN", SOUTH, 2, False, 13.0),
    _RoadPlan("N", SOUTH, "C", NORTH, 2, False, 13.0),
    _RoadPlan("C", SOUTH, "S", NORTH, 2, False, 13.0),
    _RoadPlan("S", SOUTH, "XS", NORTH, 2, False, 13.0),
    _RoadPlan("W", EAST, "P", WEST, 1, True, 10.0),
    _RoadPlan("P", EAST, "C", WEST, 1, False, 10.0),
    _RoadPlan("C", EAST, "E", WEST, 1, True, 10.0),
    _RoadPlan("E", EAST, "XE", WEST, 1, False, 11.0),
    _RoadPlan("P", SOUTH, "K", NORTH, 1, False, 6.0),
    *(_RoadPlan(*ends, 1, index != 2, 11.0) for index, ends in enumerate(_OUTER)),
)
_RING_ROADS = (
    _RoadPlan("N", NORTH, "XN", SOUTH, 1, False, 11.0),
    _RoadPlan("N", SOUTH, "C", NORTH, 1, True, 10.0),
    _RoadPlan("C", SOUTH, "S", NORTH, 1, True, 10.0),
    _RoadPlan("S", SOUTH, "XS", NORTH, 1, False, 11.0),
    _RoadPlan("W", EAST, "P", WEST, 1, True, 10.0),
    _RoadPlan("P", EAST, "C", WEST, 1, False, 10.0),
    _RoadPlan("C", EAST, "E", WEST, 1, True, 10.0),
    _RoadPlan("P", SOUTH, "K", NORTH, 1, False, 6.0),
    *(_RoadPlan(*ends, 2, index % 2 == 0, 13.0) for index, ends in enumerate(_OUTER)),
)
PLANS = ("avenue", "ring")


def make_layout(plan: str, rng: np.random.Generator) -> TownLayout:
    """Draw one town's road graph, all coordinates between 0 and `CANVAS_M`. ``plan`` is ``avenue`` or ``ring``."""
    road_plans = _AVENUE_ROADS if plan == "avenue" else _RING_ROADS
    kinds = dict.fromkeys(("C", "N", "S", "W", "E", "P"), TownNodeKind.CROSSING)
    kinds["E" if plan == "avenue" else "C"] = TownNodeKind.ROUNDABOUT
    kinds |= {"K": TownNodeKind.CAR_PARK, "XN": TownNodeKind.EXIT, "XS": TownNodeKind.EXIT}
    if plan == "avenue":
        kinds["XE"] = TownNodeKind.EXIT
    places = _draw_node_positions(rng)
    turned = float(rng.integers(4)) * np.pi / 2 + float(rng.uniform(-0.17, 0.17))
    spin = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])

    def place(local: Floats) -> Floats:
        x, y = local[..., 0], local[..., 1]
        spun = np.stack([spin[0, 0] * x + spin[0, 1] * y, spin[1, 0] * x + spin[1, 1] * y], axis=-1)
        return np.asarray(spun + CANVAS_M / 2)

    nodes = {name: TownNode(name, kind, place(places[name])) for name, kind in kinds.items()}
    roads = {}
    for road in road_plans:
        line = build_turn(
            places[road.first],
            road.first_heading,
            places[road.last],
            road.last_heading + np.pi,
            step_m=_STATION_M,
            max_radius_m=float(rng.uniform(70.0, 95.0)),
        )
        name = f"{road.first}-{road.last}"
        roads[name] = TownRoad(name, (road.first, road.last), place(line), road.lanes, road.parking, road.speed_mps)
    return TownLayout(nodes, roads)


def _draw_node_positions(rng: np.random.Generator) -> dict[str, Floats]:
    """Local positions of all possible nodes, (2,) each."""
    reach = _NODE_REACH_M
    shift = {name: rng.uniform(-9.0, 9.0, 2) for name in ("C", "N", "S", "W", "E")}
    places = {
        "C": shift["C"],
        "N": np.array([0.0, reach]) + shift["N"],
        "S": np.array([0.0, -reach]) + shift["S"],
        "W": np.array([-reach, 0.0]) + shift["W"],
        "E": np.array([reach, 0.0]) + shift["E"],
    }
    places["P"] = np.array([0.5 * (places["W"][0] + places["C"][0]), 0.5 * (places["W"][1] + places["C"][1])])
    places["K"] = places["P"] + np.array([0.0, -float(rng.uniform(34.0, 42.0))])
    places["XN"] = np.array([places["N"][0], _EXIT_REACH_M])
    places["XS"] = np.array([places["S"][0], -_EXIT_REACH_M])
    places["XE"] = np.array([_EXIT_REACH_M, places["E"][1]])
    return places


LANE_WIDTH_M = 3.5
PARKING_WIDTH_M = 2.5
WALKWAY_WIDTH_M = 2.6


class LaneRole(StrEnum):
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
    """One lane as traffic sees it: (M, 2) ``line`` in driving direction; names are those in the road map.

    ``road`` is the node's name inside junctions; ``index`` is 0 next to the opposite direction. ``siblings`` are all
    lanes of its direction by ``index``; stations correspond.
    """

    name: str
    line: Floats
    role: LaneRole
    road: str
    index: int
    siblings: tuple[str, ...]
    speed_mps: float
    polygon: Polygon | None


@dataclass(frozen=True, slots=True)
class JunctionArm:
    """A road where it meets a node: ``heading`` leads away, radians; lanes are named from the middle outwards."""

    road: str
    heading: float
    incoming: tuple[str, ...]
    outgoing: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ParkingPlace:
    """Pose, (3,) x, y, yaw, of the box centre of a parked object, in a car park or on a strip at the kerb."""

    pose: Floats
    in_car_park: bool


@dataclass(slots=True)
class TownDraft:
    """Everything that the builders of roads and junctions add to; identifiers of the map begin with ``prefix``.

    ``links`` are pairs of lanes that follow each other, ``junctions`` names in ``surfaces``. ``crossing_walks`` are (2,
    2) walking lines from kerb to kerb, ``walks`` (M, 2) lines along the pavements; ``green`` are traffic islands, kept
    free of pavement.
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
    standing: list[ParkingPlace] = field(default_factory=list)
    green: list[Polygon] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Town:
    """A finished town; names of the lanes before and after each lane are sorted.

    ``crossing_walks`` are (2, 2) lines across the crossings, ``walks`` (M, 2) along the pavements, 1 m spacing.
    ``signals`` are, of each lane that ends at traffic lights, the junction and which of its two phases is the lane's.
    Traffic keeps to the right here; ``shown_map`` is the map of the scenes: the same, or its mirror image.
    """

    layout: TownLayout
    road_map: RoadMap
    shown_map: RoadMap
    signals: dict[str, tuple[str, int]]
    lanes: dict[str, TownLane]
    successors: dict[str, tuple[str, ...]]
    predecessors: dict[str, tuple[str, ...]]
    crossing_walks: tuple[Floats, ...]
    walks: tuple[Floats, ...]
    standing: tuple[ParkingPlace, ...]


def find_signals(layout: TownLayout, arms: dict[str, list[JunctionArm]]) -> dict[str, tuple[str, int]]:
    """Junction and phase of each lane that ends at traffic lights; roads that go on in each other share a phase.

    Roundabouts have none, nor has the way into a car park.
    """
    signals: dict[str, tuple[str, int]] = {}
    for node in layout.nodes.values():
        roads = [arm.road for arm in arms[node.name]]
        if node.kind is TownNodeKind.CROSSING and all(layout.roads[road].speed_mps >= 8.0 for road in roads):
            for arm in arms[node.name]:
                turned = abs(float(np.sin(arm.heading - arms[node.name][0].heading)))
                signals |= {lane: (node.name, int(turned > np.sin(np.pi / 4))) for lane in arm.incoming}
    return signals


def build_strip(right: Floats, left: Floats) -> Polygon:
    """Surface between two sides, (M, 2) each in the same direction."""
    return Polygon(np.concatenate([right, left[::-1]]))


def find_linked_lanes(draft: TownDraft, end: int) -> dict[str, tuple[str, ...]]:
    """Names of the lanes after (``end`` 0) or before (1) each lane, sorted."""
    linked: dict[str, list[str]] = {name: [] for name in draft.lanes}
    for link in draft.links:
        linked[link[end]].append(link[1 - end])
    return {name: tuple(sorted(others)) for name, others in linked.items()}


def build_map_lanes(draft: TownDraft) -> dict[str, Lane]:
    """The lanes as the road map holds them, connected both ways; connectors have no polygon, as in nuScenes."""
    after, before = find_linked_lanes(draft, 0), find_linked_lanes(draft, 1)
    lanes = {}
    for name, lane in draft.lanes.items():
        connector = lane.role not in (LaneRole.ROAD, LaneRole.RING, LaneRole.CAR_PARK)
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
