"""Can a car follow a trajectory? Tracked by the physics simulator, with and without a driver's limits."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.constants import EGO_LENGTH_M, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import WHEELBASE, DriverLimits, MotionModel, VehicleState, simulate
from benchmark.geometry import Floats
from generation.diffusion.kinematics import STEP_S, STILL_BELOW_M
from generation.diffusion.standardiser import WAYPOINTS

HORIZONS_S: Final = (1, 4, 8)
WITHIN_M: Final = (0.5, 1.0)
LIMITED_M: Final = 0.1
"""A trajectory needed the limits where they move the car by more than this."""
NO_LIMITS: Final = DriverLimits(
    acceleration_m_s2=math.inf,
    braking_m_s2=math.inf,
    jerk_m_s3=math.inf,
    lateral_acceleration_m_s2=math.inf,
    lateral_jerk_m_s3=math.inf,
    yaw_rate_rad_s=math.inf,
    steering_rate_rad_s=math.inf,
    steering_rad=math.pi / 3,
    speed_m_s=math.inf,
)
"""A car that does whatever the tracker asks for, but never reverses."""


@dataclass(frozen=True, slots=True)
class Tracking:
    """How one car followed trajectories.

    Attributes:
        error_m: (N, 16) distance of the rear axle from each waypoint at its time.
        limited: (N,) whether the driver's limits changed the motion by more than 0.1 m.
    """

    error_m: Floats
    limited: np.ndarray[tuple[int], np.dtype[np.bool_]]

    def share_within(self, distance_m: float, seconds: float) -> float:
        """Share of trajectories whose every waypoint up to a time was passed within a distance."""
        waypoints = round(seconds / STEP_S)
        return float((self.error_m[:, :waypoints].max(axis=1) <= distance_m).mean())

    @property
    def share_limited(self) -> float:
        """Share of trajectories that needed the limits."""
        return float(self.limited.mean())


def track(waypoints: Floats, previous: Floats) -> Tracking:
    """Drive along trajectories with `benchmark.dynamics.bicycle` in seconds, each set from its own start.

    Args:
        waypoints: (S, N, 16, 3) S starts, N trajectories each, in the rear-axle frame.
        previous: (S, 3) pose half a second before each start: speed and steering now are read from it.

    Returns:
        Of S * N trajectories, start after start.
    """
    errors, limited = [], []
    frames = FRAMES_PER_KEYFRAME * np.arange(1, WAYPOINTS + 1)
    for group, before in zip(waypoints, previous, strict=True):
        state = _state_after(before)
        steps = WAYPOINTS * FRAMES_PER_KEYFRAME
        driven, free = (
            simulate(group, state, EGO_LENGTH_M, steps=steps, model=MotionModel.si(limits)).states[:, frames, :2]
            for limits in (None, NO_LIMITS)
        )
        errors.append(np.hypot(*np.moveaxis(driven - group[..., :2], -1, 0)))
        limited.append(np.hypot(*np.moveaxis(driven - free, -1, 0)).max(axis=1) > LIMITED_M)
    return Tracking(np.concatenate(errors), np.concatenate(limited))


def _state_after(previous: Floats) -> VehicleState:
    """Speed and steering angle of a car that half a second ago was at ``previous`` and now is at the origin."""
    travelled = float(np.hypot(previous[0], previous[1]))
    curvature = -float(previous[2]) / travelled if travelled > STILL_BELOW_M else 0.0
    return VehicleState(np.zeros(3), travelled / STEP_S, steering=math.atan(curvature * WHEELBASE * EGO_LENGTH_M))
