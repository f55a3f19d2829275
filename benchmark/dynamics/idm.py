"""The intelligent-driver model: how a driver keeps distance.

The model is that of Treiber, Hennecke and Helbing (2000), equations 1-3, with two of its authors' own corrections: a
car that is faster than it wants to be brakes comfortably (Treiber and Kesting, "Traffic Flow Dynamics", 2013, improved
model), and a gap that is small but does not close is no emergency (Kesting, Treiber and Helbing 2010, enhanced model,
with leaders that keep their speed). Without them it brakes so hard behind a close leader that the car behind hits it.
"""

from dataclasses import dataclass

import numpy as np

_EXPONENT = 4
"""How acceleration falls off towards the wanted speed."""


@dataclass(frozen=True, slots=True)
class DriverParameters:
    """Kind of driver, in metres, m/s and m/s^2.

    Attributes:
        speed_limit: Wanted speed on a free road unless the car is faster already.
        coolness: Trust in the leader, 0 (the original model) to 1.
        lateral_acceleration: In bends.
        foresight_s: For how long others of the same direction are expected to keep moving sideways.
        side_margin_m: Room beside the car that counts as its corridor.
        sight_m: Others further away are not looked at.
    """

    speed_limit: float = 13.9
    time_gap_s: float = 1.0
    standstill_gap_m: float = 2.0
    acceleration: float = 1.0
    comfortable_braking: float = 1.5
    hardest_braking: float = 7.0
    coolness: float = 0.99
    lateral_acceleration: float = 2.5
    foresight_s: float = 1.5
    side_margin_m: float = 0.3
    sight_m: float = 70.0


def idm_acceleration(
    speed: float, free_speed: float, gap: float, leader_speed: float, driver: DriverParameters
) -> float:
    """Acceleration of a car that follows a leader, or none, m/s^2, not below ``-driver.hardest_braking``.

    The gap is from its front to the rear of the leader, infinite without one; the leader's speed along the same path.
    """
    ratio = speed / max(free_speed, 0.1)
    if ratio <= 1.0:
        free = driver.acceleration * (1.0 - ratio**_EXPONENT)
    else:
        sharpness = driver.acceleration * _EXPONENT / driver.comfortable_braking
        free = -driver.comfortable_braking * (1.0 - ratio**-sharpness)
    if not np.isfinite(gap):
        return free
    gap = max(gap, 0.1)
    closing = speed - leader_speed
    braking_distance = speed * closing / (2 * np.sqrt(driver.acceleration * driver.comfortable_braking))
    wanted_gap = driver.standstill_gap_m + max(speed * driver.time_gap_s + braking_distance, 0.0)
    following = free - driver.acceleration * (wanted_gap / gap) ** 2
    # Acceleration that suffices if the leader keeps its motion: a driver who trusts it lets the gap grow gently.
    trusting = -(max(closing, 0.0) ** 2) / (2 * gap)
    if following < trusting:
        beyond = trusting + driver.comfortable_braking * np.tanh((following - trusting) / driver.comfortable_braking)
        following = (1.0 - driver.coolness) * following + driver.coolness * beyond
    return max(float(following), -driver.hardest_braking)
