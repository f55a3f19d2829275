"""Motions that are braked on their own path, one alone or many together, and where they are between frames."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.interactions.tracks import Integers


def brake_on_path(poses: Floats, first: int, seconds: Floats, braking_m_s2: float) -> Floats:
    """(K, 3) poses of a motion that is braked on its own path from some frame on; 0 m/s^2 keeps its speed.

    ``seconds`` are (K,) of the frames; those beyond the F are reached on the last heading.
    """
    count = len(seconds)
    path = poses[: min(len(poses), count)]
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    station = np.concatenate([[0.0], np.cumsum(steps)])
    before = max(first - 1, 0)
    after = min(before + 1, len(path) - 1)
    span = float(seconds[after] - seconds[before]) if after > before else 1.0
    speed = float(station[after] - station[before]) / span
    time = seconds[first:] - seconds[first]
    if braking_m_s2 > 0.0:
        time = np.minimum(time, speed / braking_m_s2)
    goal = station[min(first, len(path) - 1)] + speed * time - 0.5 * braking_m_s2 * time**2
    yaw = np.unwrap(path[:, 2])
    beyond = np.maximum(goal - station[-1], 0.0)
    ahead = np.array([np.cos(path[-1, 2]), np.sin(path[-1, 2])])
    # While it stood, two stations coincide and the path between them has no length; none is needed.
    place = np.column_stack([np.interp(goal, station, path[:, axis]) for axis in range(2)]) + beyond[:, None] * ahead
    turned = wrap_angle(np.interp(goal, station, yaw))
    return np.concatenate([path[:first], np.column_stack([place, turned])])


def brake_on_paths(
    motions: Floats, row: Integers, kinds: Sequence[tuple[int, float]], seconds: Floats, frames: int
) -> Floats:
    """(3, P, frames) `brake_on_path` of (N, F, 3) motions, the same to the last bit: x, y, yaw of the first frames.

    ``row`` (P,), not falling, is the motion of each, ``kinds`` from which frame on it brakes, and how hard.
    """
    path = motions[:, : len(seconds)]
    steps = np.hypot(np.diff(path[..., 0], axis=1), np.diff(path[..., 1], axis=1))
    station = np.concatenate([np.zeros((len(path), 1)), np.cumsum(steps, axis=1)], axis=1)
    first, braking = np.array([kind[0] for kind in kinds]), np.array([kind[1] for kind in kinds])[:, None]
    before = np.maximum(first - 1, 0)
    after = np.minimum(before + 1, path.shape[1] - 1)
    span = np.where(after > before, seconds[after] - seconds[before], 1.0)
    speed = ((station[row, after] - station[row, before]) / span)[:, None]
    stop = np.divide(speed, braking, out=np.full_like(speed, np.inf), where=braking > 0.0)
    time = np.minimum(seconds[:frames] - seconds[first][:, None], stop)
    goal = station[row, np.minimum(first, path.shape[1] - 1)][:, None] + speed * time - 0.5 * braking * time**2
    columns = np.empty((3, *goal.shape))
    yaw = np.unwrap(path[..., 2], axis=1)
    cuts = np.searchsorted(row, np.arange(len(path) + 1))
    for at, (start, end) in enumerate(itertools.pairwise(cuts)):
        for axis, known in enumerate((path[at, :, 0], path[at, :, 1], yaw[at])):
            columns[axis, start:end] = np.interp(goal[start:end], station[at], known)
    beyond = np.maximum(goal - station[row, -1:], 0.0)
    for axis, ahead in enumerate((np.cos(path[:, -1, 2]), np.sin(path[:, -1, 2]))):
        columns[axis] += beyond * ahead[row][:, None]
    columns[2] = wrap_angle(columns[2])
    kept = min(path.shape[1], frames)
    as_planned = np.arange(kept) < first[:, None]
    for axis in range(3):
        np.copyto(columns[axis, :, :kept], path[row, :kept, axis], where=as_planned)
    return columns


@dataclass(frozen=True, slots=True)
class InstantsBetween:
    """Places of (I,) instants among (K,) frames: linear, as by `numpy.interp`, the same to the last bit."""

    frame: Integers
    after: Integers
    width: Floats
    past: Floats
    on_frame: Bools

    @classmethod
    def of(cls, known: Floats, wanted: Floats) -> Self:
        """Instants among frames, both in seconds."""
        frame = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 1)
        after = np.minimum(frame + 1, len(known) - 1)
        width = np.where(after > frame, known[after] - known[frame], 1.0)
        return cls(frame, after, width, wanted - known[frame], (known[frame] == wanted) | (after == frame))

    def at(self, rows: Floats) -> Floats:
        """(..., I) values of (..., K) rows."""
        here, later = np.take(rows, self.frame, axis=-1), np.take(rows, self.after, axis=-1)
        return np.asarray(np.where(self.on_frame, here, (later - here) / self.width * self.past + here))
