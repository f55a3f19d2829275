"""Where the junctions of a town are and which roads join them, before anything has a width.

Local frame: the town's centre is the origin. Two plans exist: ``avenue`` (a four-lane avenue through a crossing, a
roundabout at one side) and ``ring`` (a four-lane ring road around a central roundabout).
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from benchmark.geometry import Floats
from generation.sources.town.curves import turn

CANVAS_M = 560.0
_NODE_REACH_M = 170.0
_EXIT_REACH_M = 262.0
_STATION_M = 2.0

EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, np.pi, -np.pi / 2


class NodeKind(StrEnum):
    """Kind of a node of the road graph."""

    CROSSING = "crossing"
    ROUNDABOUT = "roundabout"
    EXIT = "exit"
    CAR_PARK = "car-park"


@dataclass(frozen=True, slots=True)
class Node:
    """A place where roads meet or end, (2,) metres; its name is unique in the town."""

    name: str
    kind: NodeKind
    position: Floats


@dataclass(frozen=True, slots=True)
class Road:
    """A road between two nodes.

    Attributes:
        reference: (M, 2) line between the directions, from node to node.
        lanes: Lanes per direction.
        kerb_parking: Whether it has a parking strip on both sides.
        speed_mps: What people drive here.
    """

    name: str
    ends: tuple[str, str]
    reference: Floats
    lanes: int
    kerb_parking: bool
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Layout:
    """Nodes and roads of one town, by name."""

    nodes: dict[str, Node]
    roads: dict[str, Road]


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
    *(_RoadPlan(*ends, 1, index == 0, 11.0) for index, ends in enumerate(_OUTER)),
)
_RING_ROADS = (
    _RoadPlan("N", NORTH, "XN", SOUTH, 1, False, 11.0),
    _RoadPlan("N", SOUTH, "C", NORTH, 1, True, 10.0),
    _RoadPlan("C", SOUTH, "S", NORTH, 1, True, 10.0),
    _RoadPlan("S", SOUTH, "XS", NORTH, 1, False, 11.0),
    _RoadPlan("W", EAST, "P", WEST, 1, False, 10.0),
    _RoadPlan("P", EAST, "C", WEST, 1, False, 10.0),
    _RoadPlan("C", EAST, "E", WEST, 1, True, 10.0),
    _RoadPlan("P", SOUTH, "K", NORTH, 1, False, 6.0),
    *(_RoadPlan(*ends, 2, False, 13.0) for ends in _OUTER),
)
PLANS = ("avenue", "ring")


def make_layout(plan: str, rng: np.random.Generator) -> Layout:
    """Draw one town's road graph, all coordinates between 0 and `CANVAS_M`. ``plan`` is ``avenue`` or ``ring``."""
    road_plans = _AVENUE_ROADS if plan == "avenue" else _RING_ROADS
    kinds = dict.fromkeys(("C", "N", "S", "W", "E", "P"), NodeKind.CROSSING)
    kinds["E" if plan == "avenue" else "C"] = NodeKind.ROUNDABOUT
    kinds |= {"K": NodeKind.CAR_PARK, "XN": NodeKind.EXIT, "XS": NodeKind.EXIT}
    if plan == "avenue":
        kinds["XE"] = NodeKind.EXIT
    places = _places(rng)
    turned = float(rng.integers(4)) * np.pi / 2 + float(rng.uniform(-0.17, 0.17))
    spin = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])

    def place(local: Floats) -> Floats:
        x, y = local[..., 0], local[..., 1]
        spun = np.stack([spin[0, 0] * x + spin[0, 1] * y, spin[1, 0] * x + spin[1, 1] * y], axis=-1)
        return np.asarray(spun + CANVAS_M / 2)

    nodes = {name: Node(name, kind, place(places[name])) for name, kind in kinds.items()}
    roads = {}
    for road in road_plans:
        line = turn(
            places[road.first],
            road.first_heading,
            places[road.last],
            road.last_heading + np.pi,
            step_m=_STATION_M,
            max_radius_m=float(rng.uniform(70.0, 95.0)),
        )
        name = f"{road.first}-{road.last}"
        roads[name] = Road(name, (road.first, road.last), place(line), road.lanes, road.parking, road.speed_mps)
    return Layout(nodes, roads)


def _places(rng: np.random.Generator) -> dict[str, Floats]:
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
