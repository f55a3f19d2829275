"""Future of the recorded ego for planning: its path, its position on it, and how far it would overrun."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.spatial import cKDTree

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Floats, wrap_angle
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from generation.labels.interactions import PathFrame

SPACING_M: Final = 0.5
"""Of the points that stand for the path; offsets are exact on straight pieces all the same."""
BACK_M: Final = 60.0
ON_M: Final = 90.0
"""Part of the path around the ego that positions are looked up on: paths cross themselves."""
STEADY_S: Final = PLAN_STEPS * PLAN_STEP_S
"""How long an ego that does not react keeps its speed: the length of a plan."""
AROUND_S: Final = 1.0
SPEED_FRAMES: Final = FRAMES_PER_KEYFRAME // 2


@dataclass(frozen=True, slots=True)
class RecordedEgoPath:
    """The recorded ego along its own path: (V,) vertices and (T,) frames, metres, radians and m/s, global.

    ``station`` is of the ego's centre. ``overrun`` is how far an ego that had kept one of its speeds of the last 3 s
    would be ahead of it, at most, within a second (`compute_overrun`).
    """

    points: Floats
    headings: Floats
    stations: Floats
    station: Floats
    speed: Floats
    overrun: Floats
    length_m: float
    width_m: float

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The way of a scene's ego."""
        ego = scene.ego.boxes
        path = PathFrame.of(ego)
        stations = np.arange(path.stations[0], path.stations[-1], SPACING_M)
        points = np.column_stack([np.interp(stations, path.stations, path.vertices[:, axis]) for axis in range(2)])
        edge = np.diff(path.vertices, axis=0)
        segment = np.clip(np.searchsorted(path.stations, stations, side="right") - 1, 0, len(edge) - 1)
        headings = np.arctan2(edge[segment, 1], edge[segment, 0])
        speed = compute_smooth_speed(path.ego_stations, scene.seconds)
        # An adversary that must be in position at that time has to arrive a little earlier.
        over = maximum_filter1d(
            compute_overrun(path.ego_stations, speed), 2 * round(AROUND_S * FRAME_HZ) + 1, mode="nearest"
        )
        return cls(points, headings, stations, path.ego_stations, speed, over, float(ego[0, 2]), float(ego[0, 3]))

    def places(self, poses: Floats, first: int, last: int) -> tuple[Floats, Floats, Floats]:
        """Stations, offsets (left is positive) and headings relative to the path's, (...) each, of global poses.

        (..., 3) ``poses`` belong to the frames from ``first`` to ``last``.
        """
        low, high = np.searchsorted(self.stations, [self.station[first] - BACK_M, self.station[last] + ON_M])
        tree, columns = _get_window(self, int(low), int(high))
        _, nearest = tree.query(poses[..., :2])
        x, y, at, heading, cos, sin = np.take(columns, nearest, axis=1)
        ahead, aside = poses[..., 0] - x, poses[..., 1] - y
        station = at + cos * ahead + sin * aside
        offset = cos * aside - sin * ahead
        return station, offset, wrap_angle(poses[..., 2] - heading)


def _select_window(way: RecordedEgoPath, low: int, high: int) -> tuple[cKDTree, Floats]:
    """Points of a part of a path to look up, and (6, V) x, y, station, heading, its cosine and its sine of them."""
    points, heading = way.points[low:high], way.headings[low:high]
    columns = np.stack([*points.T, way.stations[low:high], heading, np.cos(heading), np.sin(heading)])
    return cKDTree(points), columns


_get_window: Final = IdentityCache[RecordedEgoPath, tuple[cKDTree, Floats]](_select_window, kept=4)
get_ego_path: Final = IdentityCache[Scene, RecordedEgoPath](RecordedEgoPath.of, kept=2)
"""`RecordedEgoPath.of`, which several terms of a search ask for."""


def compute_smooth_speed(station: Floats, seconds: Floats) -> Floats:
    """(T,) m/s over a quarter of a second to both sides of (T,) stations: one noisy frame would overrun by metres."""
    frames = np.arange(len(station))
    first, last = (np.clip(frames + reach, 0, frames[-1]) for reach in (-SPEED_FRAMES, SPEED_FRAMES))
    return np.asarray((station[last] - station[first]) / np.maximum(seconds[last] - seconds[first], 1e-9))


def compute_overrun(station: Floats, speed: Floats) -> Floats:
    """Distance, (T,) metres, ahead of the recorded ego at which one would be that had kept its speed.

    ``o(t) = max over t' in {t, t - 0.5 s, ..., t - 3 s} of s(t') + u(t') (t - t') - s(t)``, which is not negative.
    """
    over = np.zeros(len(station))
    step = round(PLAN_STEP_S * FRAME_HZ)
    for back in range(step, round(STEADY_S * FRAME_HZ) + 1, step):
        if back < len(station):
            predicted = station[:-back] + speed[:-back] * back / FRAME_HZ
            over[back:] = np.maximum(over[back:], predicted - station[back:])
    return over
