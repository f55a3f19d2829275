"""Flat painting of a map: road surfaces and markings as polygons, drawn into any plan view."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon
from shapely.ops import substring

from benchmark.geometry import Floats
from benchmark.road_map import Divider, DividerKind, RoadMap

SHIFT = 4
"""Binary digits of the fraction in OpenCV's coordinates."""
_LINE_WIDTH_M = 0.15
_DASH_M, _GAP_M = 3.0, 5.0
_STRIPE_M = 0.5
_STOP_BAR_M = 0.4
_KERB_M = 0.22


class PaintCoat(IntEnum):
    """Paint of a polygon; later coats cover earlier ones."""

    CAR_PARK = 0
    PAVEMENT = 1
    KERB = 2
    ROAD = 3
    WHITE = 4
    YELLOW = 5


@dataclass(frozen=True, slots=True)
class PaintedPolygons:
    """Polygons of one coat, outer ring and holes of (M, 2) global metres; bounds (P, 4) x_min, y_min, x_max, y_max."""

    coat: PaintCoat
    rings: tuple[tuple[Floats, ...], ...]
    bounds: Floats


def build_painted_polygons(road_map: RoadMap) -> tuple[PaintedPolygons, ...]:
    """Everything on the ground that has a colour of its own, lowest coat first."""
    roads = list(shapely.get_parts(road_map.drivable_area))
    white = [
        stripe for name in sorted(road_map.ped_crossings) for stripe in _build_stripes(road_map.ped_crossings[name])
    ]
    white += [bar for name in sorted(road_map.stop_lines) for bar in _build_stop_bar(road_map.stop_lines[name])]
    yellow: list[shapely.Geometry] = []
    for divider in road_map.dividers:
        if divider.kind is not DividerKind.UNPAINTED:
            is_white = divider.kind in (DividerKind.SOLID_WHITE, DividerKind.DASHED_WHITE)
            (white if is_white else yellow).extend(_build_line_paint(divider))
    coats: dict[PaintCoat, Iterable[shapely.Geometry]] = {
        PaintCoat.CAR_PARK: [road_map.carparks[name] for name in sorted(road_map.carparks)],
        PaintCoat.PAVEMENT: [road_map.walkways[name] for name in sorted(road_map.walkways)],
        PaintCoat.KERB: [shape.buffer(_KERB_M, join_style="mitre") for shape in roads],
        PaintCoat.ROAD: roads,
        PaintCoat.WHITE: white,
        PaintCoat.YELLOW: yellow,
    }
    return tuple(_build_polygons(coat, shapes) for coat, shapes in coats.items())


def paint(
    canvas: NDArray[np.uint8],
    polygons: tuple[PaintedPolygons, ...],
    world_to_pixel: Floats,
    colours: Mapping[PaintCoat, tuple[float, float, float]],
) -> None:
    """Fill polygons in a plan view, (h, w, 3) RGB, in place; coats without a colour are left out.

    ``world_to_pixel`` is the (2, 3) affine map from metres to columns and rows.
    """
    window = _compute_world_window(canvas, world_to_pixel)
    for layer in polygons:
        if layer.coat not in colours or not len(layer.rings):
            continue
        low, high = layer.bounds[:, :2], layer.bounds[:, 2:]
        inside = ((low <= window[2:]) & (high >= window[:2])).all(axis=1)
        colour = colours[layer.coat]
        simple: list[NDArray[np.int32]] = []
        for index in np.flatnonzero(inside):
            rings = [
                to_fixed_point(ring @ world_to_pixel[:, :2].T + world_to_pixel[:, 2]) for ring in layer.rings[index]
            ]
            if layer.coat >= PaintCoat.WHITE and len(rings) == 1:
                simple.append(rings[0])
            else:
                cv2.fillPoly(canvas, rings, colour, cv2.LINE_AA, SHIFT)
        for ring in simple:
            cv2.fillPoly(canvas, [ring], colour, cv2.LINE_AA, SHIFT)


def to_fixed_point(pixels: Floats) -> NDArray[np.int32]:
    """(..., 2) pixels in the sixteenths that OpenCV's drawing takes."""
    return np.asarray(np.rint(np.clip(pixels, -1e6, 1e6) * (1 << SHIFT)), dtype=np.int32)


def _compute_world_window(canvas: NDArray[np.uint8], world_to_pixel: Floats) -> Floats:
    height, width = canvas.shape[:2]
    corners = np.array([[0, 0], [width, 0], [0, height], [width, height]], dtype=np.float64)
    world = (corners - world_to_pixel[:, 2]) @ np.linalg.inv(world_to_pixel[:, :2]).T
    return np.concatenate([world.min(axis=0), world.max(axis=0)])


def _build_polygons(coat: PaintCoat, shapes: Iterable[shapely.Geometry]) -> PaintedPolygons:
    parts = [part for shape in shapes for part in shapely.get_parts(shape)]
    parts = [part for part in parts if isinstance(part, Polygon) and not part.is_empty]
    rings = tuple(
        tuple(np.asarray(ring.coords, np.float64)[:, :2] for ring in (part.exterior, *part.interiors)) for part in parts
    )
    bounds = np.array([part.bounds for part in parts], dtype=np.float64).reshape(-1, 4)
    return PaintedPolygons(coat, rings, bounds)


def _build_line_paint(divider: Divider) -> list[shapely.Geometry]:
    line = shapely.LineString(divider.line)
    if line.length == 0.0:
        return []
    if divider.kind in (DividerKind.DASHED_WHITE, DividerKind.DASHED_YELLOW):
        starts = np.arange(0.0, line.length, _DASH_M + _GAP_M)
        strips = [substring(line, start, start + _DASH_M) for start in starts]
        strips = [strip for strip in strips if strip.length > 0.0]
    else:
        strips = [line]
    return [strip.buffer(_LINE_WIDTH_M / 2, cap_style="flat", join_style="mitre") for strip in strips]


def _build_stripes(crossing: Polygon) -> list[shapely.Geometry]:
    """Zebra stripes: bars along the driving direction, repeated along the long side, which people walk along."""
    corner, along, across, length, width = _find_long_side(crossing)
    count = int(length // (2 * _STRIPE_M))
    if count == 0 or width == 0.0:
        return []
    start = 0.5 * (length - (2 * count - 1) * _STRIPE_M)
    bars = []
    for index in range(count):
        near = corner + (start + 2 * index * _STRIPE_M) * along
        far = near + _STRIPE_M * along
        bars.append(Polygon([near, far, far + width * across, near + width * across]).intersection(crossing))
    return bars


def _build_stop_bar(stop_area: Polygon) -> list[shapely.Geometry]:
    """One bar in the middle of a stop area, because sources draw the area in which to stop, not the paint."""
    corner, along, across, length, width = _find_long_side(stop_area)
    bar = min(_STOP_BAR_M, width)
    if length == 0.0 or bar == 0.0:
        return []
    near = corner + 0.5 * (width - bar) * across
    return [Polygon([near, near + length * along, near + length * along + bar * across, near + bar * across])]


def _find_long_side(shape: Polygon) -> tuple[Floats, Floats, Floats, float, float]:
    """Corner, unit vectors along and across the long side, and both lengths of the tightest rectangle."""
    box = shape.minimum_rotated_rectangle
    if not isinstance(box, Polygon):
        return np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), 0.0, 0.0
    corners = np.asarray(box.exterior.coords, np.float64)[:4]
    first, second = corners[1] - corners[0], corners[3] - corners[0]
    if np.linalg.norm(first) < np.linalg.norm(second):
        first, second = second, first
    length, width = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    return corners[0], first / length, second / max(width, 1e-9), length, width
