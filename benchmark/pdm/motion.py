"""From plans to motions: the official tracker and bicycle follow a plan, and 31 states of the car come out.

Tracker and bicycle are those of `benchmark.dynamics` in the units of NAVSIM: 0.1 s a step, nuPlan's wheelbase, no limit
but that of the steering angle. Differences to NAVSIM's own numbers are below 1e-9 (`challenger-bench verify pdm`).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.dynamics.bicycle import Drive, MotionModel, drive_along
from benchmark.dynamics.reference_path import ReferencePath, fitted_path
from benchmark.geometry import Floats, to_global, wrap_angle
from benchmark.pdm.definition import (
    ACCELERATION,
    DT_S,
    HEADING,
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

MODEL: Final = MotionModel(DT_S, STATES_PER_WAYPOINT, WHEELBASE_M, False, None)
_STEERING_LAG_SHARE: Final = 2.0 / 3.0
"""Of a steering rate that is asked for, what the wheels do within one step: 0.1 / (0.1 + 0.05)."""


def headed(plan: Plan, lidar_ahead_m: float) -> Floats:
    """A plan as poses of the rear axle.

    The heading at a waypoint is the direction of the chord between its neighbours, held where that is shorter than
    0.3 m (`benchmark.waypoints.chord_headings`). A plan for the lidar is first moved back to the rear axle by the
    chords of its own waypoints; in a turn those are not the car's headings, so that those of the moved ones are taken.

    Returns:
        (6, 3) x forward, y left of the rear axle now, metres; heading, radians.
    """
    poses: Floats = all_headed([plan], lidar_ahead_m)[0]
    return poses


def all_headed(plans: Sequence[Plan], lidar_ahead_m: float) -> Floats:
    """`headed` of B plans, those of a frame at once: (B, 6, 3)."""
    found = np.zeros((len(plans), PLAN_STEPS, 3))
    for frame in dict.fromkeys(plan.frame for plan in plans):
        those = [place for place, plan in enumerate(plans) if plan.frame is frame]
        waypoints = np.array([plans[place].waypoints[:PLAN_STEPS] for place in those], np.float64)
        if frame is PlanFrame.LIDAR:
            along = chord_headings(waypoints, start_heading_rad=np.pi / 2) - np.pi / 2
            behind = lidar_ahead_m * np.stack([np.cos(along), np.sin(along)], axis=-1)
            waypoints = points_in_ego(waypoints, lidar_ahead_m) - behind
        headings = chord_headings(waypoints, start_heading_rad=0.0)
        found[those] = np.concatenate([waypoints, headings[..., None]], axis=-1)
    return found


def interpolated(plans: Floats) -> Floats:
    """(B, 31, 3) poses at every state of a motion, the pose now before those of the plan.

    Linear in the frame of the rear axle now, headings by the shortest turn and not wrapped. Plans are (B, 6, 3).
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


def reference_of(plans: Floats) -> ReferencePath:
    """Path that the tracker follows: the plan's poses, and speeds and curvatures fitted to them.

    Plans are (B, 6, 3) x, y, heading in the frame of the rear axle now; the path is in that frame too, B
    candidates.
    """
    poses = interpolated(plans).transpose(1, 2, 0)
    direction = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    return fitted_path(
        np.ascontiguousarray(poses[:, :2]), np.ascontiguousarray(poses[:, 2]), direction, dt=DT_S, smooth=False
    )


def tracked(plans: Floats, now: Floats, *, wheelbase_m: float = WHEELBASE_M) -> Floats:
    """The motion of a car that follows plans.

    Args:
        plans: (B, 6, 3) x, y, heading in the frame of the rear axle now.
        now: (B, 11) states at the start.
        wheelbase_m: Of the bicycle; the tracker always believes in nuPlan's.

    Returns:
        (B, 31, 11) states, the first one as given.
    """
    states = np.zeros((len(plans), STATES, STATE_COLUMNS))
    if not len(plans):
        return states
    start = now[:, [SPEED, ACCELERATION, STEERING]].T
    drive = drive_along(reference_of(plans), start, wheelbase_m=wheelbase_m, steps=STATES - 1, model=MODEL)
    _fill(states, drive, now, wheelbase_m)
    return states


def _fill(states: Floats, drive: Drive, now: Floats, wheelbase_m: float) -> None:
    """Put a motion in the frame of its start into the columns of global states."""
    x_y, heading, rest = drive.states[:, :2], drive.states[:, 2], drive.states[:, 3:]
    states[..., :2] = to_global(x_y.transpose(2, 0, 1), now[:, None, :3])
    states[..., HEADING] = wrap_angle(heading.T + now[:, None, HEADING])
    states[..., SPEED], states[..., ACCELERATION], states[..., STEERING] = (column.T for column in rest.swapaxes(0, 1))
    states[:, 1:, STEERING_RATE] = _STEERING_LAG_SHARE * drive.commands[:, 1].T
    states[..., YAW_RATE] = states[..., SPEED] * np.tan(states[..., STEERING]) / wheelbase_m
    states[:, 0] = now
    states[:, 1:, YAW_ACCELERATION] = np.diff(states[..., YAW_RATE], axis=1) / DT_S
