"""Left-hand traffic: a town whose traffic keeps to the right, seen in a mirror along the x axis of its map."""

from dataclasses import replace

import numpy as np
import shapely
from shapely.geometry import Polygon

from benchmark.geometry import Floats
from benchmark.road_map import Divider, RoadMap, mend_polygon
from generation.sources.town.network import CANVAS_M


def mirror_points(points: Floats) -> Floats:
    """(..., 2) points, or (..., 3) poses x, y, yaw, in the mirror."""
    mirrored = np.array(points, np.float64)
    mirrored[..., 1] = CANVAS_M - mirrored[..., 1]
    mirrored[..., 2:] *= -1.0
    return mirrored


def mirror_map(road_map: RoadMap) -> RoadMap:
    """A map in the mirror; lanes lead where they led.

    Mirrored coordinates round otherwise, so that a spike of a polygon may cross itself: polygons are mended.
    """

    def mirror(shape: Polygon) -> Polygon:
        return mend_polygon(shapely.transform(shape, mirror_points))

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
        drivable_area=shapely.transform(road_map.drivable_area, mirror_points),
        lanes=lanes,
        dividers=tuple(dividers),
        ped_crossings=mirror_all(road_map.ped_crossings),
        walkways=mirror_all(road_map.walkways),
        road_segments=mirror_all(road_map.road_segments),
        stop_lines=mirror_all(road_map.stop_lines),
        carparks=mirror_all(road_map.carparks),
    )
