"""The path that a lane-following driver takes: from where the car is onto its lane, and on along the route."""

from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats, wrap_angle
from benchmark.planning import Command
from benchmark.road_map import Lane, RoadMap

SPACING_M = 0.5
_LARGEST_OFFSET_M = 3.5
_LARGEST_TURN_RAD = np.deg2rad(50.0)
_LOOK_ALONG_ROUTE_M = 40.0
_LEFT_OF = {Command.LEFT: 1.0, Command.RIGHT: -1.0}


@dataclass(frozen=True, slots=True)
class LanePath:
    """Line to drive along, in equal steps, from the place of the car; (P, 2) metres, global.

    Headings are radians, the arc length is metres from the first point, the curvature 1/m, unsigned; all (P,).
    """

    points: Floats
    heading: Floats
    arc_length: Floats
    curvature: Floats

    @classmethod
    def through(cls, points: Floats) -> "LanePath":
        """Resample a line, (M, 2) metres, to equal steps."""
        step = np.hypot(*np.diff(points, axis=0).T)
        points = points[np.concatenate([[True], step > 1e-6])]
        if len(points) < 2:
            raise ValueError("a path needs two different points")
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
        arc_length = np.arange(0.0, max(along[-1], 2 * SPACING_M), SPACING_M)
        even = np.column_stack([np.interp(arc_length, along, points[:, axis]) for axis in range(2)])
        beyond = np.maximum(arc_length - along[-1], 0.0)
        last = (points[-1] - points[-2]) / (along[-1] - along[-2])
        even += beyond[:, None] * last
        direction = np.gradient(even, SPACING_M, axis=0)
        heading = np.unwrap(np.arctan2(direction[:, 1], direction[:, 0]))
        # Centre lines are polygons; over a car's length their corners are curves.
        window = np.ones(9) / 9
        turning = np.convolve(np.pad(np.gradient(heading, SPACING_M), 4, mode="edge"), window, mode="valid")
        return cls(even, heading, arc_length, np.abs(turning))

    def at(self, arc_length: Floats) -> Floats:
        """(..., 2) metres on the path at arc lengths in metres; beyond its end the last point is given."""
        return np.stack([np.interp(arc_length, self.arc_length, self.points[:, axis]) for axis in range(2)], axis=-1)

    def heading_at(self, arc_length: Floats) -> Floats:
        """Heading at the nearest path point, radians."""
        nearest = np.clip(np.rint(arc_length / SPACING_M), 0, len(self.heading) - 1).astype(np.int64)
        return np.asarray(self.heading[nearest])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Arc length of the path point nearest to (..., 2) global points, and signed metres to the left there."""
        flat = points.reshape(-1, 2)
        squared = (flat[:, :1] - self.points[:, 0]) ** 2 + (flat[:, 1:] - self.points[:, 1]) ** 2
        nearest = squared.argmin(axis=1)
        offset = flat - self.points[nearest]
        cos, sin = np.cos(self.heading[nearest]), np.sin(self.heading[nearest])
        ahead, left = offset[:, 0] * cos + offset[:, 1] * sin, offset[:, 1] * cos - offset[:, 0] * sin
        shape = points.shape[:-1]
        return (self.arc_length[nearest] + ahead).reshape(shape), left.reshape(shape)


def build_straight_path(pose: Floats, length_m: float) -> LanePath:
    """Path straight ahead of a pose (x, y, yaw), where there is no lane to follow."""
    ahead = np.array([np.cos(pose[2]), np.sin(pose[2])])
    return LanePath.through(pose[:2] + np.array([[0.0], [length_m]]) * ahead)


def build_lane_path(
    road_map: RoadMap, pose: Floats, command: Command, speed: float, length_m: float
) -> LanePath | None:
    """Path of a car at (3,) x, y, yaw of the rear axle onto the nearest lane its way, and along the route.

    ``command`` chooses the successor where a lane forks: the one that turns most to its side, or least. A faster car
    takes longer to reach the middle of its lane; beyond the end of the lane the path goes straight on, to ``length_m``.
    ``None`` if no lane is near or the car is at its end.
    """
    lane = find_nearest_lane(road_map, pose)
    if lane is None:
        return None
    route = LanePath.through(_build_route_line(road_map, lane, pose, command, length_m))
    start, left = (float(value) for value in route.project(pose[:2]))
    start = max(start, 0.0)
    remaining = route.arc_length[-1] - start
    if remaining < 2 * SPACING_M:
        return None
    along = np.arange(0.0, remaining, SPACING_M)
    index = np.minimum(np.rint((start + along) / SPACING_M).astype(np.int64), len(route.points) - 1)
    turn = float(wrap_angle(np.asarray(pose[2] - route.heading[index[0]])))
    reach = min(max(2.5 * speed, 8.0), 30.0, float(along[-1]) + SPACING_M)
    offset = _fade_out(left, np.tan(np.clip(turn, -1.0, 1.0)), np.minimum(along / reach, 1.0), reach)
    heading = route.heading[index]
    centre = route.at(start + along)
    points = centre + offset[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)])
    points[0] = pose[:2]
    # Where the mapped lane ends, the driver continues straight.
    missing_m = length_m - float(along[-1])
    if missing_m > 0.0:
        ahead = np.array([np.cos(heading[-1]), np.sin(heading[-1])])
        points = np.concatenate([points, points[-1:] + missing_m * ahead])
    return LanePath.through(points)


def find_nearest_lane(road_map: RoadMap, pose: Floats) -> Lane | None:
    """The lane that a car with a pose (x, y, yaw) is on, or ``None``.

    It is within 3.5 m and runs within 50 degrees of the car's heading, the closest in position and heading.
    """
    best: tuple[float, str] | None = None
    bounds, names = road_map.lane_bounds(), list(road_map.lanes)
    x, y = pose[0], pose[1]
    around = (x >= bounds[:, 0] - _LARGEST_OFFSET_M) & (x <= bounds[:, 2] + _LARGEST_OFFSET_M)
    around &= (y >= bounds[:, 1] - _LARGEST_OFFSET_M) & (y <= bounds[:, 3] + _LARGEST_OFFSET_M)
    for place in np.flatnonzero(around):
        name = names[place]
        line = road_map.lanes[name].centerline
        distance, heading = _measure_offset(line, pose[:2])
        turn = abs(float(wrap_angle(np.asarray(pose[2] - heading))))
        if distance > _LARGEST_OFFSET_M or turn > _LARGEST_TURN_RAD:
            continue
        cost = (distance + 3.0 * turn, name)
        best = min(best, cost) if best else cost
    return road_map.lanes[best[1]] if best else None


def _measure_offset(line: Floats, point: Floats) -> tuple[float, float]:
    """Distance from a point to a line, and the line's heading there."""
    start, step = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((step**2).sum(axis=1), 1e-12)
    fraction = np.clip(((point - start) * step).sum(axis=1) / squared, 0.0, 1.0)
    distance = np.hypot(*(start + fraction[:, None] * step - point).T)
    nearest = int(distance.argmin())
    return float(distance[nearest]), float(np.arctan2(step[nearest, 1], step[nearest, 0]))


def _build_route_line(road_map: RoadMap, lane: Lane, pose: Floats, command: Command, length_m: float) -> Floats:
    """Centre lines one after the other, from the start of the lane to ``length_m`` beyond the car."""
    line = LanePath.through(lane.centerline)
    ahead_m = float(line.arc_length[-1] - line.project(pose[:2])[0])
    parts, seen = [lane.centerline], {lane.identifier}
    while ahead_m < length_m:
        following = [name for name in lane.successors if name in road_map.lanes and name not in seen]
        if not following:
            break
        lane = road_map.lanes[_choose_branch(road_map, following, command)]
        seen.add(lane.identifier)
        parts.append(lane.centerline)
        ahead_m += float(np.hypot(*np.diff(lane.centerline, axis=0).T).sum())
    return np.concatenate(parts)


def _choose_branch(road_map: RoadMap, following: list[str], command: Command) -> str:
    """The branch that turns most to the side of the command, or least; equal ones by name."""

    def cost(name: str) -> tuple[float, str]:
        turn = _measure_turn(road_map, name)
        side = _LEFT_OF.get(command)
        return (abs(turn) if side is None else -side * turn, name)

    return min(following, key=cost)


def _measure_turn(road_map: RoadMap, name: str) -> float:
    """Change of heading along the first part of a lane and what follows it, radians to the left."""
    turn, length_m, seen = 0.0, 0.0, set[str]()
    while length_m < _LOOK_ALONG_ROUTE_M and name not in seen:
        lane = road_map.lanes[name]
        seen.add(name)
        step = np.diff(lane.centerline, axis=0)
        headings = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
        reached = length_m + np.cumsum(np.hypot(*step.T))
        last = min(int(np.searchsorted(reached, _LOOK_ALONG_ROUTE_M)), len(headings) - 1)
        turn += float(headings[last] - headings[0])
        length_m = float(reached[-1])
        following = [successor for successor in lane.successors if successor in road_map.lanes]
        if len(following) != 1:
            break
        name = following[0]
    return turn


def _fade_out(offset_m: float, slope: float, fraction: Floats, reach_m: float) -> Floats:
    """Cubic from an offset and a slope to none of either: how a driver returns to the middle of the lane."""
    keep = 2 * fraction**3 - 3 * fraction**2 + 1
    lean = fraction**3 - 2 * fraction**2 + fraction
    return np.asarray(offset_m * keep + reach_m * slope * lean)
