"""IDM as a reference driver: the formula of nuPlan's planner, with brakes that a car has.

Not `benchmark.dynamics.idm`, which drives the town's traffic: that one carries its authors' later corrections so that
platoons do not collide; this one is the plain model of Treiber, Hennecke and Helbing (2000) that the field names so.
"""

from typing import Final

import numpy as np

from benchmark.geometry import Floats

ACCELERATION: Final = 1.0
COMFORTABLE_BRAKING: Final = 2.0
HARDEST_BRAKING: Final = 6.0
"""nuPlan's own policy brakes with at most 2 m/s^2 and so cannot avoid a cut-in."""
TIME_GAP_S: Final = 1.5
STANDSTILL_GAP_M: Final = 1.0
SMALLEST_GAP_M: Final = 1.0
_EXPONENT: Final = 4


def compute_idm_acceleration(speed: Floats, free_speed: float | Floats, gap: Floats, leader_speed: Floats) -> Floats:
    """Acceleration of a car that keeps distance, m/s^2; the gap is infinite without a leader.

    Speeds are m/s, the leader's along the path.
    """
    near = np.maximum(gap, SMALLEST_GAP_M)
    closing = _compute_wanted_gap(speed, leader_speed, TIME_GAP_S, ACCELERATION, COMFORTABLE_BRAKING)
    wanted = STANDSTILL_GAP_M + np.maximum(closing, 0.0)
    raw = ACCELERATION * (1 - (speed / free_speed) ** _EXPONENT - (wanted / near) ** 2)
    return np.asarray(np.clip(raw, -HARDEST_BRAKING, ACCELERATION))


def compute_nuplan_acceleration(
    speed: Floats,
    gap: Floats,
    leader_speed: Floats,
    free_speed: float,
    standstill_gap: float,
    time_gap: float,
    acceleration: float,
    braking: float,
) -> Floats:
    """NuPlan's formula as it stands: no limit, and a leader that drives away shortens the wanted gap.

    Metres, seconds, m/s and m/s^2; ``braking`` is the comfortable one.
    """
    wanted = standstill_gap + _compute_wanted_gap(speed, leader_speed, time_gap, acceleration, braking)
    near = np.maximum(gap, standstill_gap)
    return np.asarray(acceleration * (1 - (speed / free_speed) ** _EXPONENT - (wanted / near) ** 2))


def _compute_wanted_gap(
    speed: Floats, leader_speed: Floats, time_gap: float, acceleration: float, braking: float
) -> Floats:
    closing = speed * (speed - leader_speed) / (2 * np.sqrt(acceleration * braking))
    return np.asarray(speed * time_gap + closing)
