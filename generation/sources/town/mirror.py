"""Left-hand traffic: a town whose traffic keeps to the right, seen in a mirror along the x axis of its map."""

from dataclasses import replace
from typing import Any, TypeVar, cast

import numpy as np
import shapely
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.road_map import Divider, RoadMap, as_multipolygon
from generation.sources.town.network import CANVAS_M

_Shape = TypeVar("_Shape", bound=shapely.Geometry)


def mirror_points(points: Floats) -> Floats:
    """(..., 2) points, or (..., 3) poses x, y, yaw, in the mirror."""
    mirrored = np.array(points, np.float64)
    mirrored[..., 1] = CANVAS_M - mirrored[..., 1]
    mirrored[..., 2:] *= -1.0
    return mirrored


def mirror_map(road_map: RoadMap) -> RoadMap:
    """A map in the mirror; lanes lead where they led.

    Mirrored coordinates round otherwise, so that a spike of a polygon may cross itself: its largest part is taken.
    """

    def mirror(shape: _Shape) -> _Shape:
        mirrored: _Shape = shapely.transform(shape, mirror_points)
        if mirrored.is_valid:
            return mirrored
        parts = as_multipolygon(shapely.make_valid(mirrored))
        mended: Any = max(parts.geoms, key=lambda part: part.area) if isinstance(shape, Polygon) else parts
        return cast("_Shape", mended)

    def mirror_all(shapes: dict[str, Polygon]) -> dict[str, Polygon]:
        return {name: mirror(shape) for name, shape in shapes.items()}

    lanes = {
        name: replace(
            lane,
            centerline=mirror_points(lane.centerline),
            polygon=None if lane.polygon is None else mirror(lane.polygon),
        )
        for name, lane in road_map.lanes.items()
    }
    dividers = (
        Divider(line.identifier, mirror_points(line.line), line.kind, line.between_directions)
        for line in road_map.dividers
    )
    return replace(
        road_map,
        drivable_area=mirror(road_map.drivable_area),
        lanes=lanes,
        dividers=tuple(dividers),
        ped_crossings=mirror_all(road_map.ped_crossings),
        walkways=mirror_all(road_map.walkways),
        road_segments=mirror_all(road_map.road_segments),
        stop_lines=mirror_all(road_map.stop_lines),
        carparks=mirror_all(road_map.carparks),
    )
