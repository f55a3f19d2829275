"""From 16 waypoints at 2 Hz to what the tracker follows: poses, speeds and curvatures at every frame."""

import functools
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats

WAYPOINTS = 16
JERK_PENALTY = 1e-4
CURVATURE_RATE_PENALTY = 1e-2
INITIAL_CURVATURE_PENALTY = 1e-10
HELD_BELOW_M_S = 0.3
"""Slower than this, the direction of a displacement says nothing about the heading of a car."""


@dataclass(frozen=True, slots=True)
class ReferencePath:
    """What the tracker follows; F frames.

    Attributes:
        pose: (B, F + 1, 3) x, y, heading in the local frame.
        speed: (B, F) along the path.
        curvature: (B, F) radians per metre.
    """

    pose: Floats
    speed: Floats
    curvature: Floats


def wrapped(angle_rad: Floats) -> Floats:
    """Wrap angles to [-pi, pi), leaving those inside untouched to the last bit."""
    inside = (angle_rad >= -np.pi) & (angle_rad < np.pi)
    return np.where(inside, angle_rad, (angle_rad + np.pi) % (2 * np.pi) - np.pi)


def reference_path(waypoints: Floats, *, dt: float, frames_per_waypoint: int, smooth: bool) -> ReferencePath:
    """Interpolate waypoints and fit speed and curvature to them by regularised least squares.

    Args:
        waypoints: (B, 16, 2) metres in the rear-axle frame of the vehicle now; the origin is prepended.
        dt: Time of one frame.
        frames_per_waypoint: Frames between waypoints.
        smooth: Natural cubic spline, headings held at walking pace and no reversing; otherwise straight segments and
            the direction of every displacement, as in the reference code.

    Returns:
        The path.
    """
    points = np.einsum("fw,bwc->bfc", _interpolation(frames_per_waypoint, smooth), waypoints)
    headings = _held_headings(points, dt) if smooth else _chord_headings(points)
    steps = np.diff(points, axis=1)
    along = steps[..., 0] * np.cos(headings[:, :-1]) + steps[..., 1] * np.sin(headings[:, :-1])
    if smooth:
        along = np.maximum(along, 0.0)
    speed = np.einsum("fg,bg->bf", _speed_fit(steps.shape[1], dt, smooth), along)
    turns = wrapped(np.diff(headings, axis=1))
    curvature = _fit_curvature(speed * dt, turns, CURVATURE_RATE_PENALTY / dt**2)
    return ReferencePath(np.concatenate([points, headings[..., None]], axis=-1), speed, curvature)


@functools.cache
def _interpolation(frames_per_waypoint: int, smooth: bool) -> Floats:
    """(F + 1, 16) matrix from waypoints, after an origin, to one point a frame."""
    knots = np.eye(WAYPOINTS + 1)
    time = np.arange(WAYPOINTS * frames_per_waypoint + 1) / frames_per_waypoint
    segment = np.minimum(time.astype(np.int64), WAYPOINTS - 1)
    fraction = (time - segment)[:, None]
    matrix = (1.0 - fraction) * knots[segment] + fraction * knots[segment + 1]
    if smooth:
        bend = _natural_spline_bends()
        matrix += ((1.0 - fraction) ** 3 - (1.0 - fraction)) / 6.0 * bend[segment]
        matrix += (fraction**3 - fraction) / 6.0 * bend[segment + 1]
    return np.asarray(matrix[:, 1:])


def _natural_spline_bends() -> Floats:
    """(17, 17) second derivatives of the natural cubic spline at the knots, per unit of each knot's value."""
    inner = WAYPOINTS - 1
    system = 4.0 * np.eye(inner) + np.eye(inner, k=1) + np.eye(inner, k=-1)
    differences = np.zeros((inner, WAYPOINTS + 1))
    rows = np.arange(inner)
    differences[rows, rows], differences[rows, rows + 1], differences[rows, rows + 2] = 6.0, -12.0, 6.0
    bend = np.zeros((WAYPOINTS + 1, WAYPOINTS + 1))
    bend[1:-1] = np.linalg.solve(system, differences)
    return bend


@functools.cache
def _speed_fit(frames: int, dt: float, true_jerk: bool) -> Floats:
    """(F, F) matrix from displacements to speeds: least squares with a small penalty on jerk.

    The reference's difference matrix lost its super-diagonal, so that it penalises acceleration except in the last
    row; ``true_jerk`` is what was meant.
    """
    acceleration = np.diff(np.eye(frames), axis=0) / dt
    penalised = np.diff(acceleration, axis=0) / dt
    if not true_jerk:
        penalised[:-1] = acceleration[: len(penalised) - 1]
    normal = dt**2 * np.eye(frames) + JERK_PENALTY * penalised.T @ penalised
    return np.asarray(np.linalg.inv(normal) * dt)


def _chord_headings(points: Floats) -> Floats:
    """(B, F + 1) direction from the previous to the next point; the ends repeat their neighbours."""
    chord = points[:, 2:] - points[:, :-2]
    inner = np.arctan2(chord[..., 1], chord[..., 0])
    return np.concatenate([inner[:, :1], inner, inner[:, -1:]], axis=1)


def _held_headings(points: Floats, dt: float) -> Floats:
    """Chord headings, but held where the car hardly moves and where the path turns back on itself."""
    chord = points[:, 2:] - points[:, :-2]
    direction = np.arctan2(chord[..., 1], chord[..., 0])
    moving = np.hypot(chord[..., 0], chord[..., 1]) >= 2.0 * HELD_BELOW_M_S * dt
    headings = np.zeros(points.shape[:2])
    held = np.zeros(len(points))
    for frame in range(chord.shape[1]):
        forward = np.cos(direction[:, frame] - held) > 0.0
        held = np.where(moving[:, frame] & forward, direction[:, frame], held)
        headings[:, frame + 1] = held
    headings[:, 0] = np.where(moving[:, 0], headings[:, 1], 0.0)
    headings[:, -1] = held
    return headings


def _fit_curvature(travel: Floats, turns: Floats, rate_penalty: float) -> Floats:
    """Curvature (B, F): turns are travel times curvature, with a penalty on its change.

    The normal equations are tridiagonal and positive definite: elimination over frames, vectorised over candidates.
    """
    frames = travel.shape[1]
    diagonal = travel**2 + 2.0 * rate_penalty
    diagonal[:, 0] += INITIAL_CURVATURE_PENALTY - rate_penalty
    diagonal[:, -1] -= rate_penalty
    right = travel * turns
    diagonal, right = diagonal.T.copy(), right.T.copy()
    for frame in range(1, frames):
        factor = rate_penalty / diagonal[frame - 1]
        diagonal[frame] -= factor * rate_penalty
        right[frame] += factor * right[frame - 1]
    curvature = np.empty_like(right)
    curvature[-1] = right[-1] / diagonal[-1]
    for frame in range(frames - 2, -1, -1):
        curvature[frame] = (right[frame] + rate_penalty * curvature[frame + 1]) / diagonal[frame]
    return curvature.T
