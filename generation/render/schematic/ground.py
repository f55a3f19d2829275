"""The painted ground: plan views of the surroundings that cameras look at through a homography."""

import functools
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.road_map import RoadMap
from generation.render.schematic.atmosphere import (
    ASPHALT,
    CAR_PARK,
    GRASS,
    KERB,
    PAVEMENT,
    WET_ASPHALT,
    WHITE_PAINT,
    YELLOW_PAINT,
    Atmosphere,
    Rgb,
)
from generation.render.schematic.painting import PaintCoat, PaintedPolygons, build_painted_polygons, paint
from generation.render.schematic.styles import FIRST, STYLES, DrawingStyle, build_grain_tile

_STEP_M = 20.0
"""Plan views are centred on a grid of this width, so that what a frame shows does not depend on the frames before."""
_FINE_M, _COARSE_M = 0.05, 0.2
_FINE_REACH_M, _COARSE_REACH_M = 40.0, 140.0
FINE_UNTIL_M, MIDDLE_UNTIL_M = 9.0, 22.0
"""Depths at which a camera changes to the next coarser plan view."""


@dataclass(frozen=True, slots=True)
class PlanView:
    """A plan view, (n, n, 3) RGB with rows along -y; ``origin`` is x of the left and y of the upper edge, global."""

    pixels: NDArray[np.uint8]
    origin: Floats
    resolution_m: float

    @property
    def world_to_pixel(self) -> Floats:
        """(2, 3) affine map from metres to pixels whose integer values are pixel centres."""
        scale = 1.0 / self.resolution_m
        return np.array(
            [[scale, 0.0, -self.origin[0] * scale - 0.5], [0.0, -scale, self.origin[1] * scale - 0.5]], dtype=np.float64
        )


@dataclass(slots=True)
class PaintedGround:
    """Plan views around the ego, RGB by coat; ``base`` is that of the ground that nothing covers."""

    polygons: tuple[PaintedPolygons, ...]
    colours: dict[PaintCoat, Rgb]
    base: Rgb
    style: DrawingStyle = FIRST
    _centre: tuple[float, float] | None = field(default=None, init=False)
    _plans: tuple[PlanView, PlanView, PlanView] | None = field(default=None, init=False)

    @classmethod
    def of(cls, road_map: RoadMap, air: Atmosphere, style: DrawingStyle = FIRST) -> "PaintedGround":
        """The ground of a map; a map without roads is one plain of asphalt."""
        wet = air.wetness
        road = tuple((1 - wet) * dry + wet * damp for dry, damp in zip(ASPHALT, WET_ASPHALT))
        asphalt = (road[0], road[1], road[2])
        colours = {
            PaintCoat.CAR_PARK: CAR_PARK,
            PaintCoat.PAVEMENT: PAVEMENT,
            PaintCoat.KERB: KERB,
            PaintCoat.ROAD: asphalt,
            PaintCoat.WHITE: WHITE_PAINT,
            PaintCoat.YELLOW: YELLOW_PAINT,
        }
        colours = {coat: style.surface(coat, colour) for coat, colour in colours.items()}
        base = colours[PaintCoat.ROAD] if road_map.drivable_area.is_empty else GRASS
        return cls(build_painted_polygons(road_map), colours, base, style)

    def find_centre(self, position: Floats) -> tuple[float, float]:
        """Grid point that the plan views around a place are centred on."""
        x, y = np.round(np.asarray(position, np.float64) / _STEP_M) * _STEP_M
        return float(x), float(y)

    def around(self, position: Floats) -> tuple[PlanView, PlanView, PlanView]:
        """Fine, middle and coarse plan views around a place, (2,) metres, global."""
        centre = self.find_centre(position)
        if self._plans is None or centre != self._centre:
            snapped = np.array(centre)
            fine = self._paint_plan_view(snapped, _FINE_REACH_M, _FINE_M)
            half = (fine.pixels.shape[1] // 2, fine.pixels.shape[0] // 2)
            middle = PlanView(
                np.asarray(cv2.resize(fine.pixels, half, interpolation=cv2.INTER_AREA), np.uint8),
                fine.origin,
                2 * _FINE_M,
            )
            self._plans = (fine, middle, self._paint_plan_view(snapped, _COARSE_REACH_M, _COARSE_M))
            self._centre = centre
        return self._plans

    def _paint_plan_view(self, centre: Floats, reach_m: float, resolution_m: float) -> PlanView:
        count = round(2 * reach_m / resolution_m)
        # Whole rows are copied faster than three bytes after three bytes.
        pixels = np.empty((count, 3 * count), dtype=np.uint8)
        pixels[:] = np.tile(np.round(self.base).astype(np.uint8), count)
        pixels = pixels.reshape(count, count, 3)
        plan = PlanView(pixels, centre + np.array([-reach_m, reach_m]), resolution_m)
        paint(pixels, self.polygons, plan.world_to_pixel, self.colours)
        _add_grain(pixels, resolution_m, self.style)
        return plan


def _add_grain(pixels: NDArray[np.uint8], resolution_m: float, style: DrawingStyle) -> None:
    """Add the roughness of real surfaces, in place; its pattern repeats with the grid of centres."""
    lighter, darker = _build_grain(len(pixels), resolution_m, style.name)
    cv2.subtract(cv2.add(pixels, lighter, dst=pixels), darker, dst=pixels)


@functools.lru_cache(maxsize=4)
def _build_grain(count: int, resolution_m: float, name: str) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Grain that a style adds to a plan view of ``count`` pixels a side, and that it takes away; one of them is 0."""
    tile = build_grain_tile(round(_STEP_M / resolution_m), resolution_m, STYLES[name])
    repeats = -(-count // len(tile))
    around = np.tile(tile, (repeats, repeats, 1))[:count, :count]
    return np.maximum(around, 128) - np.uint8(128), np.uint8(128) - np.minimum(around, 128)
