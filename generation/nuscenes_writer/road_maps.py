"""Road maps stored beside the fragments, and parts of one place's map put together again."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import shapely
from shapely.geometry import Polygon

from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon

_SNAP_M = 1e-4
"""Grid on which clipped pieces of one drivable area are joined: far below map accuracy, closes float seams."""


def pack_road_map(road_map: RoadMap) -> dict[str, Any]:
    """A road map as JSON values that `unpack_road_map` reads; geometries are exact."""
    return {
        "location": road_map.location,
        "canvas_m": list(road_map.canvas_m),
        "drivable_area": _encode_wkb(road_map.drivable_area),
        "intersections": sorted(road_map.intersections),
        "lanes": [
            {
                "identifier": lane.identifier,
                "centerline": np.asarray(lane.centerline, np.float64).tolist(),
                "polygon": None if lane.polygon is None else _encode_wkb(lane.polygon),
                "successors": list(lane.successors),
                "predecessors": list(lane.predecessors),
                "is_connector": lane.is_connector,
            }
            for _, lane in sorted(road_map.lanes.items())
        ],
        "dividers": [
            {
                "identifier": divider.identifier,
                "line": np.asarray(divider.line, np.float64).tolist(),
                "kind": divider.kind.value,
                "between_directions": divider.between_directions,
            }
            for divider in sorted(road_map.dividers, key=lambda divider: divider.identifier)
        ],
        **{
            layer: {name: _encode_wkb(shape) for name, shape in getattr(road_map, layer).items()}
            for layer in _POLYGON_LAYERS
        },
        **({"stop_line_types": dict(road_map.stop_line_types)} if road_map.stop_line_types else {}),
    }


def unpack_road_map(packed: dict[str, Any]) -> RoadMap:
    """The road map that `pack_road_map` was given."""
    lanes = {
        row["identifier"]: Lane(
            row["identifier"],
            np.array(row["centerline"], np.float64),
            None if row["polygon"] is None else shapely.from_wkb(row["polygon"]),
            tuple(row["successors"]),
            tuple(row["predecessors"]),
            row["is_connector"],
        )
        for row in packed["lanes"]
    }
    dividers = tuple(
        Divider(
            row["identifier"], np.array(row["line"], np.float64), DividerKind(row["kind"]), row["between_directions"]
        )
        for row in packed["dividers"]
    )
    # Fragments of earlier releases have no road blocks.
    layers = {
        layer: {name: shapely.from_wkb(wkb) for name, wkb in packed.get(layer, {}).items()} for layer in _POLYGON_LAYERS
    }
    width, height = packed["canvas_m"]
    return RoadMap(
        location=packed["location"],
        drivable_area=shapely.from_wkb(packed["drivable_area"]),
        lanes=lanes,
        dividers=dividers,
        intersections=frozenset(packed["intersections"]),
        canvas_m=(width, height),
        stop_line_types=packed.get("stop_line_types", {}),
        **layers,
    )


def merge_road_maps(parts: Sequence[RoadMap]) -> RoadMap:
    """One map out of several, possibly overlapping, parts of a place with the same identifiers for the same things.

    Layers are joined by identifier (of two versions the longer line or larger surface stays), drivable areas united, on
    a canvas that holds everything.
    """
    if len(parts) == 1:
        road_map = parts[0]
    else:
        areas = [part.drivable_area for part in parts]
        road_map = RoadMap(
            location=parts[0].location,
            drivable_area=as_multipolygon(shapely.union_all(areas, grid_size=_SNAP_M)),
            lanes=_merge_lanes(parts),
            dividers=_merge_dividers(parts),
            intersections=frozenset[str]().union(*(part.intersections for part in parts)),
            canvas_m=(max(part.canvas_m[0] for part in parts), max(part.canvas_m[1] for part in parts)),
            stop_line_types={name: kind for part in parts for name, kind in part.stop_line_types.items()},
            **{layer: _merge_polygons(getattr(part, layer) for part in parts) for layer in _POLYGON_LAYERS},
        )
    return replace(road_map, canvas_m=_compute_canvas(road_map))


_POLYGON_LAYERS = ("ped_crossings", "walkways", "road_segments", "stop_lines", "carparks", "road_blocks")


def _compute_canvas(road_map: RoadMap) -> tuple[float, float]:
    """The map's own canvas, enlarged to whole metres where geometry sticks out of it."""
    shapes: list[shapely.Geometry] = [road_map.drivable_area]
    shapes += [shape for layer in _POLYGON_LAYERS for shape in getattr(road_map, layer).values()]
    shapes += [shapely.LineString(lane.centerline) for lane in road_map.lanes.values()]
    bounds = np.array([shape.bounds for shape in shapes if not shape.is_empty]).reshape(-1, 4)
    if not len(bounds):
        return max(road_map.canvas_m[0], 1.0), max(road_map.canvas_m[1], 1.0)
    reach = np.ceil(bounds[:, 2:].max(axis=0))
    return max(road_map.canvas_m[0], float(reach[0]), 1.0), max(road_map.canvas_m[1], float(reach[1]), 1.0)


def _merge_lanes(parts: Sequence[RoadMap]) -> dict[str, Lane]:
    lanes: dict[str, Lane] = {}
    for part in parts:
        for name, lane in part.lanes.items():
            known = lanes.get(name)
            if known is None:
                lanes[name] = lane
                continue
            longer = max(known, lane, key=lambda candidate: _compute_length(candidate.centerline))
            lanes[name] = replace(
                longer,
                successors=tuple(sorted({*known.successors, *lane.successors})),
                predecessors=tuple(sorted({*known.predecessors, *lane.predecessors})),
            )
    return dict(sorted(lanes.items()))


def _merge_dividers(parts: Sequence[RoadMap]) -> tuple[Divider, ...]:
    dividers: dict[str, Divider] = {}
    for part in parts:
        for divider in part.dividers:
            known = dividers.get(divider.identifier)
            if known is None or _compute_length(divider.line) > _compute_length(known.line):
                dividers[divider.identifier] = divider
    return tuple(dividers[name] for name in sorted(dividers))


def _merge_polygons(layers: Iterable[dict[str, Polygon]]) -> dict[str, Polygon]:
    polygons: dict[str, Polygon] = {}
    for layer in layers:
        for name, shape in layer.items():
            if name not in polygons or shape.area > polygons[name].area:
                polygons[name] = shape
    return dict(sorted(polygons.items()))


def _compute_length(line: Any) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _encode_wkb(shape: shapely.Geometry) -> str:
    return str(shapely.to_wkb(shape, hex=True))
