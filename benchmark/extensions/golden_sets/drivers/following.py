"""The situations of the official tables: cut-ins, and a leader that brakes; on a straight road."""

from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.interactions.reaction import REACTION_S, STEP_S, rss_distance_along
from benchmark.interactions.straight_road import LENGTH_M, WIDTH_M, OtherCar

SIDE_M: Final = 1.6
"""Free distance sideways before a cut-in."""
_SIDE_STEP: Final = 0.15
"""How much the side speed of a cut-in rises in a step, m/s."""
_AFTERWARDS_STEPS: Final = 40
"""A cut-in is watched this long after it is over."""
_RSS_BRAKING: Final = 6.0


def compute_following_distances(speed: Floats) -> dict[str, Floats]:
    """Gaps in metres at which ``cc``, ``rss`` and ``fsm`` follow at equal speed (m/s): official tables start so."""
    later = np.maximum(speed - REACTION_S * _RSS_BRAKING, 0.0)
    return {
        "cc": 2.0 * speed,
        "rss": rss_distance_along(speed, later) + _RSS_BRAKING * REACTION_S**2 / 2,
        "fsm": REACTION_S * speed + speed**2 / 8 - speed**2 / 14 + 4.0,
    }


def build_cut_ins(ego_speed: Floats, other_speed: Floats, gap: Floats, side_speed: float) -> tuple[OtherCar, Floats]:
    """Cut-ins from the left until after crossing, and (C,) starts of the ego; m/s, bumper gaps in metres.

    The other first gathers side speed while both drive; when it has it, it is `SIDE_M` off and ``gap`` ahead.
    """
    offset = SIDE_M + WIDTH_M
    gathering = int(np.ceil(side_speed / _SIDE_STEP))
    held = int(np.floor(offset / (STEP_S * side_speed))) + 1 if side_speed > 0 else 0
    step = np.arange(gathering + held + 1 + _AFTERWARDS_STEPS)
    side = np.where(step <= gathering + held, -np.minimum(_SIDE_STEP * step, side_speed), 0.0)
    across = np.concatenate([[0.0], np.cumsum(STEP_S * side)[:-1]])
    shape = (len(gap), len(step))
    along = LENGTH_M + gap[:, None] + STEP_S * other_speed[:, None] * (step - gathering)
    other = OtherCar(
        x=along,
        y=np.broadcast_to(offset + across - across[gathering], shape),
        speed=np.broadcast_to(other_speed[:, None], shape),
        side_speed=np.broadcast_to(side, shape),
    )
    return other, -STEP_S * ego_speed * gathering


def build_braking_leaders(speed: Floats, deceleration: Floats, gap: Floats, steps: int) -> tuple[OtherCar, Floats]:
    """Leaders that brake to a stand from the first step, followed at their own speed, and (C,) starts of the ego.

    (C,) m/s, m/s^2, and metres from bumper to bumper.
    """
    leader = np.maximum(speed[:, None] - STEP_S * deceleration[:, None] * np.arange(steps), 0.0)
    along = gap[:, None] + LENGTH_M + np.cumsum(STEP_S * leader, axis=1)
    still = np.zeros(along.shape)
    return OtherCar(along, still, leader, still), STEP_S * speed
