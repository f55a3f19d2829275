"""Map features of ScenarioNet files as a `RoadMap`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon

from benchmark.datasets.scenario_map import FARTHEST_M, to_name, to_real_numbers
from benchmark.errors import InputError
from benchmark.geometry import Floats, wrap_angle
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon
from benchmark.untrusted.files import MAP_LANES, MAP_LINKS, MAP_MEETINGS, MAP_POINTS

_REACH_M: Final = 200.0
"""Files cut their map around the ego; nearer than this to its path they are complete."""
_MARGIN_M: Final = 20.0
_JOINED_WITHIN_M: Final = 0.2
_JOINED_TURN_RAD: Final = np.deg2rad(45.0)
_DEFAULT_LANE_WIDTH_M: Final = 3.5
_WIDEST_LANE_M: Final = 10.0
_COUNTED_AT_ONCE: Final = 512
_RING_PREFIX: Final = "boundary_"
_CANVAS_M: Final = {
    "singapore-onenorth": (1585.6, 2025.0),
    "singapore-hollandvillage": (2808.3, 2922.9),
    "singapore-queenstown": (3228.6, 3687.1),
    "boston-seaport": (2979.5, 2118.1),
}
"""Extents of the real maps, which scenes with official locations lie in."""


def build_road_map(
    features: Mapping[Any, Any], *, path: Path, location: str, official: bool, ego_path: Floats
) -> tuple[RoadMap, Floats]:
    """Map of one file within 200 m of the (L, 2) ego path, and the (2,) shift in metres that was applied.

    The drivable area is made of the ``boundary_*`` rings of nuScenes files, filled even-odd (lane polygons alone leave
    junctions out); where there are none, of lane surfaces, crossings and driveways. Lanes are linked as the file says,
    and where it says nothing, where one begins at another's end. The map gets the nuScenes name ``location``.
    ``official`` coordinates are those of the real location and stay; others are shifted to be positive.
    """
    read = _read_features(features, path)
    low, high = ego_path.min(axis=0) - _REACH_M, ego_path.max(axis=0) + _REACH_M
    lanes = {name: feature for name, feature in read.items() if feature.is_lane}
    crossings = _surfaces(read, ("CROSSWALK",))
    bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    road_map = RoadMap(
        location=location,
        drivable_area=_drivable_area(read, lanes, crossings, shapely.box(*bounds)),
        lanes=_linked_lanes(lanes),
        dividers=tuple(_dividers(read)),
        ped_crossings=crossings,
        walkways=_surfaces(read, ("SIDEWALK", "BOUNDARY_SIDEWALK", "ROAD_EDGE_SIDEWALK")),
    ).near(bounds)
    extent = _extent(road_map, ego_path)
    shift = np.zeros(2) if official and (extent[0] >= 0).all() else np.maximum(0.0, _MARGIN_M - extent[0])
    width, height = (float(value) + _MARGIN_M for value in extent[1] + shift)
    if official:
        width, height = (max(pair) for pair in zip((width, height), _CANVAS_M[location], strict=True))
    return replace(move_map(road_map, shift) if shift.any() else road_map, canvas_m=(width, height)), shift


def _read_features(features: Mapping[Any, Any], path: Path) -> dict[str, "_CheckedFeature"]:
    """Features by name, which can be joined in seconds: not too many, and not all across one another."""
    named = {to_name(name, "the name of a map feature", path): feature for name, feature in features.items()}
    read = {name: _CheckedFeature(feature, name, path) for name, feature in named.items()}
    lines = [
        line
        for checked_feature in read.values()
        for line in (checked_feature.line, checked_feature.outline)
        if line is not None
    ]
    links = sum(
        len(checked_feature.entries or ()) + len(checked_feature.exits or ()) for checked_feature in read.values()
    )
    lanes = sum(checked_feature.is_lane for checked_feature in read.values())
    if sum(map(len, lines)) > MAP_POINTS or links > MAP_LINKS or lanes > MAP_LANES or _meet_often(lines):
        raise InputError(
            f"{path}: its map has {sum(map(len, lines))} points, {lanes} lanes and {links} links, or lines that cross "
            "each other more often than roads do; cut it around the ego, or fetch the file again"
        )
    return read


def _meet_often(lines: Sequence[Floats]) -> bool:
    """Whether too many pieces of lines come near each other; counted by their boxes."""
    if not lines:
        return False
    starts, ends = (np.concatenate([line[part] for line in lines]) for part in (slice(-1), slice(1, None)))
    boxes = shapely.box(*np.minimum(starts, ends).T, *np.maximum(starts, ends).T)
    tree, meetings = shapely.STRtree(boxes), 0
    for first in range(0, len(boxes), _COUNTED_AT_ONCE):
        meetings += tree.query(boxes[first : first + _COUNTED_AT_ONCE]).shape[1]
        if meetings > MAP_MEETINGS:
            return True
    return False


class _CheckedFeature:
    """One map feature with its coordinates checked."""

    def __init__(self, feature: Any, name: str, path: Path) -> None:
        if not isinstance(feature, dict) or not isinstance(feature.get("type"), str):
            raise InputError(f"{path}: map feature {name} has no type; fetch the file again")
        self.name = name
        self.type: str = feature["type"]
        self.line = _coordinates(feature, "polyline", name, path)
        self.outline = _coordinates(feature, "polygon", name, path)
        self.width = _width(feature.get("width"), name, path)
        self.entries = _names(feature.get("entry_lanes"), name, path)
        self.exits = _names(feature.get("exit_lanes"), name, path)

    @property
    def is_lane(self) -> bool:
        return self.type.startswith("LANE_") and "BIKE" not in self.type and self.line is not None

    def surface(self) -> Polygon | None:
        """Polygon of the feature, or ``None`` if it has none."""
        if self.outline is None or len(self.outline) < 3:
            return None
        parts = as_multipolygon(shapely.make_valid(Polygon(self.outline)))
        return max(parts.geoms, key=lambda part: part.area, default=None)

    def strip(self) -> shapely.Geometry:
        """Surface of a lane without a polygon: its centre line, as wide as the lane."""
        assert self.line is not None
        width_m = _DEFAULT_LANE_WIDTH_M
        if self.width is not None:
            sides = self.width
            with np.errstate(over="ignore"):
                total = sides.sum(axis=-1) if sides.ndim == 2 else sides
            known = total[np.isfinite(total) & (total > 1.0)]
            width_m = float(np.median(known)) if len(known) else width_m
        return LineString(self.line).buffer(min(width_m, _WIDEST_LANE_M) / 2, cap_style="flat")


def _coordinates(feature: Mapping[str, Any], key: str, name: str, path: Path) -> Floats | None:
    if key not in feature or feature[key] is None:
        return None
    try:
        points = to_real_numbers(feature[key])
        if points.shape[:1] == (0,):
            return None
        if points.ndim != 2 or points.shape[1] < 2:
            raise ValueError(f"shape {points.shape}")
    except ValueError as error:
        raise InputError(f"{path}: {key} of map feature {name} is not a list of points ({error})") from error
    points = points[:, :2]
    if not np.isfinite(points).all():
        raise InputError(f"{path}: {key} of map feature {name} has a coordinate that is not finite")
    if np.abs(points).max() > FARTHEST_M:
        raise InputError(f"{path}: {key} of map feature {name} has coordinates that cannot be metres")
    moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    return points[moved] if moved.sum() > 1 else None


def _width(value: Any, name: str, path: Path) -> Floats | None:
    try:
        return None if value is None else to_real_numbers(value)
    except ValueError as error:
        raise InputError(f"{path}: width of map feature {name} is not a list of numbers ({error})") from error


def _names(value: Any, name: str, path: Path) -> tuple[str, ...] | None:
    if value is None:
        return None
    is_list = value.ndim > 0 if isinstance(value, np.ndarray) else isinstance(value, list | tuple | set | frozenset)
    if not is_list:
        raise InputError(f"{path}: the lanes before and after map feature {name} must be lists; fetch the file again")
    return tuple(to_name(other, f"a neighbour of map feature {name}", path) for other in value)


def _surfaces(features: Mapping[str, _CheckedFeature], types: tuple[str, ...]) -> dict[str, Polygon]:
    shapes = {name: feature.surface() for name, feature in features.items() if feature.type in types}
    return {name: shape for name, shape in shapes.items() if shape is not None}


def _drivable_area(
    features: Mapping[str, _CheckedFeature],
    lanes: Mapping[str, _CheckedFeature],
    crossings: Mapping[str, Polygon],
    window: Polygon,
) -> MultiPolygon:
    rings = [feature.line for name, feature in features.items() if name.startswith(_RING_PREFIX)]
    closed = [ring for ring in rings if ring is not None and len(ring) >= 4 and np.allclose(ring[0], ring[-1])]
    if closed:
        area = Polygon()
        for ring in closed:
            # Clipped first, because rings cover whole cities and far ones would cost most of the time.
            area = area.symmetric_difference(shapely.make_valid(Polygon(ring)).intersection(window))
        return as_multipolygon(area)
    surfaces = [lane.surface() or lane.strip() for lane in lanes.values()]
    driveways = _surfaces(features, ("DRIVEWAY",))
    union = shapely.union_all([*surfaces, *crossings.values(), *driveways.values()])
    # Neighbouring lanes leave slits of a few centimetres between them.
    return as_multipolygon(union.buffer(0.2, join_style="mitre").buffer(-0.2, join_style="mitre"))


def _linked_lanes(features: Mapping[str, _CheckedFeature]) -> dict[str, Lane]:
    given = any(feature.exits is not None or feature.entries is not None for feature in features.values())
    exits = (
        {name: feature.exits or () for name, feature in features.items()} if given else _find_touching_lanes(features)
    )
    successors = {name: {other for other in neighbours if other in features} for name, neighbours in exits.items()}
    if given:
        for name, feature in features.items():
            for before in feature.entries or ():
                if before in successors:
                    successors[before].add(name)
    predecessors: dict[str, set[str]] = {name: set() for name in features}
    for name, neighbours in successors.items():
        for other in neighbours:
            predecessors[other].add(name)
    # In nuScenes lanes have a surface and connectors do not; other sources treat all lanes alike.
    tells_connectors = any(feature.outline is not None for feature in features.values())
    lanes = {}
    for name, feature in features.items():
        assert feature.line is not None
        lanes[name] = Lane(
            identifier=name,
            centerline=feature.line,
            polygon=feature.surface(),
            successors=tuple(sorted(successors[name])),
            predecessors=tuple(sorted(predecessors[name])),
            is_connector=tells_connectors and feature.outline is None,
        )
    return lanes


def _find_touching_lanes(features: Mapping[str, _CheckedFeature]) -> dict[str, tuple[str, ...]]:
    """Lanes that begin where another ends, in about the same direction."""
    names = list(features)
    if not names:
        return {}
    lines = [feature.line for feature in features.values() if feature.line is not None]
    starts, ends = np.array([line[0] for line in lines]), np.array([line[-1] for line in lines])
    start_yaw = np.array([np.arctan2(*(line[1] - line[0])[::-1]) for line in lines])
    end_yaw = np.array([np.arctan2(*(line[-1] - line[-2])[::-1]) for line in lines])
    distance = np.linalg.norm(ends[:, None] - starts[None], axis=-1)
    turn = np.abs(wrap_angle(start_yaw[None] - end_yaw[:, None]))
    joined = (distance < _JOINED_WITHIN_M) & (turn < _JOINED_TURN_RAD) & ~np.eye(len(names), dtype=np.bool_)
    return {name: tuple(names[other] for other in np.flatnonzero(row)) for name, row in zip(names, joined, strict=True)}


def _dividers(features: Mapping[str, _CheckedFeature]) -> Iterable[Divider]:
    for name, feature in features.items():
        if not feature.type.startswith("ROAD_LINE_") or name.startswith(_RING_PREFIX) or feature.line is None:
            continue
        dashed, yellow = "BROKEN" in feature.type, "YELLOW" in feature.type
        if yellow:
            kind = DividerKind.DASHED_YELLOW if dashed else DividerKind.SOLID_YELLOW
        else:
            kind = DividerKind.DASHED_WHITE if dashed else DividerKind.SOLID_WHITE
        yield Divider(name, feature.line, kind, yellow)


def _extent(road_map: RoadMap, ego_path: Floats) -> Floats:
    """(2, 2) lowest and highest x and y of everything."""
    shapes: list[shapely.Geometry] = [LineString(ego_path), road_map.drivable_area]
    shapes += [LineString(lane.centerline) for lane in road_map.lanes.values()]
    shapes += [lane.polygon for lane in road_map.lanes.values() if lane.polygon is not None]
    shapes += [LineString(line.line) for line in road_map.dividers]
    shapes += [*road_map.ped_crossings.values(), *road_map.walkways.values()]
    bounds = np.array([shape.bounds for shape in shapes if not shape.is_empty])
    return np.array([bounds[:, :2].min(axis=0), bounds[:, 2:].max(axis=0)])


def move_map(road_map: RoadMap, shift: Floats) -> RoadMap:
    """The map, but for road blocks, with its origin moved by (2,) metres."""

    def moved(shape: Any) -> Any:
        return None if shape is None else shapely.transform(shape, lambda points: points + shift)

    return replace(
        road_map,
        drivable_area=moved(road_map.drivable_area),
        lanes={
            name: replace(lane, centerline=lane.centerline + shift, polygon=moved(lane.polygon))
            for name, lane in road_map.lanes.items()
        },
        dividers=tuple(replace(line, line=line.line + shift) for line in road_map.dividers),
        ped_crossings={name: moved(shape) for name, shape in road_map.ped_crossings.items()},
        walkways={name: moved(shape) for name, shape in road_map.walkways.items()},
        road_segments={name: moved(shape) for name, shape in road_map.road_segments.items()},
        stop_lines={name: moved(shape) for name, shape in road_map.stop_lines.items()},
        carparks={name: moved(shape) for name, shape in road_map.carparks.items()},
    )
