"""The roads around a sample from a scene's map: kerb lines and drivable cells, drawn when a protocol asks for them."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from benchmark.geometry import Bools, Floats, to_global
from benchmark.road_map import RoadMap, as_multipolygon

PATCH_M: Final = (102.4, 50.0)
"""Length and width of the patch around the rear axle in which road edges are looked for."""
_TRIM_M: Final = 0.2
"""Edges this close to the border of the patch are the patch's own."""
_NEIGHBOURHOOD_M: Final = 100.0
LINE_POINTS: Final = 20
DRIVABLE_CELLS: Final = 1000
DRIVABLE_HALF_M: Final = 50.0
_CELLS_PER_M: Final = 10.0
_LINE: Final = 1
"""Shapely's number of the type of lines."""


class RoadSurfaces:
    """Surfaces of a scene's map that its samples share, put together once and when they are asked for."""

    def __init__(self, road_map: RoadMap) -> None:
        self.road_map = road_map
        self._near: tuple[Floats, shapely.Geometry, shapely.MultiPolygon] | None = None

    @cached_property
    def road_edges(self) -> shapely.MultiLineString:
        """Outlines (clockwise) and holes (counter-clockwise) of road segments and lanes as one surface, global."""
        lanes = [lane.polygon for lane in self.road_map.lanes.values() if lane.polygon is not None]
        surface = as_multipolygon(shapely.union_all([*self.road_map.road_segments.values(), *lanes]))
        turned = [orient(polygon, -1.0) for polygon in surface.geoms]
        return shapely.MultiLineString([ring for part in turned for ring in (part.exterior, *part.interiors)])

    def near(self, place: Floats) -> tuple[shapely.Geometry, shapely.MultiPolygon]:
        """Road edges and drivable area within 100 m of a (2,) global place in metres, and more.

        The next samples share the neighbourhood: no city is searched for each.
        """
        if self._near is None or float(np.abs(self._near[0] - place).max()) > _NEIGHBOURHOOD_M:
            (x, y), half = place, 2.0 * _NEIGHBOURHOOD_M
            window = (x - half, y - half, x + half, y + half)
            drivable = as_multipolygon(shapely.intersection(self.road_map.drivable_area, shapely.box(*window)))
            self._near = place, shapely.clip_by_rect(self.road_edges, *window), drivable
        return self._near[1:]

    @cached_property
    def drivable(self) -> shapely.MultiPolygon:
        """The drivable area, prepared for many questions."""
        shapely.prepare(self.road_map.drivable_area)
        return self.road_map.drivable_area

    @cached_property
    def edges(self) -> shapely.Geometry:
        """Borders of the drivable area, prepared for many questions."""
        edges = self.road_map.drivable_area.boundary
        shapely.prepare(edges)
        return edges


@dataclass(frozen=True, slots=True)
class RoadsAround:
    """`benchmark.truth.Roads` of one sample.

    Attributes:
        axle_pose: (3,) global x, y, yaw of the rear axle.
    """

    surfaces: RoadSurfaces
    axle_pose: Floats

    @property
    def has_kerbs(self) -> bool:
        """Whether the map has road segments or lanes with a surface."""
        road_map = self.surfaces.road_map
        return bool(road_map.road_segments) or any(lane.polygon is not None for lane in road_map.lanes.values())

    def kerb_lines(self) -> NDArray[np.float32]:
        """Edges of the union of road segments and lanes in a patch of 102.4 m x 50 m around the rear axle.

        Returns:
            (N, 20, 2) points at equal distances along each edge, ego frame, metres.
        """
        # The border of the patch itself is trimmed away, so what is left are the edges within.
        half_x, half_y = 0.5 * PATCH_M[0] - _TRIM_M, 0.5 * PATCH_M[1] - _TRIM_M
        edges = self._in_ego(self.surfaces.near(self.axle_pose[:2])[0])
        pieces = shapely.get_parts(shapely.line_merge(shapely.clip_by_rect(edges, -half_x, -half_y, half_x, half_y)))
        lines = pieces[(shapely.get_type_id(pieces) == _LINE) & (shapely.length(pieces) > 0.0)]
        points = shapely.line_interpolate_point(lines[:, None], np.linspace(0.0, 1.0, LINE_POINTS), normalized=True)
        return np.asarray(shapely.get_coordinates(points).reshape(-1, LINE_POINTS, 2), np.float32)

    def drivable_cells(self) -> NDArray[np.uint8]:
        """The drivable area, each polygon's outline filled and then its holes emptied, vertices on the nearest node.

        Returns:
            (1000, 1000) ones where drivable: row is y, column is x, cells of 0.1 m from -50 m.
        """
        half = DRIVABLE_HALF_M
        nearby = shapely.clip_by_rect(self._in_ego(self.surfaces.near(self.axle_pose[:2])[1]), -half, -half, half, half)
        grid = np.zeros((DRIVABLE_CELLS, DRIVABLE_CELLS), np.uint8)
        for polygon in as_multipolygon(nearby).geoms:
            cv2.fillPoly(grid, [_nodes(polygon.exterior)], (1,))
            cv2.fillPoly(grid, [_nodes(hole) for hole in polygon.interiors], (0,))
        return grid

    def surely_drivable(self, points: Floats, margin_m: float) -> Bools:
        """Whether everything around points is drivable, without drawing it.

        Args:
            points: (K, 2) ego frame, metres.
            margin_m: How far around each.

        Returns:
            (K,) verdicts; False within the margin of a border, and for what is not on the grid.
        """
        there = shapely.points(to_global(points, self.axle_pose))
        clear = shapely.contains(self.surfaces.drivable, there) & ~shapely.dwithin(self.surfaces.edges, there, margin_m)
        return np.asarray(clear & (np.abs(points).max(axis=-1) + margin_m < DRIVABLE_HALF_M), np.bool_)

    def _in_ego(self, shape: shapely.Geometry) -> shapely.Geometry:
        x, y, yaw = self.axle_pose
        cos, sin = np.cos(yaw), np.sin(yaw)

        def moved(points: Floats) -> Floats:
            offset = points - [x, y]
            along, across = offset @ [cos, sin], offset @ [-sin, cos]
            return np.stack([along, across], axis=-1)

        return shapely.transform(shape, moved)


def _nodes(ring: shapely.LinearRing) -> NDArray[np.int32]:
    return np.asarray(np.round((shapely.get_coordinates(ring) + DRIVABLE_HALF_M) * _CELLS_PER_M), np.int32)
