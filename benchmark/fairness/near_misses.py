"""How near many pairs of short tracks come to a contact: `benchmark.fairness.severity_series` for all plans of a scene.

The definitions are those of one encounter; `severity_series.measure_severity` is what the tests hold this to.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.severity_series import CRITICAL_S, LARGEST_BTN, LONGEST_PET_STEPS
from benchmark.geometry import Bools, Floats, box_corners, box_gap, boxes_overlap
from benchmark.interactions.contacts import compute_time_to_contact
from benchmark.interactions.ego_path import AFTER_M, BEFORE_M, TANGENT_REACH_M, VERTEX_SPACING_M
from benchmark.interactions.reaction import HARDEST_BRAKING
from benchmark.interactions.relations import HORIZON_M, LOOK_AHEAD_M, LOOK_BACK_M, OUTLINE_REACH_M
from benchmark.interactions.tracks import STEP_S, Integers

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
        spaced = _find_spaced_centres(ego[..., :2])
        count, rows = ego.shape[1], np.arange(len(ego))[:, None]
        boxes = ego[rows, np.maximum.accumulate(np.where(spaced, np.arange(count), 0), axis=1)]
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
        following = np.where(np.roll(spaced, -1, axis=1), np.arange(1, count + 1), count)
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
        """(Q,) stations of nearest points of paths, the lowest on a tie, and signed distances, positive on the left.

        Of points (Q, 2) to the paths (Q,), in metres, between the stations ``low`` and ``high``.
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


def compute_braking_threats(ego: Floats, speed: Floats, other: Floats, present: Bools, velocity: Floats) -> Floats:
    """(P, K) braking threat numbers from 0 to 10, as `benchmark.fairness.severity_series` has them for one pair.

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
    # An obstacle's centre is no farther from the path than its half diagonal beyond the ego's side.
    reach = 0.5 * (size[1] + np.hypot(boxes[:, 2], boxes[:, 3])) + 1e-6
    in_the_way = (station >= now) & (np.abs(across) <= reach)
    path, at, now, station, boxes = (
        path[in_the_way],
        at[in_the_way],
        now[in_the_way],
        station[in_the_way],
        boxes[in_the_way],
    )
    rear, side = _project_outlines(paths, path, station, boxes, size[1])
    tangent, moving = paths.tangent(path, station), velocity[path, at]
    along = moving[:, 0] * tangent[:, 0] + moving[:, 1] * tangent[:, 1]
    gap = rear - (now + 0.5 * size[0])
    closing = np.maximum(speed[path, at] - np.maximum(along, 0.0), 0.0)
    required = closing**2 / (2 * np.maximum(gap, 1e-9)) / HARDEST_BRAKING
    threat = np.where(gap <= 0, LARGEST_BTN, np.minimum(required, LARGEST_BTN))
    threats[path, at] = np.where(side <= 0, threat, 0.0)
    return threats


def _project_outlines(
    paths: PlanPaths, path: Integers, station: Floats, boxes: Floats, width: float
) -> tuple[Floats, Floats]:
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


def _find_spaced_centres(centres: Floats) -> Bools:
    """(P, K) the first centre of each track, and each that is half a metre or more from the last one kept."""
    spaced = np.zeros(centres.shape[:2], np.bool_)
    if not spaced.size:
        return spaced
    spaced[:, 0], last = True, centres[:, 0].copy()
    for instant in range(1, centres.shape[1]):
        step = centres[:, instant] - last
        spaced[:, instant] = np.hypot(step[:, 0], step[:, 1]) >= VERTEX_SPACING_M
        last[spaced[:, instant]] = centres[spaced[:, instant], instant]
    return spaced


_MEMORY_STEPS: Final = 2


@dataclass(frozen=True, slots=True)
class NearMissMeasures:
    """P pairs that do not touch while both are there; every array (P,).

    Attributes:
        gap: Smallest distance, metres.
        ttc: Least time to contact, seconds; infinite if they never head for one another.
        tet: Time exposed: how long the time to contact is below 1.5 s, seconds.
        tit: By how much it is below, summed over time, s^2.
        pet: Post-encroachment time, seconds; infinite if the paths do not meet.
        btn: Largest braking threat number.
    """

    gap: Floats
    ttc: Floats
    tet: Floats
    tit: Floats
    pet: Floats
    btn: Floats


def measure_near_misses(ego: Floats, other: Floats, present: Bools, velocity: Floats) -> NearMissMeasures:
    """Measure pairs, (P, K, 5) boxes every 0.1 s; velocities are the other's, m/s, which is there at least once."""
    moving = compute_ego_velocities(ego)
    gap = np.where(present, box_gap(ego, other), np.inf)
    ttc = np.where(present, compute_time_to_contact(ego, moving, other, velocity), np.inf)
    left = np.where(ttc < CRITICAL_S, CRITICAL_S - ttc, 0.0)
    btn = compute_braking_threats(ego, np.hypot(moving[..., 0], moving[..., 1]), other, present, velocity)
    return NearMissMeasures(
        gap=gap.min(axis=1),
        ttc=ttc.min(axis=1),
        tet=STEP_S * (ttc < CRITICAL_S).sum(axis=1),
        tit=STEP_S * left.sum(axis=1),
        pet=STEP_S * _count_encroachment_steps(ego, other, present),
        btn=btn.max(axis=1),
    )


def compute_ego_velocities(ego: Floats) -> Floats:
    """(P, K, 2) velocities in m/s over the last 0.2 s, forward at the first instant, of boxes every 0.1 s."""
    centres = ego[..., :2]
    velocities = np.empty(centres.shape)
    velocities[:, _MEMORY_STEPS:] = (centres[:, _MEMORY_STEPS:] - centres[:, :-_MEMORY_STEPS]) / (
        _MEMORY_STEPS * STEP_S
    )
    velocities[:, :_MEMORY_STEPS] = ((centres[:, 1] - centres[:, 0]) / STEP_S)[:, None]
    return velocities


def _count_encroachment_steps(ego: Floats, other: Floats, present: Bools) -> Floats:
    """(P,) smallest number of steps between two instants of the two whose rectangles would touch; infinite for none."""
    offset = other[:, None, :, :2] - ego[:, :, None, :2]
    circles = np.hypot(ego[..., 2], ego[..., 3])[:, :, None] + np.hypot(other[..., 2], other[..., 3])[:, None]
    reach = 0.5 * circles + 1e-6
    pair, mine, theirs = np.nonzero(present[:, None] & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2))
    touching = boxes_overlap(ego[pair, mine], other[pair, theirs])
    steps = np.abs(mine - theirs)
    touching &= steps <= LONGEST_PET_STEPS
    fewest_steps = np.full(len(ego), np.inf)
    np.minimum.at(fewest_steps, pair[touching], steps[touching].astype(np.float64))
    return fewest_steps
