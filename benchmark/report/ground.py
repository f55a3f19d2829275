"""The road of a sheet, as areas and lines that are made ready once and drawn for every frame."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmark.geometry import Floats
from benchmark.records.scene_pages import PageDivider, Point, Polygon, ScenePage
from benchmark.report.canvas import GroundView, Picture, fill_rings, split_into_dashes, stroke, stroke_all
from benchmark.report.palette import ON_LIGHT, GroundColours, Rgb

_STRIPE_M: Final = 0.55
_STRIPE_EVERY_M: Final = 1.1
_DASH_M: Final = 3.0
_SMALLEST_STRIPE_PX: Final = 1.2
"""Thinner stripes of a crossing are a grey noise; its area is drawn plain."""

Area = tuple[Floats, ...]
"""Rings of a polygon, or lines; each (M, 2)."""


@dataclass(frozen=True, slots=True)
class GroundLayer:
    """Areas or lines of one colour, each within a circle: ``centres`` (N, 2), ``reaches_m`` (N,)."""

    areas: tuple[Area, ...]
    centres: Floats
    reaches_m: Floats
    colour: Rgb

    @classmethod
    def of(cls, areas: Iterable[Area], colour: Rgb) -> "GroundLayer":
        """A layer of areas; those without points are left out."""
        visible_areas = tuple(area for area in areas if area and len(area[0]))
        points = [np.concatenate(area) for area in visible_areas]
        centres = np.array([0.5 * (corners.min(axis=0) + corners.max(axis=0)) for corners in points]).reshape(-1, 2)
        reaches = [np.hypot(*(corners - centre).T).max() for corners, centre in zip(points, centres)]
        return cls(visible_areas, centres, np.array(reaches, np.float64), colour)

    def near(self, view: GroundView) -> list[Area]:
        """Areas that may be seen."""
        return [self.areas[index] for index in view.near(self.centres, self.reaches_m)]


@dataclass(frozen=True, slots=True)
class PageGround:
    """The map of one sheet: pavements below, car parks and crossings above, the crossings' stripes, painted lines."""

    below: GroundLayer
    drivable: GroundLayer
    above: tuple[GroundLayer, ...]
    stripes: GroundLayer
    paint: tuple[GroundLayer, ...]
    colours: GroundColours


def build_ground(sheet: ScenePage, colours: GroundColours = ON_LIGHT) -> PageGround:
    """Make a sheet's map ready; it is empty where the sheet has none."""
    road = sheet.road
    crossings = [area for area in _areas(road.crossings) if area]
    strokes = {
        name: [_strokes(line) for line in road.dividers if line.paint.endswith(f"-{name}")] for name in colours.paint
    }
    return PageGround(
        below=GroundLayer.of(_areas(road.walkways), colours.walkway),
        drivable=GroundLayer.of(_areas(road.drivable), colours.road),
        above=(GroundLayer.of(_areas(road.carparks), colours.car_park), GroundLayer.of(crossings, colours.crossing)),
        stripes=GroundLayer.of((_stripes(area[0]) for area in crossings), colours.stripe),
        paint=tuple(
            GroundLayer.of(((stroke,) for line in lines for stroke in line), colours.paint[name])
            for name, lines in strokes.items()
        ),
        colours=colours,
    )


def draw_ground(image: Picture, view: GroundView, ground: PageGround) -> None:
    """Fill a picture with the map."""
    cv2.rectangle(image, (0, 0), (view.width_px, view.height_px), ground.colours.land, -1)
    _fill(image, view, ground.below)
    # First all kerbs, then all surfaces: between two surfaces that touch there is no kerb.
    for area in ground.drivable.near(view):
        for ring in area:
            stroke(image, view, ring, ground.colours.kerb, 3, closed=True)
    for layer in (ground.drivable, *ground.above):
        _fill(image, view, layer)
    if _STRIPE_M * view.scale_px_m >= _SMALLEST_STRIPE_PX:
        _fill(image, view, ground.stripes)
    for layer in ground.paint:
        stroke_all(image, view, [line for (line,) in layer.near(view)], layer.colour, 1)


def _fill(image: Picture, view: GroundView, layer: GroundLayer) -> None:
    for area in layer.near(view):
        fill_rings(image, view, area, layer.colour)


def _areas(polygons: Iterable[Polygon]) -> list[Area]:
    return [tuple(_points(ring) for ring in polygon if len(ring) > 2) for polygon in polygons]


def _strokes(line: PageDivider) -> list[Floats]:
    points = _points(line.points)
    if len(points) < 2:
        return []
    return split_into_dashes(points, (_DASH_M, _DASH_M)) if line.paint.startswith("dashed") else [points]


def _points(points: Iterable[Point]) -> Floats:
    return np.array(tuple(points), np.float64).reshape(-1, 2)


def _stripes(ring: Floats) -> Area:
    """Stripes across the longer axis of the rectangle around a crossing."""
    origin = ring.mean(axis=0)
    (x, y), (width, height), degrees = cv2.minAreaRect((ring - origin).astype(np.float32))
    turn = np.radians(degrees)
    long, short = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    if height > width:
        long, short, width, height = short, long, height, width
    count = max(int((width - _STRIPE_M) / _STRIPE_EVERY_M) + 1, 1)
    first = -0.5 * (count - 1) * _STRIPE_EVERY_M
    middle, across = origin + (x, y), 0.42 * height * short
    stripes = []
    for number in range(count):
        near = middle + (first + number * _STRIPE_EVERY_M - 0.5 * _STRIPE_M) * long
        far = near + _STRIPE_M * long
        stripes.append(np.array([near - across, near + across, far + across, far - across]))
    return tuple(stripes)
