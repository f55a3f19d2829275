"""Raster maps: the binary mask that the devkit loads with the tables, and the background picture of map plots."""

import struct
import zlib
from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from benchmark.road_map import RoadMap, as_multipolygon

MASK_RESOLUTION_M: Final = 0.1
"""What ``MapMask`` of the devkit takes for granted."""
_BASEMAP_LONGEST_PX: Final = 4000
_BAND_ROWS: Final = 512
_SUBPIXEL_BITS: Final = 4
_WALKWAY_GREY: Final = 190
_ROAD_GREY: Final = 110
_CROSSING_GREY: Final = 160
_GROUND_GREY: Final = 235


def drivable_mask(road_map: RoadMap) -> bytes:
    """PNG of the drivable area: 255 inside, 0 outside, 0.1 m a pixel, north up over the whole canvas.

    Drawn and compressed in bands, because nuScenes' own canvases have up to 1.2 billion pixels.
    """
    return _png(road_map.canvas_m, MASK_RESOLUTION_M, [(road_map.drivable_area, 255)], ground=0)


def basemap(road_map: RoadMap) -> bytes:
    """PNG in shades of grey for map plots: pavements, roads and crossings, at most 4000 pixels long.

    The devkit stretches it over the whole canvas.
    """
    resolution = max(MASK_RESOLUTION_M, max(road_map.canvas_m) / _BASEMAP_LONGEST_PX)
    layers: list[tuple[shapely.Geometry, int]] = [(shape, _WALKWAY_GREY) for shape in road_map.walkways.values()]
    layers.append((road_map.drivable_area, _ROAD_GREY))
    layers += [(shape, _CROSSING_GREY) for shape in road_map.ped_crossings.values()]
    return _png(road_map.canvas_m, resolution, layers, ground=_GROUND_GREY)


def _png(
    canvas_m: tuple[float, float], resolution_m: float, layers: list[tuple[shapely.Geometry, int]], *, ground: int
) -> bytes:
    width, height = (max(1, round(side / resolution_m)) for side in canvas_m)
    compressor = zlib.compressobj(6, strategy=zlib.Z_RLE)
    packed = []
    for band in _bands(width, height, resolution_m, layers, ground):
        rows = np.zeros((len(band), width + 1), np.uint8)
        rows[:, 1:] = band
        packed.append(compressor.compress(rows.tobytes()))
    packed.append(compressor.flush())
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", b"".join(packed)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _bands(
    width: int, height: int, resolution_m: float, layers: list[tuple[shapely.Geometry, int]], ground: int
) -> Iterator[NDArray[np.uint8]]:
    rings = [
        (piece.bounds, [_pixels(ring, resolution_m, height) for ring in _rings(piece)], shade)
        for shape, shade in layers
        for piece in as_multipolygon(shape).geoms
    ]
    for top in range(0, height, _BAND_ROWS):
        rows = min(_BAND_ROWS, height - top)
        band = np.full((rows, width), ground, np.uint8)
        y_low, y_high = (height - top - rows - 1) * resolution_m, (height - top + 1) * resolution_m
        for bounds, outlines, shade in rings:
            if bounds[1] <= y_high and bounds[3] >= y_low:
                shifted = [outline - np.array([0, top << _SUBPIXEL_BITS], np.int32) for outline in outlines]
                cv2.fillPoly(band, shifted, (shade,), shift=_SUBPIXEL_BITS)
        yield band


def _rings(polygon: Polygon) -> list[NDArray[np.float64]]:
    return [np.array(ring.coords)[:, :2] for ring in (polygon.exterior, *polygon.interiors)]


def _pixels(ring: NDArray[np.float64], resolution_m: float, height: int) -> NDArray[np.int32]:
    """Fixed-point pixel coordinates; a pixel's centre is its index, as in ``MapMask.to_pixel_coords``."""
    pixels = np.column_stack([ring[:, 0] / resolution_m, height - ring[:, 1] / resolution_m])
    return np.asarray(np.round(pixels * (1 << _SUBPIXEL_BITS)), np.int32)
