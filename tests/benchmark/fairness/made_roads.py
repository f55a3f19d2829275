"""A road of four lanes along x and a T junction beside it, in right-hand traffic, and users that drive straight."""

import numpy as np
from shapely.geometry import Polygon, box

from benchmark.fairness.fault_definition import ContactTracks, FaultAttribution, RoadUser
from benchmark.fairness.fault_roads import FaultRoads, RoadLane
from benchmark.fairness.fault_rules import attribute_fault
from benchmark.geometry import Floats
from benchmark.road_map import Handedness

CAR = ("vehicle.car", 4.0, 2.0)
PERSON = ("human.pedestrian.adult", 0.6, 0.6)
BARRIER = ("movable_object.barrier", 2.0, 0.5)
LANE_M = 3.5
EAST, FAST, WEST = -1.75, -5.25, 1.75
"""Centre lines: eastwards beside the middle and outside, westwards beside the middle. Walkways begin at 7 m."""
SAMPLES = 51


def lane(name: str, line: list[tuple[float, float]], *successors: str, junction: bool = False) -> RoadLane:
    polygon = None
    if not junction:
        (x, y), (to_x, to_y) = line
        along = abs(to_x - x) > abs(to_y - y)
        half = LANE_M / 2
        sides = (0.0, half) if along else (half, 0.0)
        polygon = box(
            min(x, to_x) - sides[0], min(y, to_y) - sides[1], max(x, to_x) + sides[0], max(y, to_y) + sides[1]
        )
    return RoadLane(name, np.array(line, np.float64), polygon, LANE_M, successors, junction)


def straight_road(**layers: list[Polygon]) -> FaultRoads:
    """Two lanes a direction from x = -200 to 200."""
    lanes = [
        lane("east", [(-200, EAST), (200, EAST)]),
        lane("fast", [(-200, FAST), (200, FAST)]),
        lane("west", [(200, WEST), (-200, WEST)]),
        lane("far", [(200, 5.25), (-200, 5.25)]),
    ]
    return FaultRoads(lanes, drivable_area=[box(-200, -7, 200, 7)], **layers)


def t_junction(*, sign: str | None = None, light: str | None = None) -> FaultRoads:
    """A road along x through a junction of 20 m, and a stem from the south that ends there; traffic keeps right."""
    lanes = [
        lane("w-in", [(-100, EAST), (-10, EAST)], "w-e", "w-s"),
        lane("w-e", [(-10, EAST), (10, EAST)], "e-out", junction=True),
        lane("w-s", [(-10, EAST), (-4, -4), (WEST * -1, -10)], "s-out", junction=True),
        lane("e-out", [(10, EAST), (100, EAST)]),
        lane("e-in", [(100, WEST), (10, WEST)], "e-w", "e-s"),
        lane("e-w", [(10, WEST), (-10, WEST)], "w-out", junction=True),
        lane("e-s", [(10, WEST), (0, -2), (-WEST, -10)], "s-out", junction=True),
        lane("w-out", [(-10, WEST), (-100, WEST)]),
        lane("s-in", [(1.75, -100), (1.75, -10)], "s-w", "s-e"),
        lane("s-w", [(1.75, -10), (1.0, -3), (-3, 1), (-10, WEST)], "w-out", junction=True),
        lane("s-e", [(1.75, -10), (4, -4), (10, EAST)], "e-out", junction=True),
        lane("s-out", [(-1.75, -10), (-1.75, -100)]),
    ]
    stop_lines = [(box(0, -12, 3.5, -11), sign), (box(-12, -3.5, -11, 0), light)]
    return FaultRoads(lanes, drivable_area=[box(-100, -3.5, 100, 3.5), box(-3.5, -100, 3.5, 0)], stop_lines=stop_lines)


def ring_lanes(radius_m: float, *, turn: int = 1, squeeze: float = 1.0) -> list[RoadLane]:
    """A roundabout of four lanes without arms; counter-clockwise with ``turn`` 1."""
    lanes = []
    for quarter in range(4):
        angle = turn * (quarter + np.linspace(0.0, 1.0, 9)) * np.pi / 2
        line = radius_m * np.column_stack([np.cos(angle), squeeze * np.sin(angle)])
        lanes.append(RoadLane(f"ring{quarter}", line, None, LANE_M, (f"ring{(quarter + 1) % 4}",), True))
    return lanes


def straight(
    what: tuple[str, float, float], end: tuple[float, float], yaw_rad: float, speed_m_s: float, samples: int = SAMPLES
) -> RoadUser:
    """A user that goes straight at one speed and ends at a place."""
    back = 0.1 * np.arange(samples - 1, -1, -1)[:, None]
    along = np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
    pose = np.column_stack([np.array(end) - back * speed_m_s * along, np.full(samples, yaw_rad)])
    return RoadUser(*what, pose, np.full(samples, speed_m_s))


def drifting(user: RoadUser, aside_m: float, since_s: float) -> RoadUser:
    """The same, but so many metres farther to the right of where it ends until some seconds before, then over."""
    count = len(user.pose)
    share = np.clip(0.1 * np.arange(count - 1, -1, -1) / since_s, 0.0, 1.0)
    yaw = user.pose[:, 2]
    right = np.column_stack([np.sin(yaw), -np.cos(yaw)])
    pose = user.pose.copy()
    pose[:, :2] += (aside_m * share)[:, None] * right
    return RoadUser(user.category, user.length_m, user.width_m, pose, user.speed)


def times(samples: int = SAMPLES) -> Floats:
    return 0.1 * np.arange(samples)


def attribute(
    ego: RoadUser, other: RoadUser, roads: FaultRoads | None, handedness: Handedness = Handedness.RIGHT
) -> FaultAttribution:
    return attribute_fault(ContactTracks(times(len(ego.pose)), ego, other), roads, handedness)


def said(ego: RoadUser, other: RoadUser, roads: FaultRoads | None) -> str:
    """Verdict and reason, which the users exchanged must exchange."""
    ours, exchanged = attribute(ego, other, roads), attribute(other, ego, roads)
    swap = {"ego": "other", "other": "ego"}
    assert (exchanged.verdict, exchanged.reason) == (swap.get(ours.verdict, ours.verdict), ours.reason)
    return f"{ours.verdict} {ours.reason}"
