"""The road around the ego's way, as small as it can be and still look the same."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPoint, Polygon

from benchmark.geometry import Floats
from benchmark.records.scenes import Point, Ring, SheetLine, SheetMap
from benchmark.records.scenes import Polygon as SheetPolygon
from benchmark.road_map import RoadMap, as_multipolygon

AROUND_M: Final = 70.0
"""The road reaches this far around the ego's way."""
_SIMPLIFIED_M: Final = 0.05
_LEAST_AREA_M2: Final = 0.05


def road_around(road_map: RoadMap, way: Floats, origin: Point) -> SheetMap:
    """Layers of a map within `AROUND_M` of the ego's way, simplified to 5 cm and rounded to centimetres.

    Rings are closed: their last point is their first.

    Args:
        way: (T, 2) positions of the ego, global.
        origin: What positions become relative to.
    """
    window = _corridor(way)
    near = road_map.near(shapely.bounds(window).tolist())

    def polygons(shapes: Iterable[shapely.Geometry]) -> tuple[SheetPolygon, ...]:
        return tuple(polygon for shape in shapes for polygon in _polygons(shape, window, origin))

    lines = []
    for divider in near.dividers:
        for points in _lines(divider.line, window, origin):
            lines.append(SheetLine(points=points, paint=divider.kind.value))
    return SheetMap(
        drivable=polygons([near.drivable_area]),
        crossings=polygons(_in_order(near.ped_crossings)),
        walkways=polygons(_in_order(near.walkways)),
        carparks=polygons(_in_order(near.carparks)),
        dividers=tuple(lines),
    )


def _corridor(way: Floats) -> Polygon:
    points = MultiPoint(np.unique(way, axis=0))
    line = LineString(way).simplify(1.0) if len(points.geoms) > 1 else points.geoms[0]
    return line.buffer(AROUND_M, quad_segs=4)


def _in_order(layer: dict[str, Polygon]) -> list[Polygon]:
    return [layer[name] for name in sorted(layer)]


def _polygons(shape: shapely.Geometry, window: Polygon, origin: Point) -> list[SheetPolygon]:
    sound = shape if shape.is_valid else shapely.make_valid(shape)
    simple = shapely.simplify(as_multipolygon(shapely.intersection(sound, window)), _SIMPLIFIED_M)
    found = []
    for part in as_multipolygon(simple).geoms:
        if part.area >= _LEAST_AREA_M2:
            holes = [hole for hole in part.interiors if Polygon(hole).area >= _LEAST_AREA_M2]
            found.append(tuple(_rounded(ring.coords, origin) for ring in (part.exterior, *holes)))
    return found


def _lines(line: Floats, window: Polygon, origin: Point) -> list[Ring]:
    inside = shapely.simplify(shapely.intersection(LineString(line), window), _SIMPLIFIED_M)
    parts = [part for part in shapely.get_parts(inside) if isinstance(part, LineString) and part.length > 0]
    return [_rounded(part.coords, origin) for part in parts]


def _rounded(points: Sequence[Sequence[float]], origin: Point) -> Ring:
    # Adding zero turns a negative zero into zero.
    places = np.round(np.asarray(points, np.float64)[:, :2] - origin, 2) + 0.0
    return tuple((float(x), float(y)) for x, y in places)
