"""Maps of 123D as a `RoadMap`: surfaces with their holes, lanes that are driven, lines that part directions."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon

from benchmark.datasets.scenario_map import FARTHEST_M
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import make_token
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon
from benchmark.untrusted.files import MAP_LANES
from generation.extensions.logs123d.log_files import MapObject

LANE, LANE_GROUP, INTERSECTION, CROSSWALK, WALKWAY, CARPARK, DRIVABLE, STOP_ZONE, ROAD_EDGE, ROAD_LINE = range(10)
DRIVABLE_LAYERS: Final = (LANE, LANE_GROUP, INTERSECTION, CARPARK, DRIVABLE)
_LAYERS: Final = 11
_BIKE_LANE: Final = 3
_STOP_LINE_TYPES: Final = (None, "TRAFFIC_LIGHT", "STOP_SIGN", "YIELD", "PED_CROSSING", "TURN_STOP")
_SOLID_WHITE, _DASHED_WHITE = DividerKind.SOLID_WHITE, DividerKind.DASHED_WHITE
_SOLID_YELLOW, _DASHED_YELLOW = DividerKind.SOLID_YELLOW, DividerKind.DASHED_YELLOW
_PAINT: Final = (
    (DividerKind.UNPAINTED, False), (DividerKind.UNPAINTED, False), (_SOLID_YELLOW, True), (_SOLID_WHITE, True),
    (_DASHED_WHITE, False), (_DASHED_YELLOW, True), (_SOLID_YELLOW, True), (_SOLID_WHITE, True),
    (_DASHED_YELLOW, True), (_DASHED_WHITE, True), (_SOLID_YELLOW, True), (_SOLID_WHITE, False),
    (_SOLID_WHITE, True), (_SOLID_YELLOW, True), (_SOLID_WHITE, False),
)  # fmt: skip
"""Paint of each type of road line, and whether it is yellow or double, which parts directions."""
_ALONG_M: Final = 0.3
_MOSTLY: Final = 0.8


@dataclass(frozen=True, slots=True)
class ReadMap:
    """A map and what of it nuScenes' layers have no place for, in words."""

    road_map: RoadMap
    left_out: tuple[str, ...]


def build_road_map(
    objects: Sequence[MapObject], *, path: Path, location: str, named_after: str, only_drivable: bool
) -> ReadMap:
    """A road map in the log's own coordinates.

    Args:
        objects: Of one file.
        path: The file, for messages.
        location: Name of the place.
        named_after: What identifiers are made of beside layer and number; the same for all parts of one map.
        only_drivable: Whether the drivable layer is the whole drivable area where there is one, and surfaces of
            connectors are made up: of nuScenes.
    """
    reader = _ObjectReader(objects, path, named_after, only_drivable)
    groups, junctions = reader.surfaces(LANE_GROUP), reader.surfaces(INTERSECTION)
    inside = {reader.token(LANE_GROUP, one.identifier) for one in reader.layer(LANE_GROUP) if reader.is_inside(one)}
    stops = {reader.token(STOP_ZONE, one.identifier): one.features for one in reader.layer(STOP_ZONE)}
    types = {name: _STOP_LINE_TYPES[_pick(of.get("stop_zone_type"), _STOP_LINE_TYPES)] for name, of in stops.items()}
    road_map = RoadMap(
        location=location,
        drivable_area=reader.drivable_area(),
        lanes=reader.lanes(),
        dividers=reader.dividers(),
        ped_crossings=reader.surfaces(CROSSWALK),
        walkways=reader.surfaces(WALKWAY),
        road_segments={**{name: shape for name, shape in groups.items() if name not in inside}, **junctions},
        intersections=frozenset(junctions),
        stop_lines=reader.surfaces(STOP_ZONE),
        carparks=reader.surfaces(CARPARK),
        stop_line_types={name: kind for name, kind in types.items() if kind is not None},
    )
    return ReadMap(road_map, reader.name_left_out())


def read_shape(found: MapObject, path: Path) -> shapely.Geometry:
    """Surface, with its holes, or line of an object: what features call outline has no holes."""
    try:
        return shapely.from_wkb(found.wkb)
    except shapely.errors.ShapelyError as error:
        raise InputError(f"{path}: object {found.identifier} has no shape; convert the map again") from error


def drives_other_way(line: Floats, other: Floats) -> bool:
    """Whether two (M, 2) centre lines, side by side, lead in opposite directions: neighbours are of either kind."""
    ahead, beside = line[-1] - line[0], other[-1] - other[0]
    return bool(ahead @ beside < 0)


class _ObjectReader:
    def __init__(self, objects: Sequence[MapObject], path: Path, named_after: str, only_drivable: bool) -> None:
        self.path, self.named_after, self.only_drivable = path, named_after, only_drivable
        self.by_layer: dict[int, dict[int, MapObject]] = {layer: {} for layer in range(_LAYERS)}
        for found in objects:
            if found.layer not in self.by_layer:
                raise self.damaged(f"it has the layer {found.layer}, which is not known")
            if found.identifier in self.by_layer[found.layer]:
                raise self.damaged(f"layer {found.layer} has the object {found.identifier} twice")
            self.by_layer[found.layer][found.identifier] = found
        if len(self.by_layer[LANE]) > 4 * MAP_LANES:
            raise self.damaged(f"it has {len(self.by_layer[LANE])} lanes near the log")
        self.bike_lanes = {one.identifier for one in self.layer(LANE) if one.features.get("lane_type") == _BIKE_LANE}
        self.centerlines = {
            one.identifier: self.line(one, "centerline")
            for one in self.layer(LANE)
            if one.identifier not in self.bike_lanes
        }

    def damaged(self, why: str) -> InputError:
        return InputError(f"{self.path} cannot be used: {why}; convert the map again")

    def layer(self, layer: int) -> list[MapObject]:
        return list(self.by_layer[layer].values())

    def token(self, layer: int, identifier: int) -> str:
        # Numbers are unique within a layer only.
        return make_token("123d", self.named_after, layer, identifier)

    def surfaces(self, layer: int) -> dict[str, Polygon]:
        shapes = {one.identifier: _mend(read_shape(one, self.path)) for one in self.layer(layer)}
        largest = {
            name: max(shape.geoms, key=lambda part: part.area) for name, shape in shapes.items() if not shape.is_empty
        }
        return {self.token(layer, name): shape for name, shape in largest.items()}

    def drivable_area(self) -> MultiPolygon:
        layers = (DRIVABLE,) if self.only_drivable and self.by_layer[DRIVABLE] else DRIVABLE_LAYERS
        shapes = [_mend(read_shape(one, self.path)) for layer in layers for one in self.layer(layer)]
        return as_multipolygon(shapely.union_all(shapes))

    def line(self, found: MapObject, name: str) -> Floats:
        line = found.features.get(name)
        if not isinstance(line, np.ndarray) or line.ndim != 2 or line.shape[1] not in (2, 3) or len(line) < 2:
            raise self.damaged(f"the {name} of lane {found.identifier} is no line")
        planar = np.asarray(line[:, :2], np.float64)
        if not np.isfinite(planar).all() or np.abs(planar).max() > FARTHEST_M:
            raise self.damaged(f"the {name} of lane {found.identifier} holds numbers that are no places")
        return planar

    def is_inside(self, group: MapObject) -> bool:
        return group.features.get("intersection_id") is not None

    def number(self, found: MapObject, name: str) -> int:
        """A number of another object, -1 for none."""
        value = found.features.get(name)
        return value if type(value) is int else -1

    def links(self, found: MapObject, name: str) -> tuple[str, ...]:
        given = found.features.get(name) or []
        if not isinstance(given, list) or not all(type(one) is int for one in given):
            raise self.damaged(f"the {name} of lane {found.identifier} are no numbers")
        # Those that lead out of the map, or are for bicycles, are no lanes here.
        return tuple(self.token(LANE, one) for one in given if one in self.centerlines)

    def lanes(self) -> dict[str, Lane]:
        surfaces, groups = self.surfaces(LANE), self.by_layer[LANE_GROUP]
        lanes = {}
        for identifier, centerline in self.centerlines.items():
            found, name = self.by_layer[LANE][identifier], self.token(LANE, identifier)
            group = groups.get(self.number(found, "lane_group_id"))
            is_connector = group is not None and self.is_inside(group)
            surface = None if self.only_drivable and is_connector else surfaces.get(name)
            after, before = self.links(found, "successor_ids"), self.links(found, "predecessor_ids")
            lanes[name] = Lane(name, centerline, surface, after, before, is_connector)
        return lanes

    def dividers(self) -> tuple[Divider, ...]:
        between = self._find_edges_between_directions()
        dividers = []
        for found in self.layer(ROAD_LINE):
            shape = read_shape(found, self.path)
            line = np.asarray(shapely.get_coordinates(shape), np.float64)
            if not isinstance(shape, LineString) or len(line) < 2 or shape.length == 0.0:
                continue
            kind, parts = _PAINT[_pick(found.features.get("road_line_type"), _PAINT)]
            along = shape.intersection(between).length >= _MOSTLY * shape.length
            dividers.append(Divider(self.token(ROAD_LINE, found.identifier), line, kind, bool(parts or along)))
        return tuple(dividers)

    def _find_edges_between_directions(self) -> shapely.Geometry:
        """A strip around the left edges of lanes whose left neighbour drives the other way."""
        edges = []
        for identifier, centerline in self.centerlines.items():
            found = self.by_layer[LANE][identifier]
            other = self.centerlines.get(self.number(found, "left_lane_id"))
            if other is not None and drives_other_way(centerline, other):
                edges.append(LineString(self.line(found, "left_boundary")))
        return shapely.union_all([edge.buffer(_ALONG_M) for edge in edges])

    def name_left_out(self) -> tuple[str, ...]:
        counts = {
            "bicycle lanes": len(self.bike_lanes),
            "road edges": len(self.by_layer[ROAD_EDGE]),
            "speed bumps": len(self.by_layer[_LAYERS - 1]),
        }
        return tuple(f"{count} {name}" for name, count in counts.items() if count)


def _pick(value: Any, of: Sequence[Any]) -> int:
    return value if isinstance(value, int) and 0 <= value < len(of) else 0


def _mend(shape: shapely.Geometry) -> MultiPolygon:
    return as_multipolygon(shape if shape.is_valid else shapely.make_valid(shape))


def find_extent(road_map: RoadMap) -> Floats:
    """(2, 2) lowest and highest x and y of everything in a map; infinite, and the other way round, in an empty one."""
    shapes = [
        road_map.drivable_area,
        *(LineString(lane.centerline) for lane in road_map.lanes.values()),
        *(LineString(one.line) for one in road_map.dividers),
        *(shape for layer in (road_map.walkways, road_map.ped_crossings) for shape in layer.values()),
        *(shape for layer in (road_map.road_segments, road_map.stop_lines) for shape in layer.values()),
        *road_map.carparks.values(),
    ]
    bounds = np.array([shape.bounds for shape in shapes if not shape.is_empty]).reshape(-1, 4)
    return np.stack([bounds[:, :2].min(axis=0, initial=np.inf), bounds[:, 2:].max(axis=0, initial=-np.inf)])
