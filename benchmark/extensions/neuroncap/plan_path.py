"""Reference of NeuroNCAP's tracker: a plan as poses every 0.1 s, with the speeds and curvatures fitted to them.

As in published code (nuPlan's): knots at the waypoints, linear in between; profiles by regularised least squares.
"""

import functools
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.dynamics.reference_path import fit_curvature
from benchmark.geometry import Floats, wrap_angle
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

Waypoints = NDArray[np.floating[Any]]
"""(N, 2 or more), in single or double precision."""
SUBSTEP_S: Final = 0.1
SUBSTEP_US: Final = 100_000
WAYPOINT_US: Final = 500_000
NEAREST_M: Final = 1.0
"""Waypoints nearer than this are skipped; a last one nearer than this means stopping."""
_JERK_PENALTY: Final = 1e-6
_CURVATURE_RATE_PENALTY: Final = 1e-5


class UnusablePlanError(ValueError):
    """A plan that the engine cannot drive: the planner failed, and nothing is scored."""


@dataclass(frozen=True, slots=True)
class PlanPath:
    """A plan every 0.1 s, of M displacements with m/s and 1/m, (M,) each.

    The (M + 1, 3) poses, x, y, heading, are in the frame of the plan; `start_us` is the time of the first.
    """

    start_us: int
    poses: Floats
    speed: Floats
    curvature: Floats

    def at(self, profile: Floats, seconds: float | list[float]) -> Floats:
        """A profile, (M,) `speed` or `curvature`, between the starts of displacements, constant beyond them.

        Seconds are since 1970; their rounding (2.4e-7 s) is the published code's.
        """
        starts = (self.start_us + SUBSTEP_US * np.arange(len(profile))) / 1e6
        return np.asarray(np.interp(seconds, starts, profile))


def read_waypoints(plan: ArrayLike, switches: NeuroncapSwitches) -> Waypoints:
    """A plan as the engine takes it, 1 to 6 waypoints: (N, 2 or more), x forward and y left of the rear axle, metres.

    They are 0.5 s apart; the switches decide whether they are rounded to single precision.
    """
    try:
        # Values too large for single precision become infinite, and are refused as such.
        with np.errstate(over="ignore"):
            waypoints: Waypoints = np.array(plan, np.float32 if switches.float32 == "code" else np.float64)
    except (TypeError, ValueError):
        raise UnusablePlanError("the plan is not an array of numbers") from None
    if waypoints.ndim != 2 or not 1 <= len(waypoints) <= PLAN_STEPS or waypoints.shape[1] < 2:
        raise UnusablePlanError(f"a plan has 1 to {PLAN_STEPS} waypoints of x and y; this one is {waypoints.shape}")
    if not np.isfinite(waypoints).all():
        raise UnusablePlanError("the plan contains NaN or infinity")
    return waypoints


def is_stopping_plan(waypoints: Waypoints) -> bool:
    """Whether a plan ends less than 1 m away; columns beyond x and y count, as in the published code."""
    return bool(np.linalg.norm(waypoints[-1]) < NEAREST_M)


def build_path(waypoints: Waypoints, plan_us: int, start_us: int) -> PlanPath:
    """Path of a plan whose last waypoint is not near; waypoint i is at 0.5 (i + 1) s after ``plan_us``.

    It leaves the origin of the plan's frame at ``start_us``, less than 0.5 s after ``plan_us``.
    """
    far_enough = np.linalg.norm(waypoints, axis=1) >= NEAREST_M
    times = np.concatenate([[start_us], plan_us + WAYPOINT_US * (1 + np.flatnonzero(far_enough))])
    knots = np.zeros((len(times), 3))
    knots[1:, :2] = waypoints[far_enough, :2]
    knots[1:, 2] = _compute_headings(waypoints)[far_enough]
    knots[:, 2] = np.unwrap(knots[:, 2])
    offsets_us = np.arange(start_us, int(times[-1]) + 1, SUBSTEP_US) - start_us
    poses = np.column_stack([np.interp(offsets_us, times - start_us, column) for column in knots.T])
    poses[:, 2] = wrap_angle(poses[:, 2])
    step, heading = np.diff(poses, axis=0), poses[:-1, 2]
    speed = _speed_fit(len(step)) @ (step[:, 0] * np.cos(heading) + step[:, 1] * np.sin(heading))
    turns = wrap_angle(step[:, 2])
    penalty = _CURVATURE_RATE_PENALTY / SUBSTEP_S**2
    curvature = fit_curvature(SUBSTEP_S * speed[:, None], turns[:, None], penalty)[:, 0]
    return PlanPath(start_us, poses, speed, curvature)


def _compute_headings(waypoints: Waypoints) -> Floats:
    """(N,) direction from the waypoint before (or the origin) to the one after.

    In single precision they pass through cosine and sine, as rotations do in the published code.
    """
    points = np.concatenate([np.zeros_like(waypoints[:1, :2]), waypoints[:, :2], waypoints[-1:, :2]])
    chord = points[2:] - points[:-2]
    precision = chord.dtype
    chord = chord.astype(np.float64)
    heading = np.arctan2(chord[:, 1], chord[:, 0]).astype(precision).astype(np.float64)
    if precision == np.float64:
        return np.asarray(heading)
    sin, cos = np.sin(heading).astype(precision), np.cos(heading).astype(precision)
    return np.asarray(np.arctan2(sin, cos, dtype=np.float64))


@functools.cache
def _speed_fit(count: int) -> Floats:
    """(M, M) matrix from displacements to speeds: least squares with a small penalty on second differences."""
    bends = np.diff(np.eye(count), n=2, axis=0) / SUBSTEP_S
    normal = SUBSTEP_S**2 * np.eye(count) + _JERK_PENALTY * bends.T @ bends
    return np.asarray(np.linalg.inv(normal) * SUBSTEP_S)
