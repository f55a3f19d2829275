"""Recorded poses at uneven times as tracks at an even rate."""

from typing import Final

import numpy as np

from benchmark.geometry import Floats

RATE_HZ: Final = 10.0
"""Samples per second of what comes out; windows are cut on this grid."""


def even_tracks(seconds: Floats, poses: Floats, longest_gap_s: float) -> tuple[Floats, ...]:
    """Interpolate between recorded poses, never across more than ``longest_gap_s``.

    One (F, 3) array at 10 Hz for each unbroken stretch, heading unwrapped, starting at its first pose. Left out are
    (T, 3) poses x, y, heading with NaN or infinity, and those not later than the one before them.
    """
    sound = np.isfinite(seconds) & np.isfinite(poses).all(axis=1)
    seconds, poses = seconds[sound], poses[sound]
    latest = np.maximum.accumulate(np.concatenate([[-np.inf], seconds[:-1]])) if len(seconds) else seconds
    seconds, poses = seconds[seconds > latest], poses[seconds > latest]
    tracks = []
    for stretch in np.split(np.arange(len(seconds)), np.flatnonzero(np.diff(seconds) > longest_gap_s) + 1):
        if len(stretch) < 2:
            continue
        times = seconds[stretch] - seconds[stretch[0]]
        grid = np.arange(int(times[-1] * RATE_HZ + 1e-6) + 1) / RATE_HZ
        columns = (poses[stretch, 0], poses[stretch, 1], np.unwrap(poses[stretch, 2]))
        tracks.append(np.column_stack([np.interp(grid, times, column) for column in columns]))
    return tuple(tracks)
