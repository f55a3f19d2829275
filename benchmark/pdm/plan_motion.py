"""From plans to 31 states of the car, by the official tracker and bicycle, and comfort: HC of one motion, EC of two.

Tracker and bicycle are those of `benchmark.dynamics` in the units of NAVSIM: 0.1 s a step, nuPlan's wheelbase, no limit
but that of the steering angle. Differences to NAVSIM's own numbers are below 1e-9 (`challenger-bench verify pdm`). HC
is of a motion and what was before it, EC how far two consecutive plans agree.
"""

import functools
from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.dynamics.bicycle import BicycleMotion, MotionModel, follow_path
from benchmark.dynamics.reference_path import ReferencePath, fit_path
from benchmark.geometry import Bools, Floats, to_global, wrap_angle
from benchmark.pdm.definition import (
    ACCELERATION,
    COMFORT_CENTER_AHEAD_M,
    DT_S,
    HEADING,
    HISTORY_ROWS,
    SIDE_ACCELERATION,
    SPEED,
    STATE_COLUMNS,
    STATES,
    STATES_PER_WAYPOINT,
    STEERING,
    STEERING_RATE,
    WHEELBASE_M,
    YAW_ACCELERATION,
    YAW_RATE,
)
from benchmark.planning import Plan, PlanFrame
from benchmark.waypoints import chord_headings, points_in_ego

BOUNDS: Final = ((-4.05, 2.40), (-4.89, 4.89), (-8.37, 8.37), (-4.13, 4.13), (-1.93, 1.93), (-0.95, 0.95))
"""Of acceleration along, across (m/s^2), jerk of its magnitude, jerk along (m/s^3), yaw acceleration, yaw rate."""
AGREEMENT: Final = (0.7, 0.5, 0.1, 0.1)
"""Largest root mean square differences: acceleration, jerk, yaw rate, yaw acceleration."""
LONGEST_BETWEEN_S: Final = 0.55
"""Plans whose samples are farther apart have no EC."""
DECIMALS: Final = 8
HISTORY_KEY_FRAMES: Final = 4
"""-1.5, -1.0, -0.5 and 0 s."""


def build_history_rows(key_frames: Floats) -> Floats:
    """(B, 14, 11) states at -1.5 .. -0.2 s before a motion: linear, headings by the shortest turn, rates zero.

    They are made of (B, 4, 8) pose, velocity and acceleration (the first columns of a state) at -1.5, -1, -0.5 and 0 s.
    """
    values = key_frames.copy()
    values[..., HEADING] = _unwrapped(values[..., HEADING])
    time = np.arange(HISTORY_ROWS) / 5.0
    before = time.astype(np.int64)
    fraction = (time - before)[:, None]
    rows = np.zeros((len(key_frames), HISTORY_ROWS, STATE_COLUMNS))
    rows[..., :8] = values[:, before] + fraction * (values[:, before + 1] - values[:, before])
    return rows


def compute_comfort_series(states: Floats, history: Floats) -> Floats:
    """(B, 6, 45) series that comfort is judged by, in the order of ``BOUNDS``.

    Motions are (B, 31, 11), the states before them (B, 14, 11).
    """
    rows = np.concatenate([history, states], axis=1)
    felt = rows[..., ACCELERATION] + COMFORT_CENTER_AHEAD_M * (rows[..., YAW_RATE] ** 2 + rows[..., YAW_ACCELERATION])
    along = _filtered(felt, 8, 2, 0)
    heading = _unwrapped(rows[..., HEADING])
    series = (
        along,
        _filtered(rows[..., SIDE_ACCELERATION], 8, 2, 0),
        _filtered(_magnitude(rows), 15, 2, 1),
        _filtered(along, 15, 2, 1),
        _filtered(heading, 5, 3, 2),
        _filtered(heading, 5, 2, 1),
    )
    return np.stack(series, axis=1)


def check_comfort(extremes: Floats) -> Bools:
    """HC: (..., 6) whether each series, of (..., 6, 2) lowest and highest values, keeps its bounds; all make HC 1."""
    low, high = np.array(BOUNDS).T
    return np.asarray((extremes[..., 0] > low) & (extremes[..., 1] < high))


def compute_extremes(series: Floats) -> Floats:
    """(..., 2) lowest and highest value of (..., T) series."""
    return np.stack([series.min(axis=-1), series.max(axis=-1)], axis=-1)


def count_states_between(seconds: float) -> int | None:
    """By how many states two consecutive samples are apart; ``None`` where they are too far apart to be compared."""
    return round(seconds / DT_S) if 0.0 < seconds < LONGEST_BETWEEN_S and round(seconds / DT_S) > 0 else None


def compute_disagreement(earlier: Floats, later: Floats, apart: int) -> Floats:
    """(B, 4) root mean square differences of two plans where both say something, in the order of ``AGREEMENT``.

    Motions are (B, 31, 11); ``apart`` are the states between the starts of the two.
    """
    differences = _plan_series(later[:, : STATES - apart]) - _plan_series(earlier[:, apart:])
    return np.asarray(np.sqrt(np.mean(differences**2, axis=-1)))


def score_extended_comfort(differences: Floats) -> Floats:
    """EC, 0 or 1, of (..., 4) root mean squares."""
    return np.asarray((differences <= np.array(AGREEMENT)).all(axis=-1), np.float64)


def _plan_series(states: Floats) -> Floats:
    heading = _unwrapped(states[..., HEADING])
    acceleration = _magnitude(states)
    return np.stack(
        [acceleration, _filtered(acceleration, 15, 2, 1), _filtered(heading, 5, 2, 1), _filtered(heading, 5, 2, 2)],
        axis=1,
    )


def _magnitude(rows: Floats) -> Floats:
    """Smoothed magnitude of the acceleration of the rear axle."""
    return _filtered(np.hypot(rows[..., ACCELERATION], rows[..., SIDE_ACCELERATION]), 8, 2, 0)


def _unwrapped(heading: Floats) -> Floats:
    turns = np.zeros_like(heading)
    turns[..., 1:] = np.cumsum(np.round(np.diff(heading, axis=-1) / (2 * np.pi)), axis=-1)
    return np.asarray(heading - 2 * np.pi * turns)


def _filtered(values: Floats, window: int, order: int, derivative: int) -> Floats:
    """A filter along the last axis, rounded as officially."""
    matrix = _savitzky_golay(values.shape[-1], window, order, derivative)
    # einsum without optimisation adds in a fixed order; a BLAS product would depend on the number of plans.
    return np.asarray(np.round(np.einsum("...t,st->...s", values, matrix), DECIMALS))


@functools.cache
def _savitzky_golay(count: int, window: int, order: int, derivative: int) -> Floats:
    """(T, T) the filter as a matrix: least-squares polynomials over windows, none beyond the ends.

    The first and the last half window come from the polynomials through the first and the last whole window.
    """
    half = window // 2
    matrix = np.zeros((count, count))
    for sample in range(count):
        if sample < half:
            start, place = 0, float(sample)
        elif sample >= count - half:
            start, place = count - window, float(sample - (count - window))
        else:
            # An even window reaches one sample farther ahead than back, and its middle is half a sample ahead.
            start, place = sample - (window - 1) // 2, (window - 1) / 2
        matrix[sample, start : start + window] = _weights(window, order, derivative, place)
    matrix.setflags(write=False)
    return matrix


def _weights(window: int, order: int, derivative: int, place: float) -> Floats:
    """(W,) what each sample of a window adds to a derivative at a place in it."""
    offset = np.arange(window) - place
    powers = offset[:, None] ** np.arange(order + 1)
    factorial = float(np.prod(np.arange(1, derivative + 1)))
    return np.asarray(np.linalg.pinv(powers)[derivative] * factorial / DT_S**derivative)


MODEL: Final = MotionModel(DT_S, STATES_PER_WAYPOINT, WHEELBASE_M, False, None)
_STEERING_LAG_SHARE: Final = 2.0 / 3.0
"""Of a steering rate that is asked for, what the wheels do within one step: 0.1 / (0.1 + 0.05)."""


def plan_to_poses(plan: Plan, lidar_ahead_m: float) -> Floats:
    """A plan as (6, 3) poses of the rear axle: x forward, y left of the rear axle now, metres; heading, radians.

    The heading at a waypoint is the direction of the chord between its neighbours, held where that is shorter than 0.3
    m (`benchmark.waypoints.chord_headings`). A plan for the lidar is first moved back to the rear axle by the chords of
    its own waypoints; in a turn those are not the car's headings, so that those of the moved ones are taken.
    """
    poses: Floats = plans_to_poses([plan], lidar_ahead_m)[0]
    return poses


def plans_to_poses(plans: Sequence[Plan], lidar_ahead_m: float) -> Floats:
    """`plan_to_poses` of B plans, those of a frame at once: (B, 6, 3)."""
    poses = np.zeros((len(plans), PLAN_STEPS, 3))
    for frame in dict.fromkeys(plan.frame for plan in plans):
        rows = [place for place, plan in enumerate(plans) if plan.frame is frame]
        waypoints = np.array([plans[place].waypoints[:PLAN_STEPS] for place in rows], np.float64)
        if frame is PlanFrame.LIDAR:
            along = chord_headings(waypoints, start_heading_rad=np.pi / 2) - np.pi / 2
            behind = lidar_ahead_m * np.stack([np.cos(along), np.sin(along)], axis=-1)
            waypoints = points_in_ego(waypoints, lidar_ahead_m) - behind
        headings = chord_headings(waypoints, start_heading_rad=0.0)
        poses[rows] = np.concatenate([waypoints, headings[..., None]], axis=-1)
    return poses


def interpolate_poses(plans: Floats) -> Floats:
    """(B, 31, 3) poses at every state of a motion, the pose now before those of the (B, 6, 3) plan.

    Linear in the frame of the rear axle now, headings by the shortest turn and not wrapped.
    """
    knots = np.concatenate([np.zeros((len(plans), 1, 3)), plans], axis=1)
    step = np.diff(knots, axis=1)
    step[..., 2] = wrap_angle(step[..., 2])
    knots = np.concatenate([knots[:, :1], np.cumsum(step, axis=1)], axis=1)
    knots[:, 1:, :2] = plans[..., :2]
    time = np.arange(STATES) / STATES_PER_WAYPOINT
    before = np.minimum(time.astype(np.int64), PLAN_STEPS - 1)
    fraction = (time - before)[:, None]
    return np.asarray((1.0 - fraction) * knots[:, before] + fraction * knots[:, before + 1])


def fit_reference_path(plans: Floats) -> ReferencePath:
    """Path that the tracker follows: (B, 6, 3) poses of plans, and speeds and curvatures fitted to them.

    Both are in the frame of the rear axle now.
    """
    poses = interpolate_poses(plans).transpose(1, 2, 0)
    direction = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    return fit_path(
        np.ascontiguousarray(poses[:, :2]), np.ascontiguousarray(poses[:, 2]), direction, dt=DT_S, smooth=False
    )


def track_plans(plans: Floats, now: Floats, *, wheelbase_m: float = WHEELBASE_M) -> Floats:
    """(B, 31, 11) states, the first one given, of a car that follows plans: (B, 6, 3) x, y, heading in its frame now.

    The wheelbase is the bicycle's; the tracker always believes in nuPlan's.
    """
    states = np.zeros((len(plans), STATES, STATE_COLUMNS))
    if not len(plans):
        return states
    start = now[:, [SPEED, ACCELERATION, STEERING]].T
    drive = follow_path(fit_reference_path(plans), start, wheelbase_m=wheelbase_m, steps=STATES - 1, model=MODEL)
    _fill_states(states, drive, now, wheelbase_m)
    return states


def _fill_states(states: Floats, drive: BicycleMotion, now: Floats, wheelbase_m: float) -> None:
    """Put a motion in the frame of its start into the columns of global states."""
    x_y, heading, rest = drive.states[:, :2], drive.states[:, 2], drive.states[:, 3:]
    states[..., :2] = to_global(x_y.transpose(2, 0, 1), now[:, None, :3])
    states[..., HEADING] = wrap_angle(heading.T + now[:, None, HEADING])
    states[..., SPEED], states[..., ACCELERATION], states[..., STEERING] = (column.T for column in rest.swapaxes(0, 1))
    states[:, 1:, STEERING_RATE] = _STEERING_LAG_SHARE * drive.commands[:, 1].T
    states[..., YAW_RATE] = states[..., SPEED] * np.tan(states[..., STEERING]) / wheelbase_m
    states[:, 0] = now
    states[:, 1:, YAW_ACCELERATION] = np.diff(states[..., YAW_RATE], axis=1) / DT_S
