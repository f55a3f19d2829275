"""The paths of many short tracks side by side, and who is in the way on them: `EgoPath` for the plans of a scene.

A vertex that the path leaves out stands where the one before it stands: segments of no length change nothing, and all
paths have as many.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.encounter import LARGEST_BTN
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.interactions.ego_path import AFTER_M, BEFORE_M, TANGENT_REACH_M, VERTEX_SPACING_M
from benchmark.interactions.relations import HORIZON_M, LOOK_AHEAD_M, LOOK_BACK_M, OUTLINE_REACH_M
from benchmark.interactions.rules import HARDEST_BRAKING
from benchmark.interactions.tracks import Integers

_OUTLINE: Final = 8
"""Corners and middles of the sides."""


@dataclass(frozen=True, slots=True)
class PlanPaths:
    """P polylines of as many vertices.

    Attributes:
        points: (P, V, 2) vertices.
        station: (P, V) metres along each, 0 at the second vertex.
        length: (P, V - 1) of the segments, metres.
        direction: (P, V - 1, 2) along the segments, zero for those of no length.
        now: (P, K) station of the ego at each instant of its track.
    """

    points: Floats
    station: Floats
    length: Floats
    direction: Floats
    now: Floats

    @classmethod
    def of(cls, ego: Floats) -> "PlanPaths":
        """The paths of tracks, (P, K, 5) boxes."""
        kept = _spaced(ego[..., :2])
        count, rows = ego.shape[1], np.arange(len(ego))[:, None]
        boxes = ego[rows, np.maximum.accumulate(np.where(kept, np.arange(count), 0), axis=1)]
        ends = boxes[:, [0, -1]]
        heading = np.stack([np.cos(ends[..., 4]), np.sin(ends[..., 4])], axis=-1)
        before = ends[:, :1, :2] - BEFORE_M * heading[:, :1]
        after = ends[:, 1:, :2] + AFTER_M * heading[:, 1:]
        points = np.concatenate([before, boxes[..., :2], after], axis=1)
        step = np.diff(points, axis=1)
        length = np.hypot(step[..., 0], step[..., 1])
        direction = step / np.where(length > 0, length, 1.0)[..., None]
        station = np.concatenate([np.zeros((len(ego), 1)), np.cumsum(length, axis=1)], axis=1) - length[:, :1]
        # The segment that leads to the next vertex kept has the number of that vertex's instant.
        following = np.where(np.roll(kept, -1, axis=1), np.arange(1, count + 1), count)
        following = np.minimum.accumulate(following[:, ::-1], axis=1)[:, ::-1]
        offset = ego[..., :2] - points[rows, following]
        along = (offset * direction[rows, following]).sum(axis=-1)
        now = station[rows, following] + np.clip(along, 0.0, length[rows, following])
        return cls(points, station, length, direction, now)

    def position(self, path: Integers, station: Floats) -> Floats:
        """(Q, 2) the point of each of (Q,) paths at (Q,) stations."""
        stations = self.station[path]
        station = np.clip(station, stations[:, 0], stations[:, -1])
        segment = np.minimum((stations <= station[:, None]).sum(axis=1) - 1, stations.shape[1] - 2)
        ahead = station - stations[np.arange(len(path)), segment]
        return np.asarray(self.points[path, segment] + ahead[:, None] * self.direction[path, segment])

    def tangent(self, path: Integers, station: Floats) -> Floats:
        """(Q, 2) unit direction over half a metre to both sides."""
        chord = self.position(path, station + TANGENT_REACH_M) - self.position(path, station - TANGENT_REACH_M)
        return np.asarray(chord / np.maximum(np.hypot(chord[:, 0], chord[:, 1]), 1e-12)[:, None])

    def project(self, path: Integers, points: Floats, low: Floats, high: Floats) -> tuple[Floats, Floats]:
        """Nearest points of paths.

        Args:
            path: (Q,) which path.
            points: (Q, 2) metres.
            low: (Q,) first station that counts.
            high: (Q,) last station that counts.

        Returns:
            (Q,) stations, the lowest where several are as near, and (Q,) signed distances, positive on the left.
        """
        base, length = self.station[path, :-1], self.length[path]
        low, high = (np.clip(end, base[:, 0], self.station[path, -1])[:, None] for end in (low, high))
        offset, direction = points[:, None] - self.points[path, :-1], self.direction[path]
        along = offset[..., 0] * direction[..., 0] + offset[..., 1] * direction[..., 1]
        along = np.clip(along, np.maximum(low - base, 0.0), np.minimum(high - base, length))
        x, y = (offset[..., axis] - along * direction[..., axis] for axis in (0, 1))
        inside = (base + length >= low) & (base <= high)
        distance = np.where(inside, x * x + y * y, np.inf)
        nearest, rows = distance.argmin(axis=1), np.arange(len(path))
        station = (base + along)[rows, nearest]
        tangent, away = self.tangent(path, station), points - self.position(path, station)
        left = tangent[:, 0] * away[:, 1] - tangent[:, 1] * away[:, 0]
        return station, np.copysign(np.sqrt(distance[rows, nearest]), left)


def braking_threats(ego: Floats, speed: Floats, other: Floats, present: Bools, velocity: Floats) -> Floats:
    """(P, K) braking threat numbers from 0 to 10, as `benchmark.fairness.encounter` has them for one pair.

    0 where the other is behind, not in the way or not there. Boxes are (P, K, 5), speeds of the ego (P, K),
    velocities of the other (P, K, 2), m/s.
    """
    paths, threats = PlanPaths.of(ego), np.zeros(present.shape)
    # The eye is on the path, where the ego's centre is projected to.
    path, at = np.nonzero(present)
    now = paths.now[path, at]
    offset = other[path, at, :2] - paths.position(path, now)
    near = np.hypot(offset[:, 0], offset[:, 1]) <= HORIZON_M
    path, at, now = path[near], at[near], now[near]
    boxes, size = other[path, at], ego[0, 0, 2:4] if len(ego) else np.zeros(2)
    station, across = paths.project(path, boxes[:, :2], now - LOOK_BACK_M, now + LOOK_AHEAD_M)
    # Whoever is in the way has its centre no further from the path than its half diagonal beyond the ego's side.
    reach = 0.5 * (size[1] + np.hypot(boxes[:, 2], boxes[:, 3])) + 1e-6
    asked = (station >= now) & (np.abs(across) <= reach)
    path, at, now, station, boxes = path[asked], at[asked], now[asked], station[asked], boxes[asked]
    rear, side = _outlines(paths, path, station, boxes, size[1])
    tangent, moving = paths.tangent(path, station), velocity[path, at]
    along = moving[:, 0] * tangent[:, 0] + moving[:, 1] * tangent[:, 1]
    gap = rear - (now + 0.5 * size[0])
    closing = np.maximum(speed[path, at] - np.maximum(along, 0.0), 0.0)
    required = closing**2 / (2 * np.maximum(gap, 1e-9)) / HARDEST_BRAKING
    threat = np.where(gap <= 0, LARGEST_BTN, np.minimum(required, LARGEST_BTN))
    threats[path, at] = np.where(side <= 0, threat, 0.0)
    return threats


def _outlines(paths: PlanPaths, path: Integers, station: Floats, boxes: Floats, width: float) -> tuple[Floats, Floats]:
    """(Q,) lowest station of the outline of each box, and (Q,) free distance between it and the ego's strip."""
    corners = box_corners(boxes)
    outline = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1).reshape(-1, 2)
    around = np.repeat(station, _OUTLINE)
    stations, offsets = paths.project(
        np.repeat(path, _OUTLINE), outline, around - OUTLINE_REACH_M, around + OUTLINE_REACH_M
    )
    stations, offsets = stations.reshape(-1, _OUTLINE), offsets.reshape(-1, _OUTLINE)
    side = np.maximum(offsets.min(axis=1), -offsets.max(axis=1)) - 0.5 * width
    return stations.min(axis=1), side


def _spaced(centres: Floats) -> Bools:
    """(P, K) the first centre of each track, and each that is half a metre or more from the last one kept."""
    kept = np.zeros(centres.shape[:2], np.bool_)
    if not kept.size:
        return kept
    kept[:, 0], last = True, centres[:, 0].copy()
    for instant in range(1, centres.shape[1]):
        step = centres[:, instant] - last
        kept[:, instant] = np.hypot(step[:, 0], step[:, 1]) >= VERTEX_SPACING_M
        last[kept[:, instant]] = centres[kept[:, instant], instant]
    return kept
