"""How far bodies reach over the edge of the road."""

from typing import Final

import numpy as np
import shapely

from benchmark.geometry import Floats, box_corners

NEAREST_M: Final = -20.0
"""Further inside than this counts as this."""
FURTHEST_M: Final = 5.0
_FURTHER: Final = max(-NEAREST_M, FURTHEST_M)
"""Edges further away than this decide nothing."""
_TOGETHER: Final = 128
"""Points whose nearest edges are looked for at once."""


class RoadEdge:
    """The edge of a drivable area."""

    def __init__(self, drivable: shapely.MultiPolygon) -> None:
        self._drivable = drivable
        shapely.prepare(drivable)
        rings = [shapely.get_coordinates(ring) for ring in shapely.get_rings(shapely.get_parts(drivable))]
        self._start = np.concatenate([np.empty((0, 2)), *(points[:-1] for points in rings)])
        self._end = np.concatenate([np.empty((0, 2)), *(points[1:] for points in rings)])

    def beyond(self, boxes: Floats) -> Floats:
        """(S,) metres by which the corner of each box that is furthest out is over the edge.

        Positive outside, between -20 and 5.
        """
        corners = box_corners(boxes).reshape(-1, 2)
        inside = shapely.contains_xy(self._drivable, corners[:, 0], corners[:, 1])
        signed = np.where(inside, -1.0, 1.0) * self._distance(corners)
        return np.asarray(np.clip(signed.reshape(-1, 4).max(axis=1), NEAREST_M, FURTHEST_M))

    def _distance(self, points: Floats) -> Floats:
        """(P,) distance to the nearest edge, exact where it is below 20 m and at least that elsewhere."""
        # Neighbours in time are neighbours in space: few edges are near each group.
        groups = np.array_split(points, -(-len(points) // _TOGETHER)) if len(points) else []
        return np.concatenate([np.empty(0), *map(self._distance_of_neighbours, groups)])

    def _distance_of_neighbours(self, points: Floats) -> Floats:
        low, high = points.min(axis=0) - _FURTHER, points.max(axis=0) + _FURTHER
        near = (np.maximum(self._start, self._end) >= low).all(axis=1)
        near &= (np.minimum(self._start, self._end) <= high).all(axis=1)
        (x, y), (to_x, to_y) = self._start[near].T, (self._end[near] - self._start[near]).T
        rel_x, rel_y = points[:, :1] - x, points[:, 1:] - y
        share = np.clip((rel_x * to_x + rel_y * to_y) / np.maximum(to_x**2 + to_y**2, 1e-18), 0.0, 1.0)
        squared = (rel_x - share * to_x) ** 2 + (rel_y - share * to_y) ** 2
        return np.asarray(np.sqrt(squared.min(axis=1, initial=_FURTHER**2)))
