"""Motion features of recorded and generated tracks through the same 2 Hz keyframes (``docs/realism.md``).

Recorded tracks are annotated at 2 Hz and linear between keyframes, so that differences at any higher rate are zero
inside and spikes at the keyframes; a generated track is smooth. Both are therefore read at the keyframes, smoothed and
splined alike. `RoadEdge` measures how far bodies reach over the edge of the road.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, box_corners, box_gap
from benchmark.interactions.contacts import compute_time_to_contact
from benchmark.interactions.tracks import ContinuousTracks

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

    def measure_overhang(self, boxes: Floats) -> Floats:
        """(S,) metres that the outermost corner of each box is over the edge: positive outside, between -20 and 5."""
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


FEATURES: Final = (
    "speed",
    "acceleration_along",
    "acceleration_across",
    "jerk_along",
    "yaw_rate",
    "yaw_acceleration",
    "gap",
    "ttc",
)
ROAD_EDGE: Final = "road_edge"
"""The ninth feature, of scenes with a map."""
FEWEST_KEYFRAMES: Final = 5
SHORTEST_M: Final = 5.0
"""Runs that move less say nothing about driving."""
SAMPLE_S: Final = 0.1
LARGEST_GAP_M: Final = 40.0
LONGEST_TTC_S: Final = 8.0
TTC_WITHIN_M: Final = 60.0
_WINDOW, _ORDER = 5, 2
_VELOCITY_REACH_S: Final = 0.25

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class FeatureRun:
    """One stretch of keyframes of an agent that counts, sampled at (S,) seconds.

    ``values`` are (S,) of each of `FEATURES`, and of `ROAD_EDGE` with a map, by name.
    """

    agent: int
    times: Floats
    values: dict[str, Floats]


@dataclass(frozen=True, slots=True)
class SplinedMotion:
    """Smoothed motion of one agent: (S, 5) boxes, (S, 2) m/s, and ``values`` of features that need no other agent."""

    boxes: Floats
    velocity: Floats
    values: dict[str, Floats]


def extract_runs(
    tracks: ContinuousTracks,
    keyframes: Integers,
    agent: int,
    *,
    between: tuple[float, float] | None = None,
    road: RoadEdge | None = None,
) -> list[FeatureRun]:
    """All runs of one agent that count, in order of time; the ego is one of those that it keeps its distance to.

    ``keyframes`` (K,) are indices of the annotated frames, rising; those outside the times ``between`` do not count.
    ``road`` is for `ROAD_EDGE`.
    """
    return list(_iterate_runs(NearbyRoadUsers.of(tracks), keyframes, agent, between, road))


def extract_recorded_runs(
    tracks: ContinuousTracks,
    keyframes: Integers,
    category: str,
    *,
    without: Collection[int] = (),
    road: RoadEdge | None = None,
) -> list[FeatureRun]:
    """All runs of all agents of a category, by agent and time: what a scene gives to the reference.

    The ego is left out: another instrument measured it. ``keyframes`` and ``road`` as of `extract_runs`; agents in
    ``without`` are not as recorded.
    """
    around = NearbyRoadUsers.of(tracks)
    return [
        run
        for agent, name in enumerate(tracks.categories)
        if name == category and agent not in without
        for run in _iterate_runs(around, keyframes, agent, None, road)
    ]


def find_stretches(valid: Bools, centres: Floats) -> list[slice]:
    """Runs of keyframes that count: at least 5 of them, along which the agent moves 5 m or more."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], valid, [False]]).astype(np.int8)))
    slices = []
    for start, stop in edges.reshape(-1, 2).tolist():
        length = np.hypot(*np.diff(centres[start:stop], axis=0).T).sum()
        if stop - start >= FEWEST_KEYFRAMES and length >= SHORTEST_M:
            slices.append(slice(start, stop))
    return slices


def fit_splines(times: Floats, boxes: Floats, samples: Floats) -> SplinedMotion:
    """Smooth the keyframes of a run, (K,) seconds and (K, 5) boxes, and differentiate at (S,) seconds."""
    # scipy.signal takes two seconds to import.
    from scipy.interpolate import CubicSpline
    from scipy.signal import savgol_filter

    poses = np.column_stack([boxes[:, :2], np.unwrap(boxes[:, 4])])
    smooth = savgol_filter(poses, _WINDOW, _ORDER, axis=0, mode="interp")
    curve = CubicSpline(times, smooth, bc_type="natural")
    place, first, second = curve(samples), curve(samples, 1), curve(samples, 2)
    speed = _along(first, place)
    later, earlier = (_along(curve(samples + step, 2), curve(samples + step)) for step in (SAMPLE_S, -SAMPLE_S))
    values = {
        "speed": speed,
        "acceleration_along": _along(second, place),
        "acceleration_across": speed * first[:, 2],
        "jerk_along": (later - earlier) / (2 * SAMPLE_S),
        "yaw_rate": first[:, 2],
        "yaw_acceleration": second[:, 2],
    }
    size = np.broadcast_to(boxes[0, 2:4], (len(samples), 2))
    return SplinedMotion(np.column_stack([place[:, :2], size, place[:, 2]]), first[:, :2], values)


@dataclass(frozen=True, slots=True)
class NearbyRoadUsers:
    """Road users that an agent may come near: all objects, and the recorded ego as the last one."""

    tracks: ContinuousTracks

    @classmethod
    def of(cls, tracks: ContinuousTracks) -> "NearbyRoadUsers":
        """Those of a scene."""
        everybody = replace(
            tracks,
            agents=np.concatenate([tracks.agents, tracks.ego[None]]),
            valid=np.concatenate([tracks.valid, np.ones((1, len(tracks.seconds)), np.bool_)]),
            categories=(*tracks.categories, "ego"),
        )
        return cls(everybody)

    def measure_nearness(self, agent: int, samples: Floats, motion: SplinedMotion) -> dict[str, Floats]:
        """(S,) ``gap`` and ``ttc`` of an agent's smoothed motion to all others, with their caps."""
        others, present = self.tracks.agents_at(samples)
        present[agent] = False
        away = np.hypot(others[..., 0] - motion.boxes[:, 0], others[..., 1] - motion.boxes[:, 1])
        outer = 0.5 * (np.hypot(others[..., 2], others[..., 3]) + np.hypot(motion.boxes[:, 2], motion.boxes[:, 3]))
        inner = 0.5 * (others[..., 2:4].min(axis=-1) + motion.boxes[:, 2:4].min(axis=-1))
        at_least, at_most = away - outer, np.where(present, away - inner, np.inf)
        gap = np.full(len(samples), LARGEST_GAP_M)
        bound = np.minimum(at_most.min(axis=0, initial=np.inf), LARGEST_GAP_M) + 1e-6
        row, column = np.nonzero(present & (at_least <= bound))
        np.minimum.at(gap, column, box_gap(motion.boxes[column], others[row, column]))
        near = present & (at_least <= TTC_WITHIN_M)
        return {"gap": gap, "ttc": self._ttc(samples, motion, others, near)}

    def _ttc(self, samples: Floats, motion: SplinedMotion, others: Floats, near: Bools) -> Floats:
        rows = np.flatnonzero(near.any(axis=1))
        velocity = self._velocities(rows, samples)
        heading_for = _circles_meet(motion, others[rows], velocity)
        row, column = np.nonzero(near[rows] & heading_for)
        mine, theirs = motion.boxes[column], others[rows[row], column]
        contact_times = compute_time_to_contact(mine, motion.velocity[column], theirs, velocity[row, column])
        soon = contact_times <= LONGEST_TTC_S
        # Only agents with a short time to contact need the distance test.
        soon[soon] = box_gap(mine[soon], theirs[soon]) <= TTC_WITHIN_M
        ttc = np.full(len(samples), LONGEST_TTC_S)
        np.minimum.at(ttc, column[soon], contact_times[soon])
        return ttc

    def _velocities(self, rows: Integers, samples: Floats) -> Floats:
        """(R, S, 2) over a quarter of a second to both sides, inside each run of valid frames."""
        some = self.tracks.only(rows)
        start, end = some.run_limits_at(samples)
        first, last = np.maximum(samples - _VELOCITY_REACH_S, start), np.minimum(samples + _VELOCITY_REACH_S, end)
        span = last - first
        moved = some.centres_at(last) - some.centres_at(first)
        return np.asarray(np.where(span[..., None] > 0, moved / np.where(span > 0, span, 1.0)[..., None], 0.0))


def _iterate_runs(
    around: NearbyRoadUsers,
    keyframes: Integers,
    agent: int,
    between: tuple[float, float] | None,
    road: RoadEdge | None,
) -> Iterator[FeatureRun]:
    tracks = around.tracks
    times, boxes, valid = tracks.seconds[keyframes], tracks.agents[agent, keyframes], tracks.valid[agent, keyframes]
    if between is not None:
        valid = valid & (times >= between[0]) & (times <= between[1])
    for run in find_stretches(valid, boxes[:, :2]):
        of_run = times[run]
        count = int(np.floor((of_run[-2] - of_run[1]) / SAMPLE_S + 1e-6)) + 1
        samples = of_run[1] + SAMPLE_S * np.arange(count)
        motion = fit_splines(of_run, boxes[run], samples)
        values = {**motion.values, **around.measure_nearness(agent, samples, motion)}
        if road is not None:
            values[ROAD_EDGE] = road.measure_overhang(motion.boxes)
        yield FeatureRun(agent, samples, values)


def _along(vectors: Floats, places: Floats) -> Floats:
    """Components along the heading, which is the third column of the places."""
    return np.asarray(vectors[:, 0] * np.cos(places[:, 2]) + vectors[:, 1] * np.sin(places[:, 2]))


def _circles_meet(motion: SplinedMotion, others: Floats, velocity: Floats) -> Bools:
    """(R, S) whether the circles around two boxes touch now or ever will: what any contact needs."""
    offset = others[..., :2] - motion.boxes[:, :2]
    rate = velocity - motion.velocity
    reach = 0.5 * (np.hypot(others[..., 2], others[..., 3]) + np.hypot(motion.boxes[:, 2], motion.boxes[:, 3])) + 1e-6
    squared, closing = (offset**2).sum(axis=-1), -(offset * rate).sum(axis=-1)
    speed = (rate**2).sum(axis=-1)
    passing = squared * speed - closing**2 <= reach**2 * speed * (1 + 1e-9)
    return np.asarray((squared <= reach**2) | ((closing > 0) & passing))
