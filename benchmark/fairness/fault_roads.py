"""Roads as fault attribution needs them: strips of lanes, turns, road ends, signs, surfaces, and handedness."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from benchmark.fairness.fault_definition import ARM_M, ONCOMING_RAD, SLACK, STOP_REACH_M, TURN_RAD, angle_between
from benchmark.fairness.fault_rings import find_ring
from benchmark.geometry import Bools, Floats, directions_of, wrap_angle
from benchmark.road_map import Handedness, Lane, RoadMap

CONNECTOR_M: Final = 3.5
"""Width of a connector without neighbours."""
WIDEST_CONNECTOR_M: Final = 4.5
"""Lanes of nuScenes are 6 to 12 m wide, so polygons decide and widths are only for connectors."""
GIVE_WAY: Final = ("STOP_SIGN", "YIELD")
LIGHT: Final = "TRAFFIC_LIGHT"
BESIDE_M: Final = 15.0
"""Centre lines of oncoming lanes of one road are at most so far apart."""
_LANES_AT_ONCE: Final = 64
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class RoadLane:
    """A lane: its centre line (M, 2) in driving direction, its polygon or ``None``, its width, what follows it.

    ``is_junction`` is True of connectors. Successors may name lanes that are not there.
    """

    identifier: str
    centerline: Floats
    polygon: Polygon | None
    width_m: float
    successors: tuple[str, ...]
    is_junction: bool


@dataclass(frozen=True, slots=True)
class LanePlaces:
    """Q points beside L lanes, (Q, L) each.

    Attributes:
        lanes: (L,) indices of the lanes.
        outside: Metres outside the strip; inside, minus the distance to its border.
        distance: Metres from the centre line.
        offset: Metres to the left of the line through the nearest segment.
        heading: Direction of the nearest segment, radians.
        beyond: Whether the point projects beyond an end of the centre line.
        station: Metres along the centre line.
        in_strip: Whether it is in the strip as a place of its own: beyond an end only where a polygon says so.
    """

    lanes: Indices
    outside: Floats
    distance: Floats
    offset: Floats
    heading: Floats
    beyond: Bools
    station: Floats
    in_strip: Bools


class FaultRoads:
    """The lanes and surfaces of a map, arranged for questions about places; an empty layer is one that is not given."""

    def __init__(
        self,
        lanes: Sequence[RoadLane],
        *,
        drivable_area: Iterable[Polygon] = (),
        walkways: Iterable[Polygon] = (),
        crossings: Iterable[Polygon] = (),
        carparks: Iterable[Polygon] = (),
        stop_lines: Iterable[tuple[Polygon, str | None]] = (),
    ) -> None:
        lines = [_without_repeats(lane.centerline) for lane in lanes]
        kept = [number for number, line in enumerate(lines) if len(line) > 1]
        self.lanes = tuple(lanes[number] for number in kept)
        self.lines = tuple(lines[number] for number in kept)
        self.index = {lane.identifier: number for number, lane in enumerate(self.lanes)}
        self.drivable_area, self.walkways, self.crossings, self.carparks = (
            _prepared(layer) for layer in (drivable_area, walkways, crossings, carparks)
        )
        self._signs = [(shape, kind) for shape, kind in stop_lines if kind in (*GIVE_WAY, LIGHT)]
        self._sign_tree = shapely.STRtree([shape for shape, _ in self._signs])
        self._rings: dict[tuple[int, Handedness], bool] = {}
        self._arrange()

    @classmethod
    def of(cls, road_map: RoadMap) -> Self:
        """The roads of a map: widths are of polygons, those of connectors from their neighbours."""
        widths = _measure_widths(road_map.lanes)
        kinds = road_map.stop_line_types
        return cls(
            [
                RoadLane(
                    lane.identifier,
                    lane.centerline,
                    None if lane.is_connector else lane.polygon,
                    widths[lane.identifier],
                    lane.successors,
                    lane.is_connector,
                )
                for lane in road_map.lanes.values()
            ],
            drivable_area=road_map.drivable_area.geoms,
            walkways=road_map.walkways.values(),
            crossings=road_map.ped_crossings.values(),
            carparks=road_map.carparks.values(),
            stop_lines=[(shape, kinds.get(name)) for name, shape in road_map.stop_lines.items()],
        )

    def _arrange(self) -> None:
        """Segments of all lanes one after the other, and what is asked of each lane often."""
        empty = np.zeros((0, 2))
        self.starts = np.concatenate([empty, *(line[:-1] for line in self.lines)])
        self.steps = np.concatenate([empty, *(np.diff(line, axis=0) for line in self.lines)])
        counts = np.array([len(line) - 1 for line in self.lines], np.int64)
        self.first = np.concatenate([np.zeros(1, np.int64), np.cumsum(counts)])
        self.lengths = np.hypot(*self.steps.T)
        total = np.concatenate([[0.0], np.cumsum(self.lengths)])
        self.stations = total[:-1] - np.repeat(total[self.first[:-1]], counts)
        self.length = np.diff(total[self.first])
        self.headings = directions_of(self.steps)
        self.width = np.array([lane.width_m for lane in self.lanes])
        self.is_junction = np.array([lane.is_junction for lane in self.lanes], np.bool_)
        self.begin = np.array([line[0] for line in self.lines]).reshape(-1, 2)
        self.end = np.array([line[-1] for line in self.lines]).reshape(-1, 2)
        self.begin_heading, self.end_heading = self.headings[self.first[:-1]], self.headings[self.first[1:] - 1]
        bends = np.concatenate([wrap_angle(np.diff(self.headings)), np.zeros(min(len(self.headings), 1))])
        bends[self.first[1:] - 1] = 0.0
        self.turn = np.add.reduceat(bends, self.first[:-1]) if len(self.lanes) else np.zeros(0)
        self.turns = np.abs(self.turn) >= TURN_RAD - SLACK
        self.successors = tuple(
            tuple(self.index[name] for name in lane.successors if name in self.index) for lane in self.lanes
        )
        before: list[list[int]] = [[] for _ in self.lanes]
        for number, following in enumerate(self.successors):
            for successor in following:
                before[successor].append(number)
        self.predecessors = tuple(map(tuple, before))
        self.has_polygon = np.array([lane.polygon is not None for lane in self.lanes], np.bool_)
        self._polygons = np.array([lane.polygon for lane in self.lanes], object)
        shapely.prepare(self._polygons)
        self._borders = shapely.boundary(self._polygons)
        self._bounds = self._measure_bounds()

    def _measure_bounds(self) -> Floats:
        """(4, L) smallest x and y, then largest, of strips."""
        bounds = np.array([[*line.min(axis=0), *line.max(axis=0)] for line in self.lines]).reshape(-1, 4)
        bounds += self.width[:, None] / 2 * np.array([-1.0, -1.0, 1.0, 1.0])
        surfaces = shapely.bounds(self._polygons)
        low, high = np.fmin(bounds[:, :2], surfaces[:, :2]), np.fmax(bounds[:, 2:], surfaces[:, 2:])
        return np.ascontiguousarray(np.concatenate([low, high], axis=1).T)

    @property
    def sign_shapes(self) -> list[Polygon]:
        """Stop lines of a type that rules know."""
        return [shape for shape, _ in self._signs]

    def near(self, points: Floats, reach_m: float) -> Indices:
        """Lanes whose strip may be within some metres of one of (Q, 2) points."""
        if not len(points):
            return np.zeros(0, np.int64)
        low, high = points.min(axis=0) - reach_m, points.max(axis=0) + reach_m
        bounds = self._bounds
        inside = (bounds[0] <= high[0]) & (bounds[1] <= high[1]) & (bounds[2] >= low[0]) & (bounds[3] >= low[1])
        lanes = np.flatnonzero(inside)
        if len(points) == 1 or not len(lanes):
            return lanes
        around = bounds[:, lanes, None]
        low, high = points.T - reach_m, points.T + reach_m
        met = (around[0] <= high[0]) & (around[1] <= high[1]) & (around[2] >= low[0]) & (around[3] >= low[1])
        met_lanes: Indices = lanes[met.any(axis=1)]
        return met_lanes

    def locate(self, points: Floats, lanes: Indices | Sequence[int], *, with_polygons: bool = True) -> LanePlaces:
        """Where (Q, 2) points are beside lanes; without polygons strips are as wide as their lanes."""
        lanes = np.asarray(lanes, np.int64)
        shape = (len(points), len(lanes))
        if not len(lanes):
            nothing = np.zeros(shape)
            never = np.zeros(shape, np.bool_)
            return LanePlaces(lanes, nothing, nothing, nothing, nothing, never, nothing, never)
        counts = self.first[lanes + 1] - self.first[lanes]
        firsts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        segments = np.arange(counts.sum()) + np.repeat(self.first[lanes] - firsts, counts)
        step, length = self.steps[segments], self.lengths[segments]
        offset = points[:, None, :] - self.starts[segments]
        along = (offset[..., 0] * step[:, 0] + offset[..., 1] * step[:, 1]) / length
        across = (offset[..., 1] * step[:, 0] - offset[..., 0] * step[:, 1]) / length
        inside = np.clip(along, 0.0, length)
        distance = np.hypot(along - inside, across)
        least = np.minimum.reduceat(distance, firsts, axis=1)
        # A corner is as near to both of its segments but for rounding: the earlier one counts.
        places = np.where(distance <= np.repeat(least, counts, axis=1) + SLACK, np.arange(len(segments)), len(segments))
        nearest = np.minimum.reduceat(places, firsts, axis=1)
        rows = np.arange(len(points))[:, None]
        at_start, at_end = nearest == firsts, nearest == firsts + counts - 1
        past = along[rows, nearest]
        beyond = (at_start & (past < -SLACK)) | (at_end & (past > length[nearest] + SLACK))
        outside = self._measure_outside(points, lanes, least) if with_polygons else least - self.width[lanes] / 2
        return LanePlaces(
            lanes,
            outside,
            least,
            across[rows, nearest],
            self.headings[segments][nearest],
            beyond,
            self.stations[segments][nearest] + inside[rows, nearest],
            (outside <= SLACK) & (self.has_polygon[lanes] | ~beyond),
        )

    def _measure_outside(self, points: Floats, lanes: Indices, distance: Floats) -> Floats:
        outside = distance - self.width[lanes] / 2
        surfaced = np.flatnonzero(self.has_polygon[lanes])
        if len(surfaced):
            places = shapely.points(points)[:, None]
            shapes = self._polygons[lanes[surfaced]][None]
            away = shapely.distance(shapes, places)
            depth = shapely.distance(self._borders[lanes[surfaced]][None], places)
            outside[:, surfaced] = np.where(away > 0.0, away, -depth)
        return np.asarray(outside)

    def reach_ahead(self, lane: int, station: float, reach_m: float) -> list[int]:
        """A lane, and all that are reached by successors and begin within some metres of a place along it."""
        begins = {lane: -station}
        waiting = [lane]
        while waiting:
            here = waiting.pop(0)
            end = begins[here] + float(self.length[here])
            for successor in self.successors[here]:
                if end <= reach_m + SLACK and end < begins.get(successor, np.inf):
                    begins[successor] = end
                    waiting.append(successor)
        return sorted(begins)

    def is_stem(self, junction_lane: int) -> bool:
        """Whether a road ends at the junction: its lane turns and none beside its beginning goes straight on."""
        apart = np.hypot(*(self.begin - self.begin[junction_lane]).T)
        beside = self.is_junction & (apart <= ARM_M + SLACK)
        beside &= angle_between(self.begin_heading, self.begin_heading[junction_lane]) <= TURN_RAD + SLACK
        return bool(self.turns[junction_lane] and not (beside & ~self.turns).any())

    def find_sign(self, junction_lane: int) -> str | None:
        """``light`` or ``give`` where a stop line of a type meets the lane or the last metres before it."""
        if not self._sign_tree.query(shapely.box(*self._bounds[:, junction_lane]).buffer(STOP_REACH_M)).size:
            return None
        ways = [self.lines[junction_lane]]
        for number in self.predecessors[junction_lane]:
            ways.append(_cut_end(self.lines[number], STOP_REACH_M))
        lines = [shapely.linestrings(way) for way in ways]
        met = {self._signs[number][1] for number in self._sign_tree.query(lines, predicate="intersects")[1]}
        return "light" if LIGHT in met else "give" if met else None

    def bend_m(self, lane: int) -> float:
        """Distance of a lane's beginning from the straight line through its end along its last direction."""
        offset, heading = self.begin[lane] - self.end[lane], self.end_heading[lane]
        return float(abs(offset[1] * np.cos(heading) - offset[0] * np.sin(heading)))

    def are_rings(self, lanes: Indices, handedness: Handedness) -> Bools:
        """Which of some lanes are part of a roundabout."""
        for lane in lanes.tolist():
            if (lane, handedness) not in self._rings:
                ring = find_ring(lane, self.successors, self.lines, handedness)
                self._rings |= {(member, handedness): bool(ring) for member in ring or (lane,)}
        return np.array([self._rings[lane, handedness] for lane in lanes.tolist()], np.bool_)


def _without_repeats(line: Floats) -> Floats:
    line = np.asarray(line, np.float64).reshape(-1, 2)
    moved = np.hypot(*np.diff(line, axis=0).T) > 1e-6
    return line[np.concatenate([[True], moved])] if len(line) else line


def _prepared(polygons: Iterable[Polygon]) -> MultiPolygon | None:
    """One geometry of a layer; ``None`` of an empty one."""
    shapes = [shape for shape in polygons if not shape.is_empty]
    if not shapes:
        return None
    union: Any = shapely.union_all(shapes) if len(shapes) > 1 else shapes[0]
    shapely.prepare(union)
    return union


def _measure_widths(lanes: dict[str, Lane]) -> dict[str, float]:
    """Metres: area by length of lanes with a polygon; connectors the mean of their neighbours, within limits."""
    widths = {}
    for name, lane in lanes.items():
        length = float(np.hypot(*np.diff(lane.centerline, axis=0).T).sum())
        if not lane.is_connector:
            widths[name] = lane.polygon.area / length if lane.polygon is not None and length > 0.0 else CONNECTOR_M
    for name, lane in lanes.items():
        if lane.is_connector:
            beside = [widths[other] for other in (*lane.predecessors, *lane.successors) if not _joins(lanes, other)]
            widths[name] = min(float(np.mean(beside)), WIDEST_CONNECTOR_M) if beside else CONNECTOR_M
    return widths


def _joins(lanes: dict[str, Lane], name: str) -> bool:
    return name not in lanes or lanes[name].is_connector


def _cut_end(line: Floats, length_m: float) -> Floats:
    """The last metres of a line."""
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    begin = max(0.0, float(station[-1]) - length_m)
    first = np.array([np.interp(begin, station, axis) for axis in line.T])
    return np.concatenate([first[None], line[station > begin]])


def find_handedness(location: str, roads: FaultRoads | None, given: Handedness | None = None) -> Handedness:
    """As given, else by its lanes, else by the name of the place; right where nothing tells.

    Lanes come before names: maps that are no city's go by the names of cities, since official code opens no others.
    """
    known = given or (None if roads is None else derive_handedness(roads))
    return known or Handedness.of_location(location) or Handedness.RIGHT


def derive_handedness(roads: FaultRoads) -> Handedness | None:
    """By the side on which lanes have the nearest oncoming lane; ``None`` where as many say left as right."""
    lanes = np.flatnonzero(~roads.is_junction)
    votes = 0
    for some in np.split(lanes, np.arange(_LANES_AT_ONCE, len(lanes), _LANES_AT_ONCE)):
        middles = np.array([roads.lines[lane][len(roads.lines[lane]) // 2] for lane in some.tolist()]).reshape(-1, 2)
        beside = roads.near(middles, BESIDE_M)
        beside = beside[~roads.is_junction[beside]]
        if not len(beside):
            continue
        headings = np.array([roads.headings[roads.first[lane] + (len(roads.lines[lane]) - 1) // 2] for lane in some])
        places = roads.locate(middles, beside, with_polygons=False)
        oncoming = angle_between(places.heading, headings[:, None]) >= ONCOMING_RAD
        apart = np.where(oncoming & ~places.beyond, places.distance, np.inf)
        rows, nearest = np.arange(len(some)), apart.argmin(axis=1)
        votes += int(np.sign(places.offset[rows, nearest])[apart[rows, nearest] <= BESIDE_M].sum())
    return None if votes == 0 else Handedness.RIGHT if votes > 0 else Handedness.LEFT
