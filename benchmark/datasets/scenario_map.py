"""A road map as map features of a ScenarioNet file, and back; words of such files, and checks of their values."""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import MultiPolygon, Polygon

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap
from benchmark.scene import EgoTrack, Scene
from benchmark.untrusted.files import MAP_LANES, MAP_POINTS, to_one_line

FARTHEST_M: Final = 1e8
"""More than any projected map coordinate."""
_LONGEST_NAME: Final = 256


def to_real_numbers(value: Any) -> Floats:
    """Numbers in an array or list of any shape, in double precision; `ValueError` if not real or no rectangle."""
    try:
        numbers = np.asarray(value)
        if numbers.dtype.kind not in "biufO":
            raise ValueError(f"{numbers.dtype} is not a numeric type")
        return np.asarray(numbers, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(to_one_line(error, 80)) from error


def to_name(value: Any, what: str, path: Path) -> str:
    """Name or whole number in a file as text, if printable and no longer than any name; ``what`` is for messages."""
    text = str(value) if isinstance(value, str | int | np.integer) else ""
    if len(text) > _LONGEST_NAME or not text.isprintable() or (not text and not isinstance(value, str)):
        raise InputError(f"{path}: {what} must be a name, not {to_one_line(repr(value), 60)}; fetch the file again")
    return text


OWN: Final = "challenger_bench"
DATASET: Final = "challenger-bench"
SCHEMA: Final = 1
ADVERSARIES: Final = "adversaries"
"""In the metadata of a file: names of the tracks that are adversaries."""
IS_ADVERSARY: Final = "is_adversary"
"""In the metadata of each track of a file that is written here."""
RING_PREFIX: Final = "boundary_"
"""Prefix of the names of drivable-area rings in the map, as in nuScenes files."""

NEEDS_A_PACKAGE: Final = (
    "writing OpenSCENARIO needs the package scenariogeneration; install it with: pip install "
    "'challenger-bench[openscenario]'"
)


@dataclass(frozen=True, slots=True)
class ExchangedScene:
    """A scene and its ``challenger.json`` report, as a file has both; a recording is its own ``source_scene``."""

    scene: Scene
    source_scene: str
    report: Mapping[str, Any] = field(default_factory=dict)


def compute_ego_center(ego: EgoTrack) -> Floats:
    """(T, 3) centre of the ego's body, which is what positions of tracks are; `EgoTrack` has the rear axle."""
    yaw = ego.yaw
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.column_stack([ego.position[:, :2] + ahead, ego.position[:, 2] + 0.5 * EGO_HEIGHT_M])


def hash_track(position: Floats, yaw: Floats, size: Floats, valid: Any) -> str:
    """Hash of a track, 64 hexadecimal digits, by which an edited one is known; invalid steps do not count.

    From (T, 3) positions and (3,) size in metres, (T,) yaw in radians, and (T,) whether it is there.
    """
    is_valid = np.asarray(valid, np.bool_)
    parts = (np.asarray(position, "<f8")[is_valid], np.asarray(yaw, "<f8")[is_valid], np.asarray(size, "<f8"))
    return hashlib.sha256(is_valid.tobytes() + b"".join(part.tobytes() for part in parts)).hexdigest()


MapFeature = dict[str, Any]

_LINE_TYPES: Final = {
    DividerKind.SOLID_WHITE: "ROAD_LINE_SOLID_SINGLE_WHITE",
    DividerKind.DASHED_WHITE: "ROAD_LINE_BROKEN_SINGLE_WHITE",
    DividerKind.SOLID_YELLOW: "ROAD_LINE_SOLID_SINGLE_YELLOW",
    DividerKind.DASHED_YELLOW: "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    DividerKind.UNPAINTED: "UNKNOWN_LINE",
}
_SURFACE_TYPES: Final = {"ped_crossings": "CROSSWALK", "walkways": "ROAD_EDGE_SIDEWALK"}
"""Layers of surfaces that ScenarioNet has a type for."""
_OTHER_LAYERS: Final = ("road_segments", "stop_lines", "carparks", "road_blocks")
"""Layers that it has none for."""
_SURFACE_NEAR_LINE_M: Final = 90.0
"""MetaDrive refuses lanes whose surface and centre line have mean points 100 m apart."""


def encode_map(road_map: RoadMap) -> tuple[dict[str, MapFeature], dict[str, Any]]:
    """``map_features`` of a ScenarioNet file, and what has no place among them, for the file's own block."""
    features: dict[str, MapFeature] = {name: _lane(lane) for name, lane in road_map.lanes.items()}

    def put(key: str, feature: MapFeature) -> None:
        while key in features:
            key = f"{key}_"
        features[key] = feature

    for line in road_map.dividers:
        additions = {"layer": "dividers", "identifier": line.identifier, "between_directions": line.between_directions}
        put(line.identifier, {"type": _LINE_TYPES[line.kind], "polyline": _points(line.line), OWN: additions})
    for layer, kind in _SURFACE_TYPES.items():
        for name, shape in getattr(road_map, layer).items():
            outline, *holes = _rings(shape)
            additions = {"layer": layer, "identifier": name, "holes": holes}
            put(name, {"type": kind, "polygon": outline, OWN: additions})
    for number, part in enumerate(road_map.drivable_area.geoms):
        for ring, points in enumerate(_rings(part)):
            additions = {"layer": "drivable_area", "polygon": number, "ring": ring}
            put(f"{RING_PREFIX}{number}_{ring}", {"type": "ROAD_EDGE_BOUNDARY", "polyline": points, OWN: additions})
    layers = {
        layer: {name: _rings(shape) for name, shape in getattr(road_map, layer).items()} for layer in _OTHER_LAYERS
    }
    return features, {
        "location": road_map.location,
        "canvas_m": [float(side) for side in road_map.canvas_m],
        "intersections": sorted(road_map.intersections),
        "layers": layers,
    }


def _lane(lane: Lane) -> MapFeature:
    additions: dict[str, Any] = {"layer": "lanes", "identifier": lane.identifier, "is_connector": lane.is_connector}
    feature: MapFeature = {
        "type": "LANE_SURFACE_STREET",
        "polyline": _points(lane.centerline),
        "entry_lanes": list(lane.predecessors),
        "exit_lanes": list(lane.successors),
        OWN: additions,
    }
    if lane.polygon is not None:
        outline, *additions["holes"] = _rings(lane.polygon)
        away_m = np.linalg.norm(outline.mean(axis=0) - lane.centerline.mean(axis=0))
        (feature if away_m < _SURFACE_NEAR_LINE_M else additions)["polygon"] = outline
    return feature


def _rings(shape: Polygon) -> list[Floats]:
    """The outline of a surface, then its holes, each (M, 2) with the first point once more at the end."""
    return [_points(shapely.get_coordinates(ring)) for ring in (shape.exterior, *shape.interiors)]


def _points(points: Floats) -> Floats:
    return np.array(points, np.float64)


def decode_map(features: Mapping[Any, Any], own: Any, path: Path) -> RoadMap:
    """The whole map that `encode_map` was given; ``own`` is what the file's own block says of it."""
    try:
        return _map(features, own, path)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, shapely.errors.ShapelyError) as error:
        raise InputError(
            f"{path}: its map is not in challenger-bench's format ({type(error).__name__}: {to_one_line(error, 80)}); "
            "export it again"
        ) from error


def _map(features: Mapping[Any, Any], own: Any, path: Path) -> RoadMap:
    lanes, lines = {}, []
    surfaces: dict[str, dict[str, Polygon]] = {layer: {} for layer in _SURFACE_TYPES}
    rings: dict[int, dict[int, Floats]] = {}
    kinds = {kind: name for name, kind in _LINE_TYPES.items()}
    _require_no_more_than_roads(features)
    for key, feature in features.items():
        additions = feature[OWN]
        layer = additions["layer"]
        if layer == "drivable_area":
            rings.setdefault(int(additions["polygon"]), {})[int(additions["ring"])] = _read_points(feature["polyline"])
            continue
        name = to_name(additions["identifier"], f"the name of {key}", path)
        if layer == "lanes":
            lanes[name] = _read_lane(name, feature, path)
        elif layer == "dividers":
            lines.append(
                Divider(
                    name,
                    _read_points(feature["polyline"]),
                    kinds[feature["type"]],
                    additions["between_directions"] is True,
                )
            )
        else:
            surfaces[layer][name] = _surface([feature["polygon"], *additions["holes"]])
    parts = [_surface([rings[number][ring] for ring in sorted(rings[number])]) for number in sorted(rings)]
    width, height = _read_numbers(own["canvas_m"], (2,)).tolist()
    layers = {layer: dict(_named_surfaces(own["layers"][layer], path)) for layer in _OTHER_LAYERS}
    return RoadMap(
        location=to_name(own["location"], "the location", path),
        drivable_area=MultiPolygon(parts),
        lanes=lanes,
        dividers=tuple(lines),
        intersections=frozenset(to_name(name, "an intersection", path) for name in own["intersections"]),
        canvas_m=(width, height),
        **surfaces,
        **layers,
    )


def _require_no_more_than_roads(features: Mapping[Any, Any]) -> None:
    lines = [feature.get(key) for feature in features.values() for key in ("polyline", "polygon")]
    points = sum(len(line) for line in lines if line is not None)
    lanes = sum(feature[OWN]["layer"] == "lanes" for feature in features.values())
    if points > MAP_POINTS or lanes > MAP_LANES:
        raise ValueError(f"{points} points and {lanes} lanes, more than any road network")


def _read_lane(name: str, feature: MapFeature, path: Path) -> Lane:
    additions = feature[OWN]
    outline = feature.get("polygon", additions.get("polygon"))
    return Lane(
        identifier=name,
        centerline=_read_points(feature["polyline"]),
        polygon=None if outline is None else _surface([outline, *additions["holes"]]),
        successors=tuple(to_name(other, f"a lane after {name}", path) for other in feature["exit_lanes"]),
        predecessors=tuple(to_name(other, f"a lane before {name}", path) for other in feature["entry_lanes"]),
        is_connector=additions["is_connector"] is True,
    )


def _named_surfaces(layer: Mapping[Any, Any], path: Path) -> Iterator[tuple[str, Polygon]]:
    for name, rings in layer.items():
        yield to_name(name, "the name of a part of the map", path), _surface(rings)


def _surface(rings: Any) -> Polygon:
    outline, *holes = (_read_points(ring) for ring in rings)
    return Polygon(outline, holes)


def _read_points(value: Any) -> Floats:
    points = to_real_numbers(value)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise ValueError(f"points of shape {points.shape}")
    return _finite(points)


def _read_numbers(value: Any, shape: tuple[int, ...]) -> Floats:
    return _finite(to_real_numbers(value).reshape(shape))


def _finite(values: Floats) -> Floats:
    if not np.isfinite(values).all() or np.abs(values).max(initial=0.0) > FARTHEST_M:
        raise ValueError("coordinates that are not metres")
    return values
