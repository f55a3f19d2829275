"""What the public reference code drops a scene for: a bad score, or a place far from the ego. Contact is no reason."""

from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.search.verify import Discard, Finding

WORST_SCORE: Final = 7.0
"""A scene in which the best candidate of any planning frame scores higher is dropped."""
FARTHEST_M: Final = 50.0
"""From the ego's rear axle, along either axis of the map."""


def fault_of_step(best_score: float, frame: int) -> Finding | None:
    """Why the reference code drops a scene after a planning frame: its best candidate is too bad."""
    if best_score <= WORST_SCORE:
        return None
    return Finding(Discard.SCORES_TOO_HIGH, frame, quantity="best score", value=best_score, limit=WORST_SCORE)


def fault_of_place(scene: Scene, centers: Floats, first: int) -> Finding | None:
    """Why the reference code drops a scene for where its adversary was: 50 m from the ego along an axis of the map.

    (F, 2) ``centers`` of the adversary begin at frame ``first``; the scene's last frame is not looked at.
    """
    last = len(scene.timestamps_us) - 1
    offset = np.abs(centers[: last - first] - scene.ego.pose[first : first + len(centers)][: last - first, :2])
    out = np.flatnonzero((offset > FARTHEST_M).any(axis=1))
    return Finding(Discard.LEAVES_AREA, first + int(out[0])) if len(out) else None
