"""What was drawn for one request, and how much more is wanted until enough of it can be driven."""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from generation.diffusion.kinematics import motion
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

DRAWN_FIRST: Final = 1.25
"""How many are drawn at first, of those that are asked for: one larger batch costs less than two."""
REDRAWN_FACTOR: Final = 1.2
REDRAWN_BESIDE: Final = 8
"""More than the share so far asks for are drawn again, so that one more batch is usually enough."""


@dataclass(frozen=True, slots=True)
class Draws:
    """Trajectories drawn for one request so far: (N, 16, 3), in the order of drawing.

    ``excess`` says how far beyond drivable each is, (N,) (`Motion.excess`).
    """

    waypoints: Floats
    excess: Floats

    @classmethod
    def none(cls) -> Self:
        """Nothing yet."""
        return cls(np.zeros((0, WAYPOINTS, CHANNELS)), np.zeros(0))

    def and_more(self, waypoints: Floats, previous: Floats) -> Self:
        """With (M, 16, 3) further waypoints of a vehicle that was at (3,) ``previous`` half a second ago."""
        excess = motion(waypoints, previous).excess
        return type(self)(np.concatenate([self.waypoints, waypoints]), np.concatenate([self.excess, excess]))

    def missing(self, count: int) -> int:
        """Number of further draws so that ``count`` are drivable, by the share so far; 0 if there are enough."""
        drivable = int((self.excess == 0).sum())
        if drivable >= count:
            return 0
        expected = REDRAWN_FACTOR * (count - drivable) * len(self.excess) / max(drivable, 1)
        return min(count, math.ceil(expected) + REDRAWN_BESIDE)

    def best(self, count: int) -> Floats:
        """(count, 16, 3): the first drivable ones; the least bad ones fill up where there are not enough."""
        return np.asarray(self.waypoints[most_drivable(self.excess, count)[:count]])


def most_drivable(excess: Floats, at_least: int) -> NDArray[np.int64]:
    """Indices of trajectories that can be driven, in order; the least bad others fill up to ``at_least``."""
    order = np.argsort(excess, kind="stable")
    return np.asarray(order[: max(int((excess == 0).sum()), at_least)], dtype=np.int64)
