"""Which limit of a driver a recorded or generated track breaks, by finite differences at 12 Hz."""

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import DriverLimits, rear_axle
from benchmark.geometry import Floats, wrap_angle

LIMIT_TOLERANCE = 1.05
"""Finite differences at 12 Hz overshoot the simulator's own limits by less than this factor."""
SIDEWAYS_M_S = 0.3
"""Sideways speed of the rear axle that an explicit integration step may show in a tight turn."""


def broken_limit(boxes: Floats, limits: DriverLimits, *, rounded_m: float = 0.0) -> tuple[str, float, float] | None:
    """First limit of the driver that a 12 Hz track breaks: finite differences of the rear axle's path.

    Name with unit, value and limit, or ``None``; tracks of fewer than three frames break none.
    ``rounded_m`` is how far each position may be from where it was, where a file holds it to a few digits: the limits
    are wider by what that does to the differences.
    """
    if len(boxes) < 3:
        return None
    axle = rear_axle(boxes[:, [0, 1, 4]], float(boxes[0, 2]))
    step = np.diff(axle[:, :2], axis=0) * FRAME_HZ
    yaw = axle[:-1, 2]
    along = step[:, 0] * np.cos(yaw) + step[:, 1] * np.sin(yaw)
    across = step[:, 1] * np.cos(yaw) - step[:, 0] * np.sin(yaw)
    yaw_rate = wrap_angle(np.diff(axle[:, 2])) * FRAME_HZ
    acceleration = np.diff(along) * FRAME_HZ
    sideways = SIDEWAYS_M_S + 2 * rounded_m * FRAME_HZ
    more = 4 * rounded_m * FRAME_HZ**2
    measured = (
        ("speed sideways, m/s", np.abs(across).max(), sideways),
        ("speed backwards, m/s", -along.min(), sideways),
        ("acceleration, m/s^2", acceleration.max(), limits.acceleration_m_s2 * LIMIT_TOLERANCE + more),
        ("braking, m/s^2", -acceleration.min(), limits.braking_m_s2 * LIMIT_TOLERANCE + more),
        ("yaw rate, rad/s", np.abs(yaw_rate).max(), limits.yaw_rate_rad_s * LIMIT_TOLERANCE),
        (
            "lateral acceleration, m/s^2",
            np.abs(yaw_rate * along).max(),
            limits.lateral_acceleration_m_s2 * LIMIT_TOLERANCE,
        ),
    )
    return next(((name, float(value), limit) for name, value, limit in measured if not value <= limit), None)
