"""The road of a scene from its map: surfaces, intersections where it has none, lanes on the route, where cars are."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, Self

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Polygon

from benchmark.geometry import Bools, Floats, box_corners, directions_of, wrap_angle
from benchmark.pdm.definition import CENTER_AHEAD_M, HEADING, LENGTH_M, WIDTH_M
from benchmark.road_map import Lane, RoadMap, as_multipolygon


class SurfaceKind(StrEnum):
    """Kinds of surface."""

    LANE = "lane"
    CONNECTOR = "lane_connector"
    ROAD_BLOCK = "roadblock"
    INTERSECTION = "intersection"
    DRIVABLE_AREA = "drivable_area"
    CAR_PARK = "carpark_area"


@dataclass(frozen=True, slots=True)
class RoadPolygons:
    """Surfaces around a scene: lanes and connectors, and which of them `find_lanes_on_route` says are on the route.

    ``drivable`` are road blocks, intersections, drivable areas and car parks.
    """

    lanes: tuple[Polygon, ...]
    on_route: tuple[bool, ...]
    drivable: tuple[Polygon, ...]
    intersections: tuple[Polygon, ...]

    @classmethod
    def of(cls, surfaces: "list[tuple[SurfaceKind, Polygon, bool]]") -> Self:
        """Sort surfaces by what they decide: layer, shape and, of lanes and connectors, whether it is on the route."""
        lanes = [
            (shape, routed) for layer, shape, routed in surfaces if layer in (SurfaceKind.LANE, SurfaceKind.CONNECTOR)
        ]
        drivable = [shape for layer, shape, _ in surfaces if layer not in (SurfaceKind.LANE, SurfaceKind.CONNECTOR)]
        crossings = [shape for layer, shape, _ in surfaces if layer is SurfaceKind.INTERSECTION]
        for shape in (*(shape for shape, _ in lanes), *drivable):
            shapely.prepare(shape)
        return cls(
            tuple(shape for shape, _ in lanes),
            tuple(routed for _, routed in lanes),
            tuple(drivable),
            tuple(crossings),
        )

    def unsure(self, boxes: Floats) -> Bools:
        """Cars, (Q, 5), in several lanes or off the drivable surfaces: to blame for contacts at their sides."""
        corners = _PointIndex(box_corners(boxes))
        return self.find_straddling(corners, (len(boxes),)) | self.left(corners, (len(boxes),))

    def find_straddling(self, corners: "_PointIndex", shape: tuple[int, ...]) -> Bools:
        """Whether cars (four corners each) are on more than one lane or connector and none holds them whole."""
        touched, contained = np.zeros(shape, np.int64), np.zeros(shape, np.bool_)
        for surface in self.lanes:
            which, inside = corners.inside(surface)
            if which.size:
                held = np.zeros((*shape, 4), np.bool_)
                held.reshape(-1)[which[inside]] = True
                touched += held.any(axis=-1)
                contained |= held.all(axis=-1)
        return np.asarray((touched > 1) & ~contained)

    def left(self, corners: "_PointIndex", shape: tuple[int, ...]) -> Bools:
        """Whether a corner of cars is on no drivable surface."""
        drivable = np.zeros((*shape, 4), np.bool_)
        for surface in self.drivable:
            corners.mark(drivable, surface)
        return np.asarray(~drivable.all(axis=-1))


@dataclass(frozen=True, slots=True)
class RoadPositions:
    """Places of B cars on the road at T states, each (B, T).

    Attributes:
        multiple_lanes: Some corner is on more than one lane or connector and none holds the whole car.
        non_drivable: Some corner is on no drivable surface.
        oncoming: The centre is on no lane or connector of the route.
    """

    multiple_lanes: Bools
    non_drivable: Bools
    oncoming: Bools
    center_in_intersection: Bools
    axle_in_intersection: Bools


def compute_footprints(states: Floats) -> Floats:
    """(..., 5) boxes of the car at (..., 11) states."""
    heading = states[..., HEADING]
    center = states[..., :2] + CENTER_AHEAD_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    size = np.broadcast_to([LENGTH_M, WIDTH_M], center.shape)
    return np.concatenate([center, size, heading[..., None]], axis=-1)


def locate_on_road(road: RoadPolygons, states: Floats) -> RoadPositions:
    """Where cars are on the road at (B, T, 11) states; a point on the border of a surface is outside it."""
    boxes = compute_footprints(states)
    shape = states.shape[:-1]
    corners = _PointIndex(box_corners(boxes))
    center, axle = _PointIndex(boxes[..., :2]), _PointIndex(states[..., :2])
    routed = np.zeros(shape, np.bool_)
    for surface, on_route in zip(road.lanes, road.on_route, strict=True):
        if on_route:
            center.mark(routed, surface)
    crossing, axle_crossing = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    for surface in road.intersections:
        center.mark(crossing, surface)
        axle.mark(axle_crossing, surface)
    straddled, left = road.find_straddling(corners, shape), road.left(corners, shape)
    return RoadPositions(straddled, left, ~routed, crossing, axle_crossing)


class _PointIndex:
    """Points that are asked for many surfaces."""

    def __init__(self, points: Floats) -> None:
        flat = points.reshape(-1, 2)
        self.x, self.y = np.ascontiguousarray(flat[:, 0]), np.ascontiguousarray(flat[:, 1])
        self.bounds = (*flat.min(axis=0), *flat.max(axis=0)) if len(flat) else (np.inf, np.inf, -np.inf, -np.inf)

    def near(self, surface: Polygon) -> NDArray[np.int64]:
        """Points inside the bounding box of a surface."""
        low_x, low_y, high_x, high_y = surface.bounds
        if low_x > self.bounds[2] or low_y > self.bounds[3] or high_x < self.bounds[0] or high_y < self.bounds[1]:
            return np.zeros(0, np.int64)
        return np.flatnonzero((self.x > low_x) & (self.x < high_x) & (self.y > low_y) & (self.y < high_y))

    def inside(self, surface: Polygon) -> tuple[NDArray[np.int64], Bools]:
        """Points near a surface, and which of them are strictly inside."""
        which = self.near(surface)
        return which, np.asarray(shapely.contains_xy(surface, self.x[which], self.y[which]), np.bool_)

    def mark(self, verdicts: Bools, surface: Polygon) -> None:
        """Set the verdicts of the points inside; those that are set already are not asked again."""
        flat = verdicts.reshape(-1)
        which = self.near(surface)
        which = which[~flat[which]]
        if which.size:
            flat[which] = shapely.contains_xy(surface, self.x[which], self.y[which])


ROUTE_STEP_M: Final = 0.5
EXTENSION_M: Final = 100
"""How far the route goes on straight ahead where the recording ends, in points of 1 m."""
ROUTED_EXTENSION_M: Final = 30
"""How much of that makes lanes lanes of the route."""
CONNECTOR_WIDTH_M: Final = 3.5
"""Of lanes that the map has no surface for."""
ON_ROUTE_M: Final = 2.0
ON_ROUTE_RAD: Final = np.deg2rad(45.0)
BESIDE_M: Final = (2.0, 5.0)
"""Centre lines of neighbouring lanes are this far apart."""
BESIDE_ALONG_M: Final = 1.0
LINE_STEP_M: Final = 1.0
TOUCH_M: Final = 2.0
"""Of a connector inside a part of the road, to belong to it."""
SLIT_M: Final = 0.05
"""Between surfaces that are meant to touch."""
CROSSING_RAD: Final = np.deg2rad(30.0)
"""Lanes that turn away from each other by more make an intersection."""


def build_route(poses: Floats) -> Floats:
    """The path of the recorded rear axle through a whole scene, and a straight extension.

    (M, 2) points 0.5 m apart, then 100 points 1 m apart straight ahead of the last of the (T, 3) global poses.
    """
    path = _resample(poses[:, :2], ROUTE_STEP_M)
    ahead = np.arange(1, EXTENSION_M + 1)[:, None] * np.array([np.cos(poses[-1, 2]), np.sin(poses[-1, 2])])
    return np.concatenate([path, poses[-1, :2] + ahead])


def build_road_polygons(road_map: RoadMap, route: Floats) -> RoadPolygons:
    """The surfaces that plans are judged by; the route is as `build_route` makes it.

    Lanes and connectors (a strip of 3.5 m where the map has no surface), road blocks, intersections, car parks and the
    drivable area. Maps without road segments (imported recordings) get intersections from their lanes.
    """
    lanes = [road_map.lanes[name] for name in sorted(road_map.lanes)]
    shapes = [_build_surface(lane) for lane in lanes]
    routed = find_lanes_on_route(lanes, route)
    surfaces = [
        (SurfaceKind.CONNECTOR if lane.is_connector else SurfaceKind.LANE, shape, bool(is_routed))
        for lane, shape, is_routed in zip(lanes, shapes, routed, strict=True)
        if not shape.is_empty
    ]
    crossings = (
        [road_map.road_segments[name] for name in sorted(road_map.intersections)]
        if road_map.road_segments
        else derive_intersections(road_map, lanes, shapes)
    )
    layers: tuple[tuple[SurfaceKind, Sequence[Polygon]], ...] = (
        (SurfaceKind.ROAD_BLOCK, [road_map.road_blocks[name] for name in sorted(road_map.road_blocks)]),
        (SurfaceKind.INTERSECTION, crossings),
        (SurfaceKind.CAR_PARK, [road_map.carparks[name] for name in sorted(road_map.carparks)]),
        (SurfaceKind.DRIVABLE_AREA, list(road_map.drivable_area.geoms)),
    )
    return RoadPolygons.of([*surfaces, *((layer, shape, False) for layer, polygons in layers for shape in polygons)])


def find_lanes_on_route(lanes: Sequence[Lane], route: Floats) -> Bools:
    """(N,) which of N lanes and connectors a route, as `build_route` makes it, follows.

    True where the centre line passes within 2 m and 45 degrees of the path or the first 30 m of its extension, and for
    lanes beside such lanes in the same direction.
    """
    lines = [_add_headings(lane.centerline) for lane in lanes]
    path = _add_headings(route[: len(route) - EXTENSION_M + ROUTED_EXTENSION_M])
    routed = np.array([_follows_path(line, path) for line in lines], dtype=np.bool_)
    plain = np.array([not lane.is_connector for lane in lanes], dtype=np.bool_)
    waiting = list(np.flatnonzero(routed & plain))
    while waiting:
        here = lines[waiting.pop()]
        for other in np.flatnonzero(plain & ~routed):
            if _runs_beside(here, lines[other]):
                routed[other] = True
                waiting.append(other)
    return routed


def derive_intersections(road_map: RoadMap, lanes: Sequence[Lane], shapes: Sequence[Polygon]) -> list[Polygon]:
    """Intersections of a map that names none: what plain lanes leave of the drivable area around connectors that turn.

    Each part with two or more connectors of different direction, as far as it lies in their hull. A map whose lanes are
    all alike takes those that cross others for connectors. Shapes are the surfaces of the lanes.
    """
    inside = {number for number, lane in enumerate(lanes) if lane.is_connector} or _find_crossing_lanes(lanes)
    plain = shapely.union_all([shape for number, shape in enumerate(shapes) if number not in inside])
    rest = as_multipolygon(road_map.drivable_area.difference(plain.buffer(SLIT_M)))
    lines = {number: LineString(lanes[number].centerline) for number in sorted(inside)}
    intersections: list[Polygon] = []
    for part in rest.geoms:
        shapely.prepare(part)
        near = [number for number, line in lines.items() if part.intersects(line)]
        members = [number for number in near if lines[number].intersection(part).length >= TOUCH_M]
        headings = [_compute_mean_heading(lanes[member]) for member in members]
        if members and max(_angle_between(headings[0], heading) for heading in headings) > CROSSING_RAD:
            hull = shapely.union_all([shapes[member] for member in members]).convex_hull
            intersections += as_multipolygon(part.intersection(hull)).geoms
    return intersections


def _build_surface(lane: Lane) -> Polygon:
    if lane.polygon is not None and not lane.polygon.is_empty:
        return lane.polygon
    strip = LineString(lane.centerline).buffer(CONNECTOR_WIDTH_M / 2, cap_style="flat")
    return max(as_multipolygon(strip).geoms, key=lambda part: part.area, default=Polygon())


def _find_crossing_lanes(lanes: Sequence[Lane]) -> set[int]:
    """Lanes whose centre lines cross another's at an angle."""
    if not lanes:
        return set()
    lines = [LineString(lane.centerline) for lane in lanes]
    first, second = shapely.STRtree(lines).query(lines, predicate="crosses")
    pairs = zip(first.tolist(), second.tolist(), strict=True)
    turned = [
        (one, _angle_between(_compute_mean_heading(lanes[one]), _compute_mean_heading(lanes[other])))
        for one, other in pairs
    ]
    return {one for one, turn in turned if CROSSING_RAD < turn < np.pi - CROSSING_RAD}


def _compute_mean_heading(lane: Lane) -> float:
    """Direction from the start to the end of a lane."""
    return float(np.arctan2(*(lane.centerline[-1] - lane.centerline[0])[::-1]))


def _angle_between(first: float, second: float) -> float:
    """Angle between two directions, 0 to pi."""
    return abs(float(wrap_angle(np.array(first - second))))


def _add_headings(points: Floats) -> Floats:
    """(M, 3) points of a polyline at most a metre apart, each with the direction of its piece."""
    line = _resample(points, LINE_STEP_M)
    step = np.diff(line, axis=0)
    heading = directions_of(step)
    return np.column_stack([line, np.concatenate([heading, heading[-1:]])])


def _resample(points: Floats, step_m: float) -> Floats:
    """(M, 2) points every ``step_m`` along a polyline, and its end."""
    moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    points = points[moved]
    if len(points) < 2:
        return np.concatenate([points, points])
    station = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    wanted = np.append(np.arange(0.0, station[-1] - 1e-9, step_m), station[-1])
    return np.column_stack([np.interp(wanted, station, points[:, axis]) for axis in (0, 1)])


def _follows_path(line: Floats, path: Floats) -> bool:
    return bool(_are_near(line, path).any())


def _are_near(line: Floats, path: Floats) -> Bools:
    """(M, K) where points of two headed lines are near each other and point the same way."""
    if _are_apart(line, path, ON_ROUTE_M):
        return np.zeros((1, 1), np.bool_)
    distance = np.hypot(line[:, None, 0] - path[:, 0], line[:, None, 1] - path[:, 1])
    turn = np.abs(wrap_angle(line[:, None, 2] - path[:, 2]))
    return np.asarray((distance <= ON_ROUTE_M) & (turn <= ON_ROUTE_RAD))


def _are_apart(line: Floats, other: Floats, reach_m: float) -> bool:
    """Whether the rectangles around two lines are farther than this from each other in x or in y."""
    after = line[:, :2].min(axis=0) > other[:, :2].max(axis=0) + reach_m
    return bool(after.any() or (line[:, :2].max(axis=0) < other[:, :2].min(axis=0) - reach_m).any())


def _runs_beside(here: Floats, other: Floats) -> bool:
    """Whether a line runs beside another, seen from the points of the first."""
    if _are_apart(here, other, BESIDE_M[1] + BESIDE_ALONG_M):
        return False
    dx, dy = other[:, None, 0] - here[:, 0], other[:, None, 1] - here[:, 1]
    cos, sin = np.cos(here[:, 2]), np.sin(here[:, 2])
    along, across = np.abs(dx * cos + dy * sin), np.abs(dy * cos - dx * sin)
    turn = np.abs(wrap_angle(other[:, None, 2] - here[:, 2]))
    apart = (across >= BESIDE_M[0]) & (across <= BESIDE_M[1]) & (along <= BESIDE_ALONG_M)
    return bool((apart & (turn <= ON_ROUTE_RAD)).any())
