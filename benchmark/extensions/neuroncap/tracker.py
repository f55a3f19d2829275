"""NeuroNCAP's tracker: nuPlan's linear-quadratic regulator over one second, with the project's own weights."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.extensions.neuroncap.plan_path import SUBSTEP_S, PlanPath
from benchmark.geometry import Floats, wrap_angle

HORIZON_STEPS: Final = 10
LARGEST_ACCELERATION: Final = 6.0
"""m/s^2, of either sign."""
STOPPING_GAIN: Final = 1.5
_STOPPING_SPEED: Final = 0.5
_SPEED_WEIGHT: Final = 10.0
_LATERAL_WEIGHT: Final = 20.0
_STEERING_WEIGHT: Final = 0.05
_HORIZON_S: Final = HORIZON_STEPS * SUBSTEP_S
_CRUISING_GAIN: Final = _SPEED_WEIGHT * _HORIZON_S / (_SPEED_WEIGHT * _HORIZON_S**2 + 1.0)
"""Least squares over the horizon of one constant acceleration, whose square costs 1."""


@dataclass(frozen=True, slots=True)
class Tracked:
    """Car as the tracker sees it.

    Attributes:
        pose: (3,) x, y, heading in the frame of the plan.
        speed: m/s.
        steering: Angle of the wheels, radians.
        wheelbase_m: That it assumes.
    """

    pose: Floats
    speed: float
    steering: float
    wheelbase_m: float


def asked_for(path: PlanPath, now_us: int, car: Tracked, *, clip_first: bool) -> tuple[float, float]:
    """Acceleration and steering rate that the tracker asks of pedals and steering wheel.

    Args:
        clip_first: Whether steering is planned with the acceleration as it will be limited.

    Returns:
        Acceleration, not limited unless ``clip_first``, m/s^2; steering rate, rad/s.
    """
    now = now_us * 1e-6
    excess = car.speed - float(path.at(path.speed, now + _HORIZON_S))
    wanted = car.speed - excess
    if wanted <= _STOPPING_SPEED and car.speed <= _STOPPING_SPEED:
        return -STOPPING_GAIN * excess, 0.0
    acceleration = -_CRUISING_GAIN * excess
    if clip_first:
        acceleration = float(np.clip(acceleration, -LARGEST_ACCELERATION, LARGEST_ACCELERATION))
    ahead = np.arange(HORIZON_STEPS)
    curvature = path.at(path.curvature, [now + SUBSTEP_S * step for step in ahead.tolist()])
    travel = SUBSTEP_S * (car.speed + SUBSTEP_S * acceleration * ahead)
    lateral, heading = _errors(path, now_us, car.pose)
    free, response = _predicted(travel, curvature, (lateral, heading, car.steering), car.wheelbase_m)
    rate = -_LATERAL_WEIGHT * response * free / (_LATERAL_WEIGHT * response**2 + _STEERING_WEIGHT)
    return acceleration, rate


def _errors(path: PlanPath, now_us: int, pose: Floats) -> tuple[float, float]:
    """How far left of the path the car is, and how far it is turned left of it."""
    at = min(round((now_us - path.start_us) * 1e-6 / SUBSTEP_S), len(path.poses) - 1)
    x, y, heading = path.poses[at]
    lateral = np.cos(heading) * (pose[1] - y) - np.sin(heading) * (pose[0] - x)
    return float(lateral), float(wrap_angle(np.array(pose[2] - heading)))


def _predicted(
    travel: Floats, curvature: Floats, start: tuple[float, float, float], wheelbase_m: float
) -> tuple[float, float]:
    """Lateral error at the end of the horizon without steering, and what a steering rate of one adds to it."""
    lateral, heading, steering = start
    more_lateral = more_heading = more_steering = 0.0
    for metres, bend in zip(travel.tolist(), curvature.tolist()):
        lateral += metres * heading
        heading += metres * (steering / wheelbase_m - bend)
        more_lateral += metres * more_heading
        more_heading += metres * more_steering / wheelbase_m
        more_steering += SUBSTEP_S
    return lateral, more_lateral
