"""Speeds, accelerations and turns of 2 Hz trajectories: which could be driven, and how many more a request needs."""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import KEYFRAME_HZ
from benchmark.geometry import Floats
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

STEP_S: Final = 1.0 / KEYFRAME_HZ
STILL_BELOW_M: Final = 0.15
"""Shorter steps (0.3 m/s) have no direction that could be trusted."""
MAX_ACCELERATION: Final = 8.0
"""m/s^2, in any direction: dry tarmac."""
MAX_CURVATURE: Final = 0.22
"""1/m: a rear axle turns around a point at least 4.5 m away."""
FREE_TURN_RAD: Final = 0.06
"""Turn that is always tolerated, because the headings of short steps are noisy."""


@dataclass(frozen=True, slots=True)
class TrajectoryMotion:
    """Finite differences of trajectories that start now: (..., 17) mean speeds of half seconds, (..., 16) else.

    ``speed``, m/s, begins with the half second before now; ``acceleration`` is along the motion and ``lateral`` across,
    m/s^2; ``turn`` is radians from one half second to the next and ``curvature`` 1/m, 0 while standing still.
    """

    speed: Floats
    acceleration: Floats
    turn: Floats
    lateral: Floats
    curvature: Floats

    @property
    def yaw_rate(self) -> Floats:
        """(..., 16) rad/s."""
        return self.turn / STEP_S

    @property
    def excess(self) -> Floats:
        """(...) how far the worst step is beyond what a car can do, radians or m/s^2; 0 if it is drivable throughout.

        A reversal is a turn of half a circle, so it is never drivable.
        """
        reach = 0.5 * STEP_S * (self.speed[..., :-1] + self.speed[..., 1:])
        turned_too_far = np.abs(self.turn) - MAX_CURVATURE * reach - FREE_TURN_RAD
        pulled_too_hard = np.hypot(self.acceleration, self.lateral) - MAX_ACCELERATION
        return np.asarray(np.maximum(np.maximum(turned_too_far, pulled_too_hard), 0.0).max(axis=-1))


def compute_motion(waypoints: Floats, previous: Floats) -> TrajectoryMotion:
    """Motion along (..., 16, 3) trajectories at 2 Hz in the local frame, with (..., 3) the pose half a second ago.

    The vehicle is at the origin and looks along x. A direction is held where it stands still; before it first moves,
    and at the start of a trajectory from rest, it is the heading, zero.
    """
    waypoints = np.asarray(waypoints, np.float64)
    previous = np.broadcast_to(np.asarray(previous, np.float64), (*waypoints.shape[:-2], waypoints.shape[-1]))
    path = np.concatenate([previous[..., None, :2], np.zeros_like(previous)[..., None, :2], waypoints[..., :2]], -2)
    step = np.diff(path, axis=-2)
    length = np.hypot(step[..., 0], step[..., 1])
    moving = length >= STILL_BELOW_M
    pointing = np.arctan2(step[..., 1], step[..., 0])
    direction = np.zeros_like(length)
    if moving.all():
        direction = pointing
    else:
        held = np.zeros(length.shape[:-1])
        for index in range(length.shape[-1]):
            held = np.where(moving[..., index], pointing[..., index], held)
            direction[..., index] = held
    turn = (np.diff(direction, axis=-1) + np.pi) % (2 * np.pi) - np.pi
    speed = length / STEP_S
    between = 0.5 * (speed[..., 1:] + speed[..., :-1])
    acceleration = np.diff(speed, axis=-1) / STEP_S
    curvature = turn / np.maximum(between * STEP_S, STILL_BELOW_M)
    return TrajectoryMotion(speed, acceleration, turn, between * turn / STEP_S, curvature)


DRAWN_FIRST: Final = 1.25
"""How many are drawn at first, of those that are asked for: one larger batch costs less than two."""
REDRAWN_FACTOR: Final = 1.2
REDRAWN_BESIDE: Final = 8
"""More than the share so far asks for are drawn again, so that one more batch is usually enough."""


@dataclass(frozen=True, slots=True)
class TrajectoryDraws:
    """Trajectories, (N, 16, 3), drawn for one request so far, in order, with their (N,) `TrajectoryMotion.excess`."""

    waypoints: Floats
    excess: Floats

    @classmethod
    def empty(cls) -> Self:
        """Nothing yet."""
        return cls(np.zeros((0, WAYPOINTS, CHANNELS)), np.zeros(0))

    def extend(self, waypoints: Floats, previous: Floats) -> Self:
        """With (M, 16, 3) further waypoints of a vehicle that was at (3,) ``previous`` half a second ago."""
        excess = compute_motion(waypoints, previous).excess
        return type(self)(np.concatenate([self.waypoints, waypoints]), np.concatenate([self.excess, excess]))

    def missing(self, count: int) -> int:
        """Number of further draws so that ``count`` are drivable, by the share so far; 0 if there are enough."""
        drivable = int((self.excess == 0).sum())
        if drivable >= count:
            return 0
        expected = REDRAWN_FACTOR * (count - drivable) * len(self.excess) / max(drivable, 1)
        return min(count, math.ceil(expected) + REDRAWN_BESIDE)

    def select_best(self, count: int) -> Floats:
        """(count, 16, 3): the first drivable ones; the least bad ones fill up where there are not enough."""
        return np.asarray(self.waypoints[select_most_drivable(self.excess, count)[:count]])


def select_most_drivable(excess: Floats, at_least: int) -> NDArray[np.int64]:
    """Indices of trajectories that can be driven, in order; the least bad others fill up to ``at_least``."""
    order = np.argsort(excess, kind="stable")
    return np.asarray(order[: max(int((excess == 0).sum()), at_least)], dtype=np.int64)
