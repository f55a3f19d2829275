"""Where something happens, from the map alone: roundabout, car park, junction, bend or straight; and speed by sample.

A map without junction surfaces (imported recordings) tells junctions by lanes that cross, and a place without any lane
is unknown.
"""

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon

from benchmark.geometry import Floats, wrap_angle
from benchmark.pdm.definition import SIDE_SPEED, SPEED
from benchmark.pdm.recorded_scene import estimate_motion
from benchmark.road_map import Lane, RoadMap
from benchmark.scene import Scene

NEAR_M = 60.0
"""Lanes farther away than this say nothing about a place."""
LARGEST_RING_M = 260.0
"""Way round the largest roundabout."""
SMALLEST_RING_M = 25.0
RING_STEP_M = 2.0
COUNTER_TURN_RAD = np.deg2rad(30.0)
"""A ring turns back by no more than this altogether."""
STEADY_TURN = 1.0 / 3.0
STEADY_SHARE = 0.6
"""At least this share of a ring turns by at least this part of the mean: streets round a block are mostly straight."""
ROUND_SPREAD = 0.15
"""Relative spread of a ring's distances from its centre."""
RING_MARGIN_M = 5.0
"""On a roundabout means at most this far outside the circle of lane centres."""
CROSSING_M = 8.0
"""Distance from a point where lanes cross that is still the junction."""
SHARED_END_M = 0.5
CROSSING_RAD = np.deg2rad(30.0)
LANE_REACH_M = 4.0
"""A car this far from a centre line is still on that lane."""
LANE_TURN_RAD = np.deg2rad(60.0)
BEND_WINDOW_M = 10.0
"""How far before and after a car the lane's direction is compared."""
BEND_RAD = np.deg2rad(10.0)
"""Change of direction over both windows together; a bend's radius is below about 115 m."""


class PlaceKind(StrEnum):
    """Kinds of place, the first that applies."""

    ROUNDABOUT = "roundabout"
    CAR_PARK = "car-park"
    JUNCTION = "junction"
    BEND = "bend"
    STRAIGHT = "straight"
    UNKNOWN = "unknown"


def classify_place(road_map: RoadMap, ego: Floats, other: Floats) -> PlaceKind:
    """Where two bodies, (5,) boxes, meet: the ego's lane tells bend from straight, either centre the rest."""
    x, y = ego[:2]
    return PlaceClassifier(road_map.near((x - NEAR_M, y - NEAR_M, x + NEAR_M, y + NEAR_M))).of(ego, other)


class PlaceClassifier:
    """Kinds of places on one map, which should be no larger than asked about: roundabouts are searched all over it."""

    def __init__(self, road_map: RoadMap) -> None:
        self._lanes = road_map.lanes
        self._names = sorted(road_map.lanes)
        self._lines = [LineString(_drop_repeated(road_map.lanes[name].centerline)) for name in self._names]
        self._near = shapely.STRtree(self._lines)
        self._segmented = bool(road_map.road_segments)
        self._roads = list(road_map.road_segments.values())
        self._junctions = [road_map.road_segments[name] for name in sorted(road_map.intersections)]
        self._carparks = list(road_map.carparks.values())
        for surfaces in (self._roads, self._carparks):
            shapely.prepare(surfaces)
        self._rings = tuple(find_rings(road_map.lanes))

    def of(self, ego: Floats, other: Floats) -> PlaceKind:
        """Where two bodies, (5,) boxes, meet: the ego's lane tells bend from straight, either centre the rest."""
        centers = [Point(*ego[:2]), Point(*other[:2])]
        if self._on_roundabout(centers):
            return PlaceKind.ROUNDABOUT
        parked = [center for center in centers if any(area.covers(center) for area in self._carparks)]
        if any(not any(road.covers(center) for road in self._roads) for center in parked):
            return PlaceKind.CAR_PARK
        if self._in_junction(centers):
            return PlaceKind.JUNCTION
        return self._classify_lane(ego)

    def _on_roundabout(self, centers: list[Point]) -> bool:
        """Whether a place is on a ring of lanes, or on the junction surface that most of the ring is on."""
        if not self._rings:
            return False
        under = [surface for surface in self._junctions if any(surface.covers(center) for center in centers)]
        for ring in self._rings:
            if any(ring.distance(center) <= RING_MARGIN_M for center in centers):
                return True
            circle = ring.exterior
            if any(surface.intersection(circle).length >= 0.5 * circle.length for surface in under):
                return True
        return False

    def _in_junction(self, centers: list[Point]) -> bool:
        if self._segmented:
            return any(surface.covers(center) for surface in self._junctions for center in centers)
        reach = shapely.union_all([center.buffer(CROSSING_M) for center in centers])
        near = [self._lines[place] for place in sorted(self._near.query(reach, "intersects").tolist())]
        return any(_do_cross(first, second, reach) for index, first in enumerate(near) for second in near[index + 1 :])

    def _classify_lane(self, ego: Floats) -> PlaceKind:
        """Bend or straight, from the lane that the ego is on."""
        best: tuple[float, str, float] | None = None
        center = Point(*ego[:2])
        for place in sorted(self._near.query(center, "dwithin", LANE_REACH_M).tolist()):
            name, line = self._names[place], self._lines[place]
            distance, at = line.distance(center), line.project(center)
            if distance > LANE_REACH_M or (best is not None and distance >= best[0]):
                continue
            if _angle_between(_compute_heading_at(line, at), ego[4]) <= LANE_TURN_RAD:
                best = (distance, name, at)
        if best is None:
            return PlaceKind.UNKNOWN
        line, at = _extend_lane(self._lanes, best[1], best[2])
        begin, end = max(at - BEND_WINDOW_M, 0.0), min(at + BEND_WINDOW_M, line.length)
        change = _angle_between(_compute_heading_at(line, begin), _compute_heading_at(line, end))
        # The same change over a shorter piece of lane is a tighter bend; a very short piece has no direction.
        wanted = BEND_RAD * max(end - begin, BEND_WINDOW_M) / (2 * BEND_WINDOW_M)
        return PlaceKind.BEND if change >= wanted else PlaceKind.STRAIGHT


def find_rings(lanes: Mapping[str, Lane]) -> Iterator[Polygon]:
    """Areas inside roundabouts, closed chains of lanes that turn steadily one way; the same may come several times."""
    courses = {name: _LaneCurvature.of(lane) for name, lane in lanes.items()}
    for name in sorted(lanes):
        for sign in (1.0, -1.0):
            chain = _find_shortest_ring(lanes, courses, name, sign)
            ring = None if chain is None else _build_ring(np.concatenate([lanes[part].centerline for part in chain]))
            if ring is not None:
                yield ring


@dataclass(frozen=True, slots=True)
class _LaneCurvature:
    """Length of a lane in metres and its turning to either side in radians."""

    length: float
    left: float
    right: float

    @classmethod
    def of(cls, lane: Lane) -> Self:
        turn = _compute_turns(_resample(lane.centerline, RING_STEP_M))
        length = float(np.hypot(*np.diff(lane.centerline, axis=0).T).sum())
        return cls(length, float(turn[turn > 0].sum()), float(-turn[turn < 0].sum()))


def _find_shortest_ring(
    lanes: Mapping[str, Lane], courses: Mapping[str, _LaneCurvature], first: str, sign: float
) -> tuple[str, ...] | None:
    """The shortest chain of lanes from one back to itself that turns one way.

    ``first`` has the smallest name of its chain, so that each chain is found once. All chains would be too many where
    short lanes part and merge.
    """
    waiting: list[tuple[float, tuple[str, ...], float]] = [(0.0, (first,), 0.0)]
    done: set[str] = set()
    while waiting:
        length, chain, back = heapq.heappop(waiting)
        if chain[-1] in done:
            continue
        done.add(chain[-1])
        course = courses[chain[-1]]
        length, back = length + course.length, back + (course.right if sign > 0 else course.left)
        if length > LARGEST_RING_M or back > COUNTER_TURN_RAD:
            continue
        if first in lanes[chain[-1]].successors:
            return chain
        for following in lanes[chain[-1]].successors:
            if following in lanes and following > first and following not in done:
                heapq.heappush(waiting, (length, (*chain, following), back))
    return None


def _build_ring(points: Floats) -> Polygon | None:
    """The area of a closed chain if it is round, else ``None``."""
    line = _resample(np.concatenate([points, points[:1]]), RING_STEP_M)
    length = float(np.hypot(*np.diff(line, axis=0).T).sum())
    if not SMALLEST_RING_M <= length <= LARGEST_RING_M:
        return None
    turn = _compute_turns(np.concatenate([line, line[1:2]]))
    if abs(abs(float(turn.sum())) - 2 * np.pi) > COUNTER_TURN_RAD:
        return None
    # Over three steps, because centre lines made of short pieces turn in jumps.
    eased = np.abs(turn + np.roll(turn, 1) + np.roll(turn, -1)) / 3
    ring = Polygon(line)
    distance = np.hypot(*(line - np.array(ring.centroid.coords[0])).T)
    steady = float((eased >= STEADY_TURN * 2 * np.pi / len(turn)).mean()) >= STEADY_SHARE
    return ring if steady and float(distance.std() / distance.mean()) <= ROUND_SPREAD else None


def _do_cross(first: LineString, second: LineString, reach: Polygon) -> bool:
    """Whether two lines cross in their middles at an angle; lanes that part or merge share ends."""
    for point in shapely.get_parts(first.intersection(second)):
        if not isinstance(point, Point) or not reach.covers(point):
            continue
        along = [(line, line.project(point)) for line in (first, second)]
        if any(min(at, line.length - at) < SHARED_END_M for line, at in along):
            continue
        headings = [_compute_heading_at(line, at) for line, at in along]
        if CROSSING_RAD <= _angle_between(*headings) <= np.pi - CROSSING_RAD:
            return True
    return False


def _angle_between(first: float, second: float) -> float:
    """Angle between two directions, 0 to pi."""
    return abs(float(wrap_angle(np.array(first - second))))


def _compute_heading_at(line: LineString, at: float) -> float:
    """Direction of a line over the metre around a place along it."""
    ends = [line.interpolate(float(np.clip(at + step, 0.0, line.length))) for step in (-0.5, 0.5)]
    return float(np.arctan2(ends[1].y - ends[0].y, ends[1].x - ends[0].x))


def _extend_lane(lanes: Mapping[str, Lane], name: str, at: float) -> tuple[LineString, float]:
    """A lane with the straightest lanes before and after it, and the same place along the whole.

    Connectors are left out: what turns in a junction is not a bend of the road that leads there.
    """
    parts = [lanes[name].centerline]
    left = LineString(parts[0]).length - at
    if at < BEND_WINDOW_M and (before := _find_straightest(lanes, name, lanes[name].predecessors)) is not None:
        parts.insert(0, before)
        at += LineString(np.concatenate([before, parts[1][:1]])).length
    if left < BEND_WINDOW_M:
        after = _find_straightest(lanes, name, lanes[name].successors)
        parts += [] if after is None else [after]
    return LineString(_drop_repeated(np.concatenate(parts))), at


def _find_straightest(lanes: Mapping[str, Lane], name: str, linked: tuple[str, ...]) -> Floats | None:
    turning = {
        other: _LaneCurvature.of(lanes[other]).left + _LaneCurvature.of(lanes[other]).right
        for other in linked
        if other in lanes and other != name and not lanes[other].is_connector
    }
    return lanes[min(turning, key=lambda other: (turning[other], other))].centerline if turning else None


def _resample(points: Floats, step_m: float) -> Floats:
    """(M, 2) points about ``step_m`` apart on a polyline; always its two ends."""
    points = _drop_repeated(points)
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    wanted = np.linspace(0.0, station[-1], max(round(station[-1] / step_m), 1) + 1)
    return np.column_stack([np.interp(wanted, station, points[:, axis]) for axis in (0, 1)])


def _drop_repeated(points: Floats) -> Floats:
    """A polyline without repeated points, which have no direction."""
    moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    return points if moved.sum() < 2 else points[moved]


def _compute_turns(points: Floats) -> Floats:
    """Changes of direction between the steps of a polyline, radians."""
    step = np.diff(points, axis=0)
    return wrap_angle(np.diff(np.arctan2(step[:, 1], step[:, 0])))


SPEED_DECIMALS: Final = 3
"""Of stored speeds: below them, processors differ."""


@dataclass(frozen=True, slots=True)
class SampleContext:
    """Place of the recorded car's middle, and its speed by the parabola through eleven poses, as for driving scores."""

    place: PlaceKind
    speed_m_s: float


def read_sample_contexts(scene: Scene) -> tuple[SampleContext, ...]:
    """Place and speed of the recorded car at every sample, in time order; without a map every place is unknown."""
    places, boxes = PlaceClassifier(scene.road_map), scene.ego.boxes[scene.keyframes]
    motion = estimate_motion(scene.ego.pose, scene.seconds)[scene.keyframes]
    speeds = np.hypot(motion[:, SPEED], motion[:, SIDE_SPEED])
    return tuple(
        SampleContext(places.of(box, box), round(float(speed), SPEED_DECIMALS)) for box, speed in zip(boxes, speeds)
    )
