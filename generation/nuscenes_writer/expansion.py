"""The vector map in nuScenes' map-expansion format, version 1.3, with centre lines as ``arcline_path_3``."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import LineString, Polygon

from benchmark.constants import MAP_LAYERS
from benchmark.geometry import Floats
from benchmark.machine.storage import make_token
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon

TOLERANCE_M = 0.03
"""Farthest a piece may be from the centre line."""
_STRAIGHT_RADIUS_M = 1e4
_MAX_SAGITTA_PER_CHORD = 0.2
"""Arcs turn at most 87 degrees; longer ones are split."""
_FLAT_SAGITTA_PER_CHORD = 0.02
_SHORTEST_M = 1e-3


def fit_arcline_path(centerline: Floats) -> list[dict[str, Any]]:
    """Arcs and straight pieces, end to end, fitted to an (M, 2) centre line, metres; none if it has no length."""
    points = np.asarray(centerline, np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > _SHORTEST_M])]
    paths = []
    start = 0
    while start < len(points) - 1:
        end = _find_farthest_end(points, start)
        paths.append(_build_piece(points[start], points[end], _fit_sagitta(points[start : end + 1])))
        start = end
    return paths


def _find_farthest_end(points: Floats, start: int) -> int:
    """Last vertex that one piece from ``start`` reaches: doubling steps, then bisection."""
    reached, step = start + 1, 1
    while reached < len(points) - 1:
        candidate = min(reached + step, len(points) - 1)
        if not _is_within_tolerance(points[start : candidate + 1]):
            break
        reached, step = candidate, 2 * step
    else:
        return reached
    low, high = reached, min(reached + step, len(points) - 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _is_within_tolerance(points[start : middle + 1]) else (low, middle)
    return low


def _transform_to_chord_frame(points: Floats) -> tuple[Floats, Floats, float]:
    """Coordinates along and to the left of the chord, and its length."""
    chord = points[-1] - points[0]
    length = float(np.hypot(*chord))
    if length < _SHORTEST_M:
        return np.zeros(len(points)), np.zeros(len(points)), 0.0
    along, left = chord / length, np.array([-chord[1], chord[0]]) / length
    offset = points - points[0]
    return offset @ along, offset @ left, length


def _fit_sagitta(points: Floats) -> float:
    """Signed height of the arc above its chord, by least squares; positive where the line bulges to the left.

    A flat arc is a parabola. Otherwise, of the circles through both ends, ``u^2 - u length + v^2 = 2 c v``, the centre
    height ``c`` is fitted.
    """
    u, v, length = _transform_to_chord_frame(points)
    shape = 4 * u * (length - u) / max(length, _SHORTEST_M) ** 2
    weight = float((shape * shape).sum())
    flat = float((shape * v).sum()) / weight if weight > 1e-12 else 0.0
    if abs(flat) < _FLAT_SAGITTA_PER_CHORD * length:
        return flat
    centre = float((v * (u * u - u * length + v * v)).sum() / (2 * (v * v).sum()))
    return centre + float(np.copysign(np.hypot(centre, length / 2), flat))


def _is_within_tolerance(points: Floats) -> bool:
    """Whether one piece through the end points stays within tolerance of all vertices and segment middles."""
    u, v, length = _transform_to_chord_frame(points)
    if length < _SHORTEST_M or (np.diff(u) <= 0).any():
        return False
    sagitta = _fit_sagitta(points)
    if abs(sagitta) > _MAX_SAGITTA_PER_CHORD * length:
        return False
    u = np.concatenate([u, (u[1:] + u[:-1]) / 2])
    v = np.concatenate([v, (v[1:] + v[:-1]) / 2])
    if _is_straight(sagitta, length):
        return bool((np.abs(v) <= TOLERANCE_M).all())
    radius = _compute_radius(sagitta, length)
    centre_v = sagitta - np.sign(sagitta) * radius
    off = np.hypot(u - length / 2, v - centre_v) - radius
    return bool((np.abs(off) <= TOLERANCE_M).all())


def _is_straight(sagitta: float, length: float) -> bool:
    return abs(sagitta) < 1e-4 or _compute_radius(sagitta, length) > _STRAIGHT_RADIUS_M


def _compute_radius(sagitta: float, length: float) -> float:
    return (length * length / 4 + sagitta * sagitta) / (2 * abs(sagitta))


def _build_piece(start: Floats, end: Floats, sagitta: float) -> dict[str, Any]:
    chord = end - start
    length = float(np.hypot(*chord))
    heading = float(np.arctan2(chord[1], chord[0]))
    if _is_straight(sagitta, length):
        return _build_record(start, heading, end, heading, "LSR", _STRAIGHT_RADIUS_M, [0.0, length, 0.0])
    radius = _compute_radius(sagitta, length)
    half_turn = float(np.arcsin(length / (2 * radius))) * float(np.sign(sagitta))
    shape = "RSR" if sagitta > 0 else "LSL"
    arc = 2 * radius * abs(half_turn)
    return _build_record(start, heading + half_turn, end, heading - half_turn, shape, radius, [arc, 0.0, 0.0])


def _build_record(
    start: Floats, start_yaw: float, end: Floats, end_yaw: float, shape: str, radius: float, lengths: list[float]
) -> dict[str, Any]:
    return {
        "start_pose": [float(start[0]), float(start[1]), start_yaw],
        "end_pose": [float(end[0]), float(end[1]), end_yaw],
        "shape": shape,
        "radius": radius,
        "segment_length": lengths,
    }


Row = dict[str, Any]

EXPANSION_VERSION: Final = "1.3"
_LANE_WIDTH_M: Final = 3.5
"""Width of a lane whose source has only its centre line."""
_SEGMENT_TYPES: Final = {
    DividerKind.SOLID_WHITE: "SINGLE_SOLID_WHITE",
    DividerKind.DASHED_WHITE: "DOUBLE_DASHED_WHITE",
    DividerKind.SOLID_YELLOW: "SINGLE_SOLID_YELLOW",
    DividerKind.DASHED_YELLOW: "DOUBLE_DASHED_YELLOW",
    DividerKind.UNPAINTED: "NIL",
}
"""nuScenes' names, in which dashed white is called double; it has none for dashed yellow."""


def build_map_expansion(road_map: RoadMap) -> Row:
    """The whole map of a place as the content of ``maps/expansion/<location>.json``, for the devkit's ``NuScenesMap``.

    Lanes, crossings and the like keep their identifiers as tokens. Lane connectors and lanes without a surface get one
    around their centre line. There are no traffic lights.
    """
    writer = _LayerWriter(road_map.location)
    writer.add_areas(road_map)
    for divider in road_map.dividers:
        writer.add_divider(divider)
    written_lanes = {name for name, lane in road_map.lanes.items() if writer.add_lane(lane)}
    connectivity = {
        name: {
            "incoming": [other for other in road_map.lanes[name].predecessors if other in written_lanes],
            "outgoing": [other for other in road_map.lanes[name].successors if other in written_lanes],
        }
        for name in sorted(written_lanes)
    }
    return {
        "version": EXPANSION_VERSION,
        "canvas_edge": list(road_map.canvas_m),
        **writer.layers,
        "connectivity": connectivity,
        "arcline_path_3": writer.arclines,
    }


class _LayerWriter:
    """Collects layers; equal coordinates share a node."""

    def __init__(self, location: str) -> None:
        self.location = location
        self.layers: dict[str, list[Row]] = {layer: [] for layer in MAP_LAYERS}
        self.arclines: dict[str, list[Row]] = {}
        self.nodes: dict[tuple[float, float], str] = {}

    def add_areas(self, road_map: RoadMap) -> None:
        """All surfaces but lanes."""
        area_token = make_token("drivable_area", self.location)
        pieces = _list_valid_polygons(road_map.drivable_area)
        if pieces:
            polygons = [self._polygon(piece, ("drivable_area", number)) for number, piece in enumerate(pieces)]
            self.layers["drivable_area"].append({"token": area_token, "polygon_tokens": polygons})
        for name, shape in sorted(road_map.road_segments.items()):
            extra = {
                "is_intersection": name in road_map.intersections,
                "drivable_area_token": area_token if pieces else "",
            }
            self._add_surface("road_segment", name, shape, extra)
        cues = {"ped_crossing_tokens": [], "traffic_light_tokens": [], "road_block_token": ""}
        links = {"from_edge_line_token": "", "to_edge_line_token": "", "road_segment_token": ""}
        areas: tuple[tuple[str, dict[str, Polygon], Row], ...] = (
            ("ped_crossing", road_map.ped_crossings, {"road_segment_token": ""}),
            ("walkway", road_map.walkways, {}),
            ("stop_line", road_map.stop_lines, cues),
            ("carpark_area", road_map.carparks, {"orientation": 0.0, "road_block_token": ""}),
            ("road_block", road_map.road_blocks, links),
        )
        for layer, shapes, extra in areas:
            for name, shape in sorted(shapes.items()):
                kind = {"stop_line_type": road_map.stop_line_types.get(name, "TURN_STOP")} if extra is cues else {}
                self._add_surface(layer, name, shape, {**kind, **extra})

    def add_divider(self, divider: Divider) -> None:
        """A lane or road divider with its paint."""
        line_token, nodes = self._add_line(divider.line, ("divider", divider.identifier))
        segments = [{"node_token": node, "segment_type": _SEGMENT_TYPES[divider.kind]} for node in nodes]
        row = {"token": divider.identifier, "line_token": line_token, "lane_divider_segments": segments}
        if divider.between_directions:
            self.layers["road_divider"].append({**row, "road_segment_token": ""})
        else:
            self.layers["lane_divider"].append(row)

    def add_lane(self, lane: Lane) -> bool:
        """A lane or connector; one without any length is left out."""
        path = fit_arcline_path(lane.centerline)
        surface = _find_largest(lane.polygon) if lane.polygon is not None else None
        if surface is None and path:
            surface = _find_largest(LineString(lane.centerline).buffer(_LANE_WIDTH_M / 2, cap_style="flat"))
        if not path or surface is None:
            return False
        self.arclines[lane.identifier] = path
        polygon = self._polygon(surface, ("lane", lane.identifier))
        if lane.is_connector:
            self.layers["lane_connector"].append({"token": lane.identifier, "polygon_token": polygon})
            return True
        ends = [self._add_edge(surface, path[side][pose], (lane.identifier, pose)) for side, pose in _LANE_ENDS]
        self.layers["lane"].append(
            {
                "token": lane.identifier,
                "polygon_token": polygon,
                "lane_type": "CAR",
                "from_edge_line_token": ends[0],
                "to_edge_line_token": ends[1],
                "left_lane_divider_segments": [],
                "right_lane_divider_segments": [],
            }
        )
        return True

    def _add_surface(self, layer: str, name: str, shape: Polygon, extra: Row) -> None:
        surface = _find_largest(shape)
        if surface is not None:
            polygon = self._polygon(surface, (layer, name))
            self.layers[layer].append({"token": name, "polygon_token": polygon, **extra})

    def _polygon(self, polygon: Polygon, key: tuple[Any, ...]) -> str:
        own_token = make_token("polygon", self.location, *key)
        holes = [{"node_tokens": self._add_ring(ring.coords)} for ring in polygon.interiors]
        row = {"token": own_token, "exterior_node_tokens": self._add_ring(polygon.exterior.coords), "holes": holes}
        self.layers["polygon"].append(row)
        return own_token

    def _add_line(self, points: Floats, key: tuple[Any, ...]) -> tuple[str, list[str]]:
        own_token = make_token("line", self.location, *key)
        nodes = [self._add_node(x, y) for x, y in np.asarray(points)[:, :2].tolist()]
        self.layers["line"].append({"token": own_token, "node_tokens": nodes})
        return own_token, nodes

    def _add_edge(self, surface: Polygon, pose: list[float], key: tuple[Any, ...]) -> str:
        """The end of a lane: the corners of its surface nearest to where the lane's borders should end."""
        corners = np.array(surface.exterior.coords)[:-1, :2]
        left = np.array([-np.sin(pose[2]), np.cos(pose[2])]) * _LANE_WIDTH_M / 2
        centre = np.array(pose[:2])
        nearest = [int(np.linalg.norm(corners - point, axis=1).argmin()) for point in (centre + left, centre - left)]
        return self._add_line(corners[nearest], ("edge", *key))[0]

    def _add_ring(self, coordinates: Iterable[tuple[float, ...]]) -> list[str]:
        return [self._add_node(point[0], point[1]) for point in list(coordinates)[:-1]]

    def _add_node(self, x: float, y: float) -> str:
        at = (float(x) + 0.0, float(y) + 0.0)
        if at not in self.nodes:
            self.nodes[at] = make_token("node", self.location, *at)
            self.layers["node"].append({"token": self.nodes[at], "x": at[0], "y": at[1]})
        return self.nodes[at]


_LANE_ENDS: Final = ((0, "start_pose"), (-1, "end_pose"))


def _list_valid_polygons(shape: shapely.Geometry) -> list[Polygon]:
    """Valid polygons of a geometry, slivers below a square centimetre dropped."""
    valid = shape if shape.is_valid else shapely.make_valid(shape)
    return [piece for piece in as_multipolygon(valid).geoms if piece.area > 1e-4]


def _find_largest(shape: shapely.Geometry) -> Polygon | None:
    return max(_list_valid_polygons(shape), key=lambda piece: piece.area, default=None)
