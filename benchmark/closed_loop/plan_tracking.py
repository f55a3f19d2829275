"""How the ego follows a plan in the `default` engine: a tracker and a kinematic bicycle of the recording car's own.

The tracker is a linear-quadratic one over the plan's 3 s: from where the car is, as fast and as accelerated as it is,
the motion that comes closest to the six waypoints while jerk costs something. Because its start is the car's own, what
a plan corrects is corrected in the first half second, and a recording that is given as plans is reproduced. The
bicycle has limits of tyres and brakes and never drives backwards.

Arrays have the scenes last, and no sum runs over scenes or leaves its order to a library: the company in which a scene
is stepped changes no byte of it.
"""

import functools
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from benchmark.constants import EGO_WHEELBASE_M, PLAN_STEPS
from benchmark.dynamics.bicycle import DriverLimits, compute_steering_limits
from benchmark.geometry import Floats, wrap_angle

SUBSTEP_S: Final = 0.1
SUBSTEP_US: Final = 100_000
SUBSTEPS: Final = 5
INSTANTS: Final = 2
"""Of each sub-step at which contact is looked for."""
INSTANT_US: Final = SUBSTEP_US // INSTANTS
LIMITS: Final = DriverLimits(
    acceleration_m_s2=4.0,
    braking_m_s2=8.0,
    jerk_m_s3=12.65,
    lateral_acceleration_m_s2=8.0,
    lateral_jerk_m_s3=20.0,
    yaw_rate_rad_s=1.5,
    steering_rate_rad_s=0.8,
    steering_rad=0.6,
    speed_m_s=60.0,
)
"""Of the car and not of a comfortable driver: dry asphalt, brakes that build up in 0.6 s (UN R157)."""
_JERK_WEIGHT: Final = 0.01
"""Squared metres of missing a waypoint that a jerk of 1 m/s^3 costs each second."""
_SLOW_M_S: Final = 0.3
"""Slower than this, the direction of a motion says nothing about the wheels; they stay turned."""


@dataclass(frozen=True, slots=True)
class Ego:
    """The ego now; the point is the rear axle.

    Global metres, radians, m/s that are not negative, m/s^2 along the heading; steering is the angle of the wheels.
    """

    x: float
    y: float
    yaw: float
    speed: float
    acceleration: float = 0.0
    steering: float = 0.0

    @property
    def row(self) -> tuple[float, ...]:
        """Its six values, in the order above."""
        return self.x, self.y, self.yaw, self.speed, self.acceleration, self.steering

    @property
    def pose(self) -> Floats:
        """(3,) x, y, yaw."""
        return np.array([self.x, self.y, self.yaw])

    @property
    def yaw_rate(self) -> float:
        """Rad/s."""
        return float(self.speed * np.tan(self.steering) / EGO_WHEELBASE_M)

    @classmethod
    def of_row(cls, row: Floats) -> Self:
        """From (6,) values in the order above."""
        return cls(*row.tolist())


def follow_waypoints(egos: Floats, targets: Floats, substeps: int = SUBSTEPS) -> Floats:
    """(2 substeps + 1, 6, S) egos every 0.05 s from now, driven towards waypoints for at most 5 steps of 0.1 s.

    ``egos`` are (6, S) values of `Ego`, now; ``targets`` (6, 2, S) are where the rear axle should be after 0.5, 1.0 ..
    3.0 s: x forward, y left of where it is, metres.
    """
    speed, heading = _compute_targets(egos, targets)
    states = np.empty((INSTANTS * substeps + 1, *egos.shape))
    states[0] = egos
    turned = np.zeros(egos.shape[1])
    for number in range(substeps):
        now = states[INSTANTS * number]
        acceleration, steering = _compute_commands(now, speed[number + 1], heading[number + 1] - turned)
        for instant in range(INSTANTS):
            here = INSTANTS * number + instant
            states[here + 1] = _advance_bicycle(states[here], acceleration, steering)
            turned = turned + _compute_turn(states[here], states[here + 1], steering)
    return states


def _compute_targets(egos: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Speeds and headings, relative to now, of the smooth motion at 0, 0.1 .. 0.5 s: (6, S) each."""
    per_speed, per_acceleration, per_target = _fit_smooth_motion()
    speed, acceleration = egos[3], egos[4]
    sideways = speed * speed * np.tan(egos[5]) / EGO_WHEELBASE_M
    x = per_speed[:, None] * speed + per_acceleration[:, None] * acceleration
    y = per_acceleration[:, None] * sideways
    for number in range(PLAN_STEPS):
        x = x + per_target[:, number, None] * targets[number, 0]
        y = y + per_target[:, number, None] * targets[number, 1]
    forward = x > 0.0
    size = np.sqrt(x * x + y * y)
    heading = np.where(forward, np.arctan2(y, np.where(forward, x, 1.0)), 0.0)
    return np.asarray(np.where(forward, size, 0.0)), np.asarray(heading)


@functools.cache
def _fit_smooth_motion() -> tuple[Floats, Floats, Floats]:
    """Velocity at 0, 0.1 .. 0.5 s of the best motion per speed (6,), acceleration (6,) and waypoint (6, 6).

    Jerk is constant in each of 30 steps of 0.1 s and minimises the squared distances to the waypoints plus its own
    weighted square; position, velocity and acceleration start as they are.
    """
    dt, steps = SUBSTEP_S, PLAN_STEPS * SUBSTEPS
    advance = np.array([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    push = np.array([dt**3 / 6, dt**2 / 2, dt])
    free, forced = [np.eye(3)], [np.zeros((3, steps))]
    for step in range(steps):
        after = advance @ forced[-1]
        after[:, step] += push
        free.append(advance @ free[-1])
        forced.append(after)
    at_waypoints = [SUBSTEPS * (number + 1) for number in range(PLAN_STEPS)]
    reach = np.array([forced[index][0] for index in at_waypoints])
    drift = np.array([free[index][0] for index in at_waypoints])
    jerk_per_miss = np.linalg.solve(reach.T @ reach + _JERK_WEIGHT * dt * np.eye(steps), reach.T)
    velocity = np.array([forced[index][1] for index in range(SUBSTEPS + 1)]) @ jerk_per_miss
    start = np.array([free[index][1] for index in range(SUBSTEPS + 1)]) - velocity @ drift
    return np.array(start[:, 1]), np.array(start[:, 2]), np.asarray(velocity)


def _compute_commands(now: Floats, speed: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """(S,) acceleration and (S,) steering angle that reach a speed and a turn within a sub-step, within limits."""
    most_change = LIMITS.jerk_m_s3 * SUBSTEP_S
    wanted_acceleration = (np.minimum(speed, LIMITS.speed_m_s) - now[3]) / SUBSTEP_S
    wanted_acceleration = np.clip(wanted_acceleration, now[4] - most_change, now[4] + most_change)
    wanted_acceleration = np.clip(wanted_acceleration, -LIMITS.braking_m_s2, LIMITS.acceleration_m_s2)
    after = np.maximum(now[3] + SUBSTEP_S * wanted_acceleration, 0.0)
    acceleration = (after - now[3]) / SUBSTEP_S
    travel = 0.5 * SUBSTEP_S * (now[3] + after)
    moving = (speed > _SLOW_M_S) & (travel > SUBSTEP_S * _SLOW_M_S)
    steering = np.where(moving, np.arctan(EGO_WHEELBASE_M * heading / np.where(moving, travel, 1.0)), now[5])
    most_turn, most_angle = compute_steering_limits(after, EGO_WHEELBASE_M, LIMITS, SUBSTEP_S)
    steering = np.clip(steering, now[5] - most_turn, now[5] + most_turn)
    return np.asarray(acceleration), np.asarray(np.clip(steering, -most_angle, most_angle))


def _advance_bicycle(now: Floats, acceleration: Floats, steering: Floats) -> Floats:
    """(6, S) the bicycle after half a sub-step, by the heading in the middle of it."""
    seconds = SUBSTEP_S / INSTANTS
    after = np.empty_like(now)
    speed = np.maximum(now[3] + seconds * acceleration, 0.0)
    travel = 0.5 * seconds * (now[3] + speed)
    turn = travel * np.tan(steering) / EGO_WHEELBASE_M
    after[0] = now[0] + travel * np.cos(now[2] + 0.5 * turn)
    after[1] = now[1] + travel * np.sin(now[2] + 0.5 * turn)
    after[2] = wrap_angle(now[2] + turn)
    after[3], after[4], after[5] = speed, acceleration, steering
    return after


def _compute_turn(now: Floats, after: Floats, steering: Floats) -> Floats:
    """(S,) radians turned between two states."""
    return np.asarray(0.5 * (SUBSTEP_S / INSTANTS) * (now[3] + after[3]) * np.tan(steering) / EGO_WHEELBASE_M)
