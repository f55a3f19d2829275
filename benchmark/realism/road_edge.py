"""How far bodies reach over the edge of the road."""

from functools import cached_property
from typing import Final

import numpy as np
import shapely

from benchmark.geometry import Floats, box_corners

NEAREST_M: Final = -20.0
"""Further inside than this counts as this."""
FURTHEST_M: Final = 5.0


class RoadEdge:
    """The edge of a drivable area.

    Args:
        drivable: The area.
    """

    def __init__(self, drivable: shapely.MultiPolygon) -> None:
        self._drivable = drivable
        shapely.prepare(drivable)

    def beyond(self, boxes: Floats) -> Floats:
        """How far the corner that is furthest out is over the edge.

        Args:
            boxes: (S, 5) rectangles.

        Returns:
            (S,) metres, positive outside, between -20 and 5.
        """
        corners = box_corners(boxes).reshape(-1, 2)
        inside = shapely.contains_xy(self._drivable, corners[:, 0], corners[:, 1])
        signed = np.where(inside, -1.0, 1.0) * self._distance(corners)
        return np.asarray(np.clip(signed.reshape(-1, 4).max(axis=1), NEAREST_M, FURTHEST_M))

    @cached_property
    def _segments(self) -> shapely.STRtree:
        ends = []
        for ring in shapely.get_rings(shapely.get_parts(self._drivable)):
            points = shapely.get_coordinates(ring)
            ends.append(np.stack([points[:-1], points[1:]], axis=1))
        return shapely.STRtree(shapely.linestrings(np.concatenate(ends)))

    def _distance(self, points: Floats) -> Floats:
        """(P,) distance to the nearest edge."""
        found, distance = self._segments.query_nearest(shapely.points(points), return_distance=True, all_matches=False)
        away = np.empty(len(points))
        away[found[0]] = distance
        return away
