"""Steps of half a second from each sample on, also where key frames are not half a second apart.

Where all key frames on the way are 0.4 to 0.6 s apart, step k is the k-th following key frame, as in nuScenes.
Elsewhere it is the time t + 0.5 k, between the key frames before and after it. Nothing is known across a gap over
0.75 s.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from statistics import median
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import KEYFRAME_HZ
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, wrap_angle
from benchmark.scene import Scene

STEP_US: Final = 1_000_000 // KEYFRAME_HZ
SHORTEST_US: Final = 395_000
LONGEST_US: Final = 605_000
"""Intervals of nuScenes run from 0.4 to 0.6 s, to the hundredth."""
LONGEST_KNOWN_US: Final = 750_000
"""Across a longer gap nobody knows where anything was."""
ON_KEY_FRAME_US: Final = 1_000
"""A time so near to a key frame is the key frame: time stamps are rounded."""
_RATE_TOLERANCE_US: Final = STEP_US // 10
"""Of a scene's median interval."""


def is_step(interval_us: int) -> bool:
    """Whether an interval between key frames counts as a step of half a second."""
    return SHORTEST_US <= interval_us <= LONGEST_US


def other_interval_us(timestamps_us: "list[int] | NDArray[np.int64]") -> float | None:
    """Median interval of key frames that do not come at 2 Hz, microseconds, from K increasing times.

    ``None`` where it is that of nuScenes, or there is no interval.
    """
    intervals_us = [int(then) - int(now) for now, then in pairwise(timestamps_us)]
    usual_us = float(median(intervals_us)) if intervals_us else float(STEP_US)
    return usual_us if abs(usual_us - STEP_US) > _RATE_TOLERANCE_US else None


@dataclass(frozen=True, slots=True)
class TimedSteps:
    """N times among the key frames of a scene.

    Attributes:
        times_us: (N,).
        before: (N,) key frame at or before each; the first or last one outside the recording.
        after: (N,) key frame at or after each.
        fraction: (N,) 0 at the former, towards 1 at the latter.
        recorded: (N,) whether the recording covers the time.
        known: (N,) whether it does, and no gap that is too long lies between the sample and the time or around it.
    """

    times_us: NDArray[np.int64]
    before: NDArray[np.int64]
    after: NDArray[np.int64]
    fraction: Floats
    recorded: Bools
    known: Bools

    @property
    def nearest(self) -> NDArray[np.int64]:
        """(N,) the nearer one of the two key frames, the earlier one of two equally near."""
        return np.where(self.fraction <= 0.5, self.before, self.after)


class KeyFrameSteps:
    """The key frames of a scene as a clock.

    Args:
        timestamps_us: (K,), increasing.
    """

    def __init__(self, timestamps_us: NDArray[np.int64]) -> None:
        self.times_us = np.asarray(timestamps_us, np.int64)

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The clock of a scene."""
        return cls(scene.timestamps_us[scene.keyframes])

    @cached_property
    def _irregular(self) -> NDArray[np.int64]:
        """(K,) intervals that are no step, before each key frame."""
        intervals = np.diff(self.times_us)
        return np.concatenate([[0], np.cumsum((intervals < SHORTEST_US) | (intervals > LONGEST_US))])

    @cached_property
    def _too_long(self) -> NDArray[np.int64]:
        """(K,) gaps that are too long, before each key frame."""
        return np.concatenate([[0], np.cumsum(np.diff(self.times_us) > LONGEST_KNOWN_US)])

    def are_key_frames(self, index: int, steps: int) -> bool:
        """Whether steps are key frames: all of them up to there, as far as they exist, half a second apart.

        Args:
            steps: How many steps ahead; back where it is negative.
        """
        last = len(self.times_us) - 1
        first, end = sorted((index, min(max(index + steps, 0), last)))
        return bool(self._irregular[first] == self._irregular[end])

    def at(self, index: int, steps: NDArray[np.int64]) -> TimedSteps:
        """Steps of a sample among the key frames, by the clock.

        Args:
            steps: (N,) numbers of steps of half a second, negative ones before the sample.
        """
        times, last = self.times_us, len(self.times_us) - 1
        wanted = times[index] + STEP_US * np.asarray(steps, np.int64)
        before = np.clip(np.searchsorted(times, wanted + ON_KEY_FRAME_US, side="right") - 1, 0, last)
        after = np.clip(np.searchsorted(times, wanted - ON_KEY_FRAME_US, side="left"), 0, last)
        # Of two key frames within the rounding of a time stamp the earlier one is meant.
        before = np.minimum(before, after)
        span = np.where(after > before, times[after] - times[before], 1)
        fraction = np.where(after > before, (wanted - times[before]) / span, 0.0)
        recorded = (wanted >= times[0] - ON_KEY_FRAME_US) & (wanted <= times[-1] + ON_KEY_FRAME_US)
        unbroken = self._too_long[np.maximum(after, index)] == self._too_long[np.minimum(before, index)]
        return TimedSteps(wanted, before, after, fraction, recorded, recorded & unbroken)


def values_at(values: Floats, times_us: NDArray[np.int64], wanted_us: NDArray[np.int64], heading: int = 2) -> Floats:
    """Values recorded at frames, interpolated to other times: linear, headings by the shortest turn.

    Args:
        values: (T, C) values at the frames.
        times_us: (T,) times of the frames, increasing.
        wanted_us: (...) the times; outside the recording those of its first or last frame.
        heading: The column that holds a heading.

    Returns:
        (..., C) values; headings from -pi to pi.
    """
    columns = np.asarray(values, np.float64).copy()
    columns[:, heading] = np.unwrap(columns[:, heading])
    seconds, wanted = (times_us - times_us[0]) * 1e-6, (np.asarray(wanted_us) - times_us[0]) * 1e-6
    found = np.stack([np.interp(wanted, seconds, column) for column in columns.T], axis=-1)
    found[..., heading] = wrap_angle(found[..., heading])
    return found


def require_two_hz(scene: Scene, what: str) -> None:
    """Refuse a scene for what counts frames and key frames instead of looking at the clock.

    Args:
        what: What needs key frames at 2 Hz, in words.
    """
    interval_us = other_interval_us(scene.timestamps_us[scene.keyframes])
    if interval_us is not None:
        raise InputError(
            f"the key frames of {scene.name} are {interval_us * 1e-6:.3g} s apart (median), and {what} needs one every "
            f"{STEP_US * 1e-6:g} s; only eval and rescore take other rates, leave the scene out here"
        )
