"""Map elements around a sample as SparseDrive's infos hold them: lines in the lidar frame, by class.

Where a ring begins, and whether it has vertices on a straight line, depends on the version of GEOS.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import LinearRing, LineString, MultiLineString, MultiPolygon, Polygon
from shapely.ops import linemerge, unary_union

from benchmark.datasets.schema.sidecar_files import MAP_NODE, MAP_RECORD, require_records
from benchmark.errors import InputError
from benchmark.extensions.infos.frames import SensorFrame, compute_heading
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.untrusted.files import to_one_line

DIVIDER, CROSSING, BOUNDARY = 1, 0, 2
PATCH_M: Final = (30.0, 60.0)
"""Size of what is cut out, along the x and the y axis of the lidar."""
_EDGE_M: Final = 0.2
"""By which the patch is made smaller for boundaries, so that its own edges are none."""
_PARALLEL: Final = 0.01
_DIVIDERS: Final = ("lane_divider", "road_divider")
_ROADS: Final = ("road_segment", "lane")
_CROSSINGS: Final = "ped_crossing"

MapElements = dict[int, list[Floats]]


class _MapLayer:
    """Shapes of a layer in the order of its records, found by where they are."""

    def __init__(self, shapes: Iterable[shapely.Geometry]) -> None:
        self._shapes = [shape for shape in shapes if not shape.is_empty]
        self._tree = shapely.STRtree(self._shapes)

    def cut(self, patch: Polygon) -> Iterator[shapely.Geometry]:
        """Parts of shapes in a patch, shape by shape."""
        for number in sorted(self._tree.query(patch).tolist()):
            piece = self._shapes[number].intersection(patch)
            if not piece.is_empty:
                yield piece


class MapLines:
    """Lines of one city's map, read from ``maps/expansion/<location>.json``."""

    def __init__(self, path: Path) -> None:
        self._path, stored = path, read_json(path)
        if not isinstance(stored, dict):
            raise InputError(f"{path} must be a map expansion, an object of layers; fetch or make it again")
        try:
            require_records(path, "node", stored["node"], MAP_NODE)
            for layer in ("polygon", "line"):
                require_records(path, f"{layer} record", stored[layer], MAP_RECORD)
            self._layers = _build_layers(stored)
        except KeyError as error:
            raise InputError(
                f"{path}: layer or record {to_one_line(repr(error.args[0]))} is missing; the map expansion is "
                "incomplete, fetch or make it again"
            ) from error
        except (TypeError, ValueError, AttributeError, shapely.errors.ShapelyError) as error:
            raise self._malformed(error) from error

    def _malformed(self, error: Exception) -> InputError:
        return InputError(
            f"{self._path} is not a well-formed map expansion ({to_one_line(error)}); fetch or make it again"
        )

    def around(self, lidar: SensorFrame) -> MapElements:
        """(n, 2) lidar-frame lines within 15 m beside and 30 m along it: dividers, crossings, boundaries."""
        try:
            return self._around(lidar)
        except shapely.errors.ShapelyError as error:
            raise self._malformed(error) from error

    def _around(self, lidar: SensorFrame) -> MapElements:
        patch = _LidarPatch(lidar)
        roads = [patch.local(piece) for name in _ROADS for piece in self._layers[name].cut(patch.area)]
        return {
            DIVIDER: _to_points(
                patch.local(piece) for name in _DIVIDERS for piece in self._layers[name].cut(patch.area)
            ),
            CROSSING: _merge_crossings([patch.local(piece) for piece in self._layers[_CROSSINGS].cut(patch.area)]),
            BOUNDARY: _find_boundaries(roads),
        }


def _build_layers(stored: Mapping[str, Any]) -> dict[str, _MapLayer]:
    nodes = {row["token"]: (row["x"], row["y"]) for row in stored["node"]}
    lines = {row["token"]: row["node_tokens"] for row in stored["line"]}
    polygons = {row["token"]: row for row in stored["polygon"]}

    def line(token: str) -> LineString:
        return LineString([nodes[name] for name in lines[token]])

    def polygon(token: str) -> Polygon:
        row = polygons[token]
        holes = [hole["node_tokens"] for hole in row["holes"] if hole["node_tokens"]]
        outline = Polygon(
            [nodes[name] for name in row["exterior_node_tokens"]], [[nodes[name] for name in hole] for hole in holes]
        )
        # The converters leave out invalid geometry.
        return outline if outline.is_valid else Polygon()

    return {
        **{name: _MapLayer(line(row["line_token"]) for row in stored[name]) for name in _DIVIDERS},
        **{name: _MapLayer(polygon(row["polygon_token"]) for row in stored[name]) for name in (*_ROADS, _CROSSINGS)},
    }


class _LidarPatch:
    """The rectangle around a lidar, turned with its x axis in the plane."""

    def __init__(self, lidar: SensorFrame) -> None:
        self._x, self._y = lidar.origin[:2].tolist()
        self._degrees = float(np.degrees(compute_heading(lidar.rotation)))
        half_x, half_y = PATCH_M[0] / 2, PATCH_M[1] / 2
        upright = shapely.box(self._x - half_x, self._y - half_y, self._x + half_x, self._y + half_y)
        self.area = affinity.rotate(upright, self._degrees, origin=(self._x, self._y))

    def local(self, shape: shapely.Geometry) -> shapely.Geometry:
        """A shape in the frame of the lidar."""
        turned = affinity.rotate(shape, -self._degrees, origin=(self._x, self._y))
        return affinity.translate(turned, -self._x, -self._y)


def _split_pieces(shapes: Iterable[shapely.Geometry], kind: type[shapely.Geometry]) -> list[Any]:
    """Single lines or polygons; points, which are left where shapes touch the patch, are none."""
    pieces: list[shapely.Geometry] = []
    for shape in shapes:
        pieces += [
            piece for piece in getattr(shape, "geoms", [shape]) if isinstance(piece, kind) and not piece.is_empty
        ]
    return pieces


def _to_points(lines: Iterable[shapely.Geometry]) -> list[Floats]:
    return [np.array(line.coords)[:, :2] for line in _split_pieces(lines, LineString)]


def _local_area(margin_m: float) -> Polygon:
    half_x, half_y = PATCH_M[0] / 2 - margin_m, PATCH_M[1] / 2 - margin_m
    return shapely.box(-half_x, -half_y, half_x, half_y)


def _merge_crossings(shapes: Sequence[shapely.Geometry]) -> list[Floats]:
    """Outlines of crossings, of which those that run alike and meet are one."""
    area, outlines = _local_area(0.0), []
    for crossing in _split_pieces(_join_crossings(_split_pieces(shapes, Polygon)), Polygon):
        outline = _orient_ring(crossing.exterior, clockwise=False).intersection(area)
        if isinstance(outline, MultiLineString):
            outline = linemerge(outline)
        parts = _to_points([outline])
        if parts:
            outlines.append(np.concatenate(parts))
    return outlines


def _join_crossings(crossings: Sequence[Polygon]) -> list[Polygon | MultiPolygon]:
    """Crossings, each with all later ones whose bounding box overlaps its own and whose long side is parallel."""
    if not crossings:
        return []
    bounds = shapely.bounds(crossings)
    sides = np.array([_long_side(crossing) for crossing in crossings])
    waiting, joined = list(range(len(crossings))), []
    while waiting:
        first, *rest = waiting
        apart = (bounds[rest, :2] > bounds[first, 2:]).any(axis=1) | (bounds[rest, 2:] < bounds[first, :2]).any(axis=1)
        parallel = 1 - np.abs(sides[rest] @ sides[first]) < _PARALLEL
        own = [number for number, joins in zip(rest, ~apart & parallel, strict=True) if joins]
        union: Polygon | MultiPolygon = crossings[first]
        for number in own:
            union = union.union(crossings[number])
        joined.append(union)
        waiting = [number for number in rest if number not in own]
    return joined


def _long_side(crossing: Polygon) -> Floats:
    """(2,) direction of the longer side of the smallest rectangle around a crossing."""
    corners = np.array(crossing.minimum_rotated_rectangle.exterior.coords)[:3]
    sides = np.diff(corners, axis=0)
    lengths = np.linalg.norm(sides, axis=1)
    longer = int(lengths.argmax())
    return np.asarray(sides[longer] / lengths[longer])


def _find_boundaries(roads: Sequence[shapely.Geometry]) -> list[Floats]:
    """Edges of the united roads: outlines first, then holes."""
    united = _split_pieces([unary_union(_split_pieces(roads, Polygon))], Polygon)
    outlines = [_orient_ring(road.exterior, clockwise=True) for road in united]
    holes = [_orient_ring(hole, clockwise=False) for road in united for hole in road.interiors]
    area = _local_area(_EDGE_M)
    cut = (ring.intersection(area) for ring in (*outlines, *holes))
    return _to_points(linemerge(line) if isinstance(line, MultiLineString) else line for line in cut)


def _orient_ring(ring: LinearRing, *, clockwise: bool) -> LinearRing:
    return LinearRing(ring.coords[::-1]) if ring.is_ccw == clockwise else ring
