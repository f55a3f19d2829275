"""Which frames of a log become samples, and which images belong to which frame."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import KEYFRAME_HZ

Numbers = NDArray[np.int64]
STEP_US: Final = 1_000_000 // KEYFRAME_HZ
FARTHEST_IMAGE_US: Final = 100_000
"""An image farther from its key frame than this is none of it."""


def choose_key_frames(times_us: Numbers) -> Numbers:
    """(K,) frames at 2 Hz among (F,) rising times: all of a log of 2 Hz, else those nearest to steps of half a second.

    A frame counts only if it is no farther from the step than half the median interval; of two, the earlier; each once.
    """
    interval_us = float(np.median(np.diff(times_us)))
    if abs(interval_us - STEP_US) <= 0.1 * STEP_US:
        return np.arange(len(times_us))
    steps = np.arange(times_us[0], times_us[-1] + STEP_US, STEP_US)
    after = np.clip(np.searchsorted(times_us, steps), 1, len(times_us) - 1)
    nearest = np.where(steps - times_us[after - 1] <= times_us[after] - steps, after - 1, after)
    near = np.abs(times_us[nearest] - steps) <= 0.5 * interval_us
    return np.asarray(np.unique(nearest[near]), np.int64)


@dataclass(frozen=True, slots=True)
class CameraFrames:
    """Which image a camera has of which frame: (M,) rising frames, and rows of its file, each once."""

    frames: Numbers
    rows: Numbers


def pair_images(
    times_us: Numbers, key_frames: Numbers, cameras: Mapping[str, tuple[Numbers, Numbers]]
) -> tuple[Numbers, dict[str, CameraFrames], dict[str, int]]:
    """Key frames that have an image of every camera, the images of each, and how many key frames each camera cost.

    The image of a frame is the one whose row the frame names. Where a key frame names none, or one that is farther than
    0.1 s away, it takes the nearest other within 0.1 s, from whichever frame; without one it is no key frame.

    Args:
        times_us: (F,) times of the frames.
        key_frames: (K,) of them that are to be samples.
        cameras: (R,) times of the rows and (F,) rows of the frames, -1 for none, by camera.
    """
    missing = dict.fromkeys(cameras, 0)
    chosen: dict[str, dict[int, int]] = {name: {} for name in cameras}
    for frame in key_frames.tolist():
        found = {name: _find_image(int(times_us[frame]), int(rows[frame]), at) for name, (at, rows) in cameras.items()}
        lacking = [name for name, row in found.items() if row < 0]
        for name in lacking:
            missing[name] += 1
        for name, row in found.items() if not lacking else ():
            chosen[name][frame] = row
    kept = key_frames if not cameras else np.array(sorted(next(iter(chosen.values()))), np.int64)
    paired = {name: _add_others(chosen[name], at, rows) for name, (at, rows) in cameras.items()}
    return kept, paired, missing


def _add_others(chosen: Mapping[int, int], at: Numbers, rows: Numbers) -> CameraFrames:
    """The images of frames between key frames, of which each is later than the one before it and no key frame's."""
    pairs: list[tuple[int, int]] = []
    ends = sorted(chosen)
    for frame, row in enumerate(rows.tolist()):
        place = bisect_right(ends, frame)
        following = int(at[chosen[ends[place]]]) if place < len(ends) else None
        if frame in chosen:
            pairs.append((frame, chosen[frame]))
        elif row >= 0 and (following is None or at[row] < following) and (not pairs or at[row] > at[pairs[-1][1]]):
            pairs.append((frame, row))
    return CameraFrames(*np.array(pairs, np.int64).reshape(-1, 2).T)


def _find_image(time_us: int, row: int, at: Numbers) -> int:
    """The row that a key frame takes, -1 for none."""
    if row >= 0 and abs(int(at[row]) - time_us) <= FARTHEST_IMAGE_US:
        return row
    nearest = int(np.argmin(np.abs(at - time_us))) if len(at) else -1
    return nearest if nearest >= 0 and abs(int(at[nearest]) - time_us) <= FARTHEST_IMAGE_US else -1
