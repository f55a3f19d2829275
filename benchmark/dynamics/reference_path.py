"""From 16 waypoints at 2 Hz to what the tracker follows: poses, speeds and curvatures at every frame.

Arrays have the candidates last, so that the recurrences over frames work on contiguous rows.
"""

import functools
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from benchmark.geometry import Bools, Floats

WAYPOINTS = 16
JERK_PENALTY = 1e-4
CURVATURE_RATE_PENALTY = 1e-2
INITIAL_CURVATURE_PENALTY = 1e-10
HELD_BELOW_M_S = 0.3
"""Slower than this, the direction of a displacement says nothing about the heading of a car."""


@dataclass(frozen=True, slots=True)
class ReferencePath:
    """Path that the tracker follows in the local frame; F frames, B candidates.

    ``position`` is (F + 1, 2, B), ``heading`` (F + 1, B) radians, ``direction`` (F + 1, 2, B) its cosine and sine,
    ``speed`` (F, B) along the path, ``curvature`` (F, B) radians per metre.
    """

    position: Floats
    heading: Floats
    direction: Floats
    speed: Floats
    curvature: Floats


def wrap_angle_exactly(angle_rad: Floats) -> Floats:
    """Wrap angles to [-pi, pi), leaving those inside untouched to the last bit."""
    outside = angle_rad < -np.pi
    outside |= angle_rad >= np.pi
    if not outside.any():
        return angle_rad
    result = angle_rad.copy()
    result[outside] = (angle_rad[outside] + np.pi) % (2 * np.pi) - np.pi
    return result


def build_reference_path(waypoints: Floats, *, dt: float, frames_per_waypoint: int, smooth: bool) -> ReferencePath:
    """Interpolate waypoints and fit speed and curvature to them by regularised least squares.

    Waypoints are (B, 16, 2) metres in the rear-axle frame of the vehicle now; the origin is prepended. ``smooth`` is a
    natural cubic spline with headings held at walking pace and no reversing; otherwise straight segments and the
    direction of every displacement, as in the reference code. ``dt`` is the time of one frame.
    """
    count = len(waypoints)
    frames = WAYPOINTS * frames_per_waypoint
    knots = waypoints.transpose(1, 2, 0).reshape(WAYPOINTS, 2 * count)
    position = (_interpolation(frames_per_waypoint, smooth) @ knots).reshape(frames + 1, 2, count)
    chord = position[2:] - position[:-2]
    if smooth:
        _hold_chords(chord, dt)
    heading = _repeat_ends(np.arctan2(chord[:, 1], chord[:, 0]))
    direction = _repeat_ends(_directions(chord))
    return fit_path(position, heading, direction, dt=dt, smooth=smooth)


def fit_path(position: Floats, heading: Floats, direction: Floats, *, dt: float, smooth: bool) -> ReferencePath:
    """Fit speed and curvature to poses by regularised least squares.

    Positions are (F + 1, 2, B) metres, headings (F + 1, B) radians, wrapped or not; ``smooth`` is as in
    `build_reference_path`: no reversing and a penalty on jerk.
    """
    step = np.diff(position, axis=0)
    step *= direction[:-1]
    along = step[:, 0] + step[:, 1]
    if smooth:
        np.maximum(along, 0.0, out=along)
    speed = _speed_fit(len(step), dt, smooth) @ along
    curvature = fit_curvature(speed * dt, wrap_angle_exactly(np.diff(heading, axis=0)), CURVATURE_RATE_PENALTY / dt**2)
    return ReferencePath(position, heading, direction, speed, curvature)


def _repeat_ends(inner: Floats) -> Floats:
    """First and last frame, where there is no chord, repeat their neighbours."""
    return np.concatenate([inner[:1], inner, inner[-1:]])


@functools.cache
def _interpolation(frames_per_waypoint: int, smooth: bool) -> Floats:
    """(F + 1, 16) matrix from waypoints, after an origin, to one point a frame."""
    knots = np.eye(WAYPOINTS + 1)
    time = np.arange(WAYPOINTS * frames_per_waypoint + 1) / frames_per_waypoint
    segment = np.minimum(time.astype(np.int64), WAYPOINTS - 1)
    fraction = (time - segment)[:, None]
    matrix = (1.0 - fraction) * knots[segment] + fraction * knots[segment + 1]
    if smooth:
        with threadpool_limits(1, user_api="blas"):
            bend = _natural_spline_bends()
        matrix += ((1.0 - fraction) ** 3 - (1.0 - fraction)) / 6.0 * bend[segment]
        matrix += (fraction**3 - fraction) / 6.0 * bend[segment + 1]
    return np.ascontiguousarray(matrix[:, 1:])


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
    row, and there a change per frame, regardless of its duration; ``true_jerk`` is the intended matrix.
    """
    acceleration = np.diff(np.eye(frames), axis=0) / dt
    penalised = np.diff(acceleration, axis=0) / dt
    if not true_jerk:
        penalised[:-1] = acceleration[: len(penalised) - 1]
        penalised[-1] = acceleration[-1] - acceleration[-2]
    # Kept while the process lives: it must not depend on how many threads numpy has when it is first asked for.
    with threadpool_limits(1, user_api="blas"):
        normal = dt**2 * np.eye(frames) + JERK_PENALTY * penalised.T @ penalised
        return np.asarray(np.linalg.inv(normal) * dt)


def _hold_chords(chord: Floats, dt: float) -> None:
    """Replace chords (F - 1, 2, B) by the last usable one: where the car hardly moves or the path turns back.

    Before the first usable one, the vehicle's own heading stands.
    """
    squared = chord * chord
    still = squared[:, 0] + squared[:, 1] < (2.0 * HELD_BELOW_M_S * dt) ** 2
    turn = chord[1:] * chord[:-1]
    broken = np.concatenate([chord[:1, 0] < 0.0, turn[:, 0] + turn[:, 1] < 0.0])
    broken |= still
    columns = np.flatnonzero(broken.any(axis=0))
    if not len(columns):
        return
    # Where it only stands now and then, what is held is known at once; from the first turn back on step by step.
    some, still = chord[..., columns], still[:, columns]
    last = np.maximum.accumulate(np.where(still, 0, np.arange(1, len(some) + 1)[:, None]))
    ahead = np.zeros((1, 2, len(columns)))
    ahead[:, 0] = 1.0
    filled = np.take_along_axis(np.concatenate([ahead, some]), last[:, None], axis=0)
    turn = some * np.concatenate([ahead, filled[:-1]])
    back = ~still & (turn[:, 0] + turn[:, 1] < 0.0)
    chord[..., columns] = filled
    rows = np.flatnonzero(back.any(axis=0))
    if len(rows):
        first = int(np.argmax(back.any(axis=1)))
        rest = some[first:, :, rows]
        _hold_step_by_step(rest, still[first:, rows], filled[first - 1, :, rows].T if first else ahead[0][:, rows])
        chord[first:, :, columns[rows]] = rest


def _hold_step_by_step(chord: Floats, unusable: Bools, held: Floats) -> None:
    """Hold chords (F, 2, B) wherever they are (F, B) unusable or turn back; ``held`` (2, B) is before them."""
    for now, bad in zip(chord, unusable):
        turn = now * held
        bad |= turn[0] + turn[1] < 0.0
        np.copyto(now, held, where=bad)
        held = now


def _directions(chord: Floats) -> Floats:
    """Unit vectors (F - 1, 2, B) along chords; +x, the direction that `arctan2` gives, where there is none."""
    squared = chord * chord
    length = np.sqrt(squared[:, 0] + squared[:, 1])
    # Outside this range the squares lose digits.
    extreme = ~((length > 1e-140) & (length < 1e140))
    if not extreme.any():
        return np.asarray(chord / length[:, None])
    length[extreme] = 1.0
    direction = chord / length[:, None]
    angle = np.arctan2(chord[:, 1][extreme], chord[:, 0][extreme])
    direction[:, 0][extreme], direction[:, 1][extreme] = np.cos(angle), np.sin(angle)
    return np.asarray(direction)


def fit_curvature(travel: Floats, turns: Floats, rate_penalty: float) -> Floats:
    """Curvature by least squares, radians per metre: turns are travel times curvature, with a penalty on its change.

    Travel is metres and turns are radians in each frame; the penalty weighs the squared change from frame to frame.
    """
    pull = travel * travel
    pull[0] += INITIAL_CURVATURE_PENALTY
    return _solve_tridiagonal(pull, travel * turns, np.full((len(travel) - 1, 1), rate_penalty))


def _solve_tridiagonal(pull: Floats, push: Floats, link: Floats) -> Floats:
    """Solve a chain of springs: positive definite tridiagonal equations, by removing every other node again and again.

    Node i is pulled to zero by a spring of strength ``pull[i]``, pushed by ``push[i]`` and linked to node i + 1 by a
    spring of strength ``link[i]``. A removed node leaves springs in its place, whose strengths are products and sums of
    positive numbers: nothing cancels, however weakly a standing car is pulled.

    ``pull`` is (N, B), not negative, with at least one positive in each column, ``push`` (N, B), ``link`` (N - 1, B or
    1), positive. The result is (N, B), where the nodes come to rest.
    """
    if len(pull) == 1:
        return np.asarray(push / pull)
    before, after = link[::2], link[1::2]
    between = len(after)
    total = pull[1::2] + before
    total[:between] += after
    to_left, to_right = before / total, after / total[:between]
    kept_pull, kept_push, rest = pull[::2].copy(), push[::2].copy(), push[1::2] / total
    removed = len(total)
    kept_pull[:removed] += to_left * pull[1::2]
    kept_push[:removed] += to_left * push[1::2]
    kept_pull[1 : between + 1] += to_right * pull[1::2][:between]
    kept_push[1 : between + 1] += to_right * push[1::2][:between]
    kept = _solve_tridiagonal(kept_pull, kept_push, (to_left[:between] * after)[: len(kept_pull) - 1])
    result = np.empty_like(pull)
    result[::2] = kept
    rest += to_left * kept[:removed]
    rest[:between] += to_right * kept[1 : between + 1]
    result[1::2] = rest
    return result
