"""Which way lanes lead, for candidates that must not drive against traffic."""

import functools
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.spatial import cKDTree

from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.road_map import RoadMap
from benchmark.scene import Scene

SPACING_M: Final = 1.0
WITHIN_M: Final = 2.0
"""A centre line as near as this is the vehicle's lane, or one of several where they cross."""
NEIGHBOURS: Final = 8
AGAINST_RAD: Final = np.pi / 2


@dataclass(frozen=True)
class LaneHeadings:
    """Points along the centre lines of a map, (V, 2) global metres, and (V,) headings of the lane there, radians."""

    points: Floats
    headings: Floats

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Those of a scene's map."""
        return cls(*_points(_Map(scene.road_map)))

    def against(self, poses: Floats) -> Bools:
        """Whether poses (..., 3) head against every lane whose centre line is within 2 m; not where there is none."""
        if not len(self.points):
            return np.zeros(poses.shape[:-1], np.bool_)
        count = min(NEIGHBOURS, len(self.points))
        away, nearest = self._tree.query(poses[..., :2], k=[*range(1, count + 1)], distance_upper_bound=WITHIN_M)
        found = np.isfinite(away)
        headings = self.headings[np.where(found, nearest, 0)]
        along = np.abs(wrap_angle(poses[..., 2:] - headings)) <= AGAINST_RAD
        return np.asarray(found.any(axis=-1) & ~(found & along).any(axis=-1))

    @functools.cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)


class _Map:
    """A map by identity: its layers do not change, and shapes are slow to hash."""

    def __init__(self, road_map: RoadMap) -> None:
        self.road_map = road_map

    def __hash__(self) -> int:
        return id(self.road_map)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Map) and self.road_map is other.road_map


@functools.lru_cache(maxsize=2)
def _points(of: _Map) -> tuple[Floats, Floats]:
    points, headings = [np.zeros((0, 2))], [np.zeros(0)]
    for lane in of.road_map.lanes.values():
        edge = np.diff(lane.centerline, axis=0)
        length = np.hypot(edge[:, 0], edge[:, 1])
        stations = np.concatenate([[0.0], np.cumsum(length)])
        at = np.arange(0.5 * SPACING_M, stations[-1], SPACING_M)
        segment = np.clip(np.searchsorted(stations, at, side="right") - 1, 0, len(edge) - 1)
        points.append(np.column_stack([np.interp(at, stations, lane.centerline[:, axis]) for axis in range(2)]))
        headings.append(np.arctan2(edge[segment, 1], edge[segment, 0]))
    return np.concatenate(points), np.concatenate(headings)
