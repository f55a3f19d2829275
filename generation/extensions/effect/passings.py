"""Moments at which a vehicle and the ego pass each other, side by side."""

from typing import Final

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Bools, box_gap, to_local, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks

PASSING_M, BESIDE_M = 5.0, 1.5
"""Gap at which a vehicle passes the ego, and how far aside that is at least."""
LEAST_GAP_M: Final = 0.5
MOST_PASSINGS, APART_S = 3, 3.0


def find_passings(tracks: ContinuousTracks, agent: int, moving: Bools) -> list[tuple[int, float, float, bool]]:
    """Nearest moments of a vehicle and an ego that is ``moving`` (F,), the nearest first.

    Frame, gap in metres, side (1 for left), and whether they meet rather than overtake.
    """
    boxes, ego = tracks.agents[agent], tracks.ego
    gap = np.full(len(ego), np.inf)
    at = np.flatnonzero(tracks.valid[agent] & moving)
    gap[at] = box_gap(boxes[at], ego[at])
    aside = to_local(ego[:, :2], boxes[:, [0, 1, 4]])[:, 1]
    gap[(np.abs(aside) < BESIDE_M) | (gap > PASSING_M) | (gap <= LEAST_GAP_M)] = np.inf
    found: list[tuple[int, float, float, bool]] = []
    while np.isfinite(gap).any() and len(found) < MOST_PASSINGS:
        frame = int(np.argmin(gap))
        turned = np.abs(wrap_angle(boxes[frame, 4] - ego[frame, 4]))
        found.append((frame, float(gap[frame]), float(np.sign(aside[frame])), bool(turned > np.pi / 2)))
        gap[max(frame - round(APART_S * FRAME_HZ), 0) : frame + round(APART_S * FRAME_HZ)] = np.inf
    return found
