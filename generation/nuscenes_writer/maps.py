"""The map files of a finished root, rasters for mask and background too: the source's, else made from road maps."""

import json
import os
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import Polygon

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.datasets.categories import LAYER
from benchmark.datasets.map_layers import make_empty_expansion, rename_layers
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, make_token, read_cached_json, read_json, write_bytes, write_json
from benchmark.road_map import RoadMap, as_multipolygon
from generation.nuscenes_writer.expansion import build_map_expansion
from generation.nuscenes_writer.plan import DataSetPlan
from generation.nuscenes_writer.road_maps import merge_road_maps, pack_road_map, unpack_road_map
from generation.nuscenes_writer.vocabulary import LabelVocabulary, Row

MASK_RESOLUTION_M: Final = 0.1
"""Resolution that ``MapMask`` of the devkit assumes."""
_BASEMAP_LONGEST_PX: Final = 4000
_BAND_ROWS: Final = 512
_SUBPIXEL_BITS: Final = 4
_WALKWAY_GREY: Final = 190
_ROAD_GREY: Final = 110
_CROSSING_GREY: Final = 160
_GROUND_GREY: Final = 235


def draw_drivable_mask(road_map: RoadMap) -> bytes:
    """PNG of the drivable area: 255 inside, 0 outside, 0.1 m a pixel, north up over the whole canvas.

    Drawn and compressed in bands, because nuScenes' own canvases have up to 1.2 billion pixels.
    """
    return _encode_png(road_map.canvas_m, MASK_RESOLUTION_M, [(road_map.drivable_area, 255)], ground=0)


def draw_basemap(road_map: RoadMap) -> bytes:
    """PNG in shades of grey, 4000 pixels at most, that the devkit stretches over the whole canvas of map plots."""
    resolution = max(MASK_RESOLUTION_M, max(road_map.canvas_m) / _BASEMAP_LONGEST_PX)
    layers: list[tuple[shapely.Geometry, int]] = [(shape, _WALKWAY_GREY) for shape in road_map.walkways.values()]
    layers.append((road_map.drivable_area, _ROAD_GREY))
    layers += [(shape, _CROSSING_GREY) for shape in road_map.ped_crossings.values()]
    return _encode_png(road_map.canvas_m, resolution, layers, ground=_GROUND_GREY)


def _encode_png(
    canvas_m: tuple[float, float], resolution_m: float, layers: list[tuple[shapely.Geometry, int]], *, ground: int
) -> bytes:
    width, height = (max(1, round(side / resolution_m)) for side in canvas_m)
    compressor = zlib.compressobj(6, strategy=zlib.Z_RLE)
    packed = []
    for band in _draw_bands(width, height, resolution_m, layers, ground):
        rows = np.zeros((len(band), width + 1), np.uint8)
        rows[:, 1:] = band
        packed.append(compressor.compress(rows.tobytes()))
    packed.append(compressor.flush())
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", b"".join(packed)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _draw_bands(
    width: int, height: int, resolution_m: float, layers: list[tuple[shapely.Geometry, int]], ground: int
) -> Iterator[NDArray[np.uint8]]:
    rings = [
        (piece.bounds, [_to_pixels(ring, resolution_m, height) for ring in _list_rings(piece)], shade)
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


def _list_rings(polygon: Polygon) -> list[NDArray[np.float64]]:
    return [np.array(ring.coords)[:, :2] for ring in (polygon.exterior, *polygon.interiors)]


def _to_pixels(ring: NDArray[np.float64], resolution_m: float, height: int) -> NDArray[np.int32]:
    """Fixed-point pixel coordinates; a pixel's centre is its index, as in ``MapMask.to_pixel_coords``."""
    pixels = np.column_stack([ring[:, 0] / resolution_m, height - ring[:, 1] / resolution_m])
    return np.asarray(np.round(pixels * (1 << _SUBPIXEL_BITS)), np.int32)


_DEVKIT_MASKS = {
    "singapore-onenorth": "53992ee3023e5494b90c316c183be829",
    "singapore-hollandvillage": "37819e65e09e5547b8a3ceaefba56bb2",
    "singapore-queenstown": "93406b464a165eaba6d9de76ca09f5da",
    "boston-seaport": "36092f0b03a857c6a3403e25b4b7aab3",
}
"""Mask names that the devkit's ``BitMap`` has built in."""


def write_maps(
    plan: DataSetPlan, root: Path, vocabulary: LabelVocabulary, fragments: Sequence[Mapping[str, Any]]
) -> tuple[list[Row], list[Row]]:
    """Write a root's ``maps`` folder; gives rows of the ``log`` and of the ``map`` table.

    Each of ``fragments`` has ``location``, ``map`` (key of the stored road map) and ``log`` (row) of a scene.
    """
    copied = _copy_source_maps(plan, root)
    logs = {row["token"]: row for row in (*vocabulary.log, *(fragment["log"] for fragment in fragments))}
    rows = [{**row, "log_tokens": list(row["log_tokens"])} for row in vocabulary.map]
    placed = {log_token for row in rows for log_token in row["log_tokens"]}
    for location in sorted({str(row["location"]) for row in logs.values()}):
        new_logs = sorted(name for name, row in logs.items() if row["location"] == location and name not in placed)
        same_place = (row for row in rows if any(_find_location(logs, name) == location for name in row["log_tokens"]))
        row = next(same_place, None)
        if row is None:
            mask_token = _DEVKIT_MASKS.get(location) or make_token("map", location)
            row = {"token": mask_token, "category": "semantic_prior", "filename": f"maps/{mask_token}.png"}
            rows.append({**row, "log_tokens": new_logs})
        else:
            row["log_tokens"] += new_logs
        keys = list(dict.fromkeys(str(part["map"]) for part in fragments if part["location"] == location))
        _draw_maps(plan, root, location, keys, mask=row["filename"], copied=copied)
    _add_empty_maps(root, {str(row["location"]) for row in logs.values()})
    return sorted(logs.values(), key=lambda row: str(row["token"])), rows


def _add_empty_maps(root: Path, locations: Collection[str]) -> None:
    """Maps of the other cities, which official code opens when it starts; those that are there stay."""
    for city in OFFICIAL_LOCATIONS:
        path = root / "maps" / "expansion" / f"{city}.json"
        if city not in locations and not path.is_file():
            write_json(path, make_empty_expansion(), indent=None)


def _find_location(logs: Mapping[str, Row], log_token: str) -> str | None:
    """Place where a log was recorded; the maps of v1.0-mini also list logs that only v1.0-trainval has."""
    return str(logs[log_token]["location"]) if log_token in logs else None


def _draw_maps(
    plan: DataSetPlan, root: Path, location: str, map_keys: list[str], *, mask: str, copied: frozenset[str]
) -> None:
    """Make the files of one place that were not copied; nothing is drawn twice from the same maps."""
    expansion, picture = f"maps/expansion/{location}.json", f"maps/basemap/{location}.png"
    wanted = [path for path in (mask, expansion, picture) if path not in copied]
    if not wanted:
        return
    parts = [unpack_road_map(read_json(plan.map_path(key))) for key in map_keys]
    road_map = merge_road_maps(parts) if parts else merge_road_maps([_build_empty_map(location)])
    if road_map.drivable_area.is_empty and location not in OFFICIAL_LOCATIONS and expansion in wanted:
        # A recording without a map: readers take an expansion for what is there.
        wanted.remove(expansion)
        (root / expansion).unlink(missing_ok=True)
    drawn_key = content_key(pack_road_map(road_map), _DRAWING_VERSION)
    note = plan.drawn_path(root) / f"{mask.replace('/', '_')}.json"
    finished = {"key": drawn_key, "files": wanted}
    if read_cached_json(note) == finished and all((root / path).is_file() for path in wanted):
        return
    note.unlink(missing_ok=True)
    if mask in wanted:
        write_bytes(root / mask, draw_drivable_mask(road_map))
    if expansion in wanted:
        write_json(root / expansion, build_map_expansion(road_map), indent=None)
    if picture in wanted:
        write_bytes(root / picture, draw_basemap(road_map))
    write_json(note, finished)


_DRAWING_VERSION = 1


def _build_empty_map(location: str) -> RoadMap:
    import shapely

    return RoadMap(location=location, drivable_area=shapely.MultiPolygon())


def _copy_source_maps(plan: DataSetPlan, root: Path) -> frozenset[str]:
    """Copy the source's ``maps`` folder whole; the paths below the root that came from there."""
    names = () if plan.source is None else tuple(pair for pair in plan.source.names if pair[0].startswith(LAYER))
    source = None if plan.source is None or plan.source.root is None else plan.source.root / "maps"
    if source is None or not source.is_dir():
        return frozenset()
    copied = set()
    for path in _list_files(source):
        relative = f"maps/{path.relative_to(source).as_posix()}"
        target = root / relative
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}; the new data set needs it") from error
        if names and path.parent.name == "expansion" and path.suffix == ".json":
            data = json.dumps(rename_layers(read_json(path), names)).encode()
        if not target.is_file() or target.read_bytes() != data:
            write_bytes(target, data)
        copied.add(relative)
    return frozenset(copied)


def _list_files(folder: Path) -> Iterator[Path]:
    """Files in a folder, through linked folders, each folder once."""
    visited = set()
    for parent, children, names in os.walk(folder, followlinks=True):
        real = os.path.realpath(parent)
        if real in visited:
            children.clear()
            continue
        visited.add(real)
        yield from (Path(parent) / name for name in sorted(names) if not name.startswith("."))
