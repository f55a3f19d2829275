"""When reference drivers find a situation unsafe (UN Regulation 157, RSS, FSM), and how they brake then.

A driver brakes, after its reaction time and with braking that builds up, in unsafe steps only and holds its speed in
others; its clock and its braking are never set back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats

STEP_S: Final = 0.1
HARDEST_BRAKING: Final = 0.774 * 9.81
"""m/s^2: what UN Regulation 157 Annex 3 credits a careful and competent human with, and a dry road."""
CAREFUL_TIME_S: Final = 2.0
"""The careful human reacts when contact is this near."""
REGULATION_BRAKING: Final = 6.0
REGULATION_REACTION_S: Final = 0.35
REGULATION_SIDE_M: Final = 0.5
REACTION_S: Final = 0.75
_RSS_ACCELERATION: Final = 3.0
_RSS_BRAKING: Final = 6.0
_RSS_SIDE_ACCELERATION: Final = 1.0
_RSS_SIDE_MARGIN_M: Final = 0.3
_FSM_COMFORTABLE: Final = 4.0
_FSM_HARD: Final = 6.0
_FSM_LEADER: Final = 7.0
_FSM_MARGIN_M: Final = 2.0


def rss_distance_along(speed: Floats, leader_speed: Floats) -> Floats:
    """Smallest safe gap to a leader by RSS, metres, possibly negative.

    React, accelerating, then brake while the leader brakes.
    """
    after = speed + REACTION_S * _RSS_ACCELERATION
    reacting = speed * REACTION_S + 0.5 * _RSS_ACCELERATION * REACTION_S**2
    return np.asarray(reacting + (after**2 - leader_speed**2) / (2 * _RSS_BRAKING))


def rss_distance_across(side_speed: Floats) -> Floats:
    """Smallest safe distance sideways by RSS, metres, by the other's speed across the path, not negative."""
    after = side_speed + _RSS_SIDE_ACCELERATION * REACTION_S
    reacting = np.abs((side_speed + after) * REACTION_S / 2)
    return np.asarray(_RSS_SIDE_MARGIN_M + reacting + after**2 / (2 * _RSS_SIDE_ACCELERATION))


def proactive_score(gap: Floats, speed: Floats, leader_speed: Floats) -> Floats:
    """FSM's proactive fuzzy score: 0 where the gap would do if the leader stopped hard, 1 where it surely would not."""
    reacting, leader = speed * REACTION_S, leader_speed**2 / (2 * _FSM_LEADER)
    safe = reacting + speed**2 / (2 * _FSM_COMFORTABLE) - leader + _FSM_MARGIN_M
    unsafe = reacting + speed**2 / (2 * _FSM_HARD) - leader
    return _grade_gap(gap - _FSM_MARGIN_M, safe, unsafe)


def critical_score(gap: Floats, speed: Floats, leader_speed: Floats, acceleration: Floats) -> Floats:
    """FSM's critical fuzzy score, 0 to 1, by the ego's acceleration: whether the gap would do at the leader's speed."""
    held = np.maximum(acceleration, -_FSM_COMFORTABLE)
    later = speed + REACTION_S * held
    reacting = REACTION_S * (speed + 0.5 * REACTION_S * held - leader_speed)
    closing = (later - leader_speed) ** 2
    safe, unsafe = reacting + closing / (2 * _FSM_COMFORTABLE), reacting + closing / (2 * _FSM_HARD)
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = (speed - leader_speed) ** 2 / np.abs(2 * acceleration)
    braked = np.where(gap < needed, 1.0, 0.0)
    score = np.where(later < leader_speed, braked, _grade_gap(gap, safe, unsafe))
    return np.where(speed <= leader_speed, 0.0, score)


def fuzzy_target(critical: Floats, proactive: Floats) -> Floats:
    """Braking that FSM asks for, m/s^2; 0 where it is at ease."""
    strong = _FSM_COMFORTABLE + (_FSM_HARD - _FSM_COMFORTABLE) * critical
    return np.where(critical > 0, strong, _FSM_COMFORTABLE * proactive)


def regulation_time(closing: Floats) -> Floats:
    """Time to contact below which UN Regulation 157, 5.2.5.2 asks for braking, seconds; 0.1 s is one step more."""
    return closing / (2 * REGULATION_BRAKING) + (REGULATION_REACTION_S + STEP_S)


def _grade_gap(gap: Floats, safe: Floats, unsafe: Floats) -> Floats:
    """0 beyond the safe gap, 1 below the unsafe one, linear between."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (gap - safe) / (unsafe - safe)
    return np.where(gap > safe, 0.0, np.where(gap < unsafe, 1.0, share))


def is_at_most(quantity: Floats, limit: Floats | float) -> Bools:
    """Whether a quantity does not exceed a limit; NaN, as of 0/0, does not."""
    return np.asarray(~(quantity > limit))


class Driver(StrEnum):
    """Reference driver.

    ``RECORDED`` is the recorded ego, ``CONSTANT`` keeps the speed of the start, ``IDM`` keeps distance; ``R157`` does
    what UN Regulation 157, 5.2.5.2 asks for, ``CC`` is the careful and competent human of its Annex 3.
    """

    RECORDED = "recorded"
    CONSTANT = "constant"
    IDM = "idm"
    R157 = "r157"
    CC = "cc"
    FSM = "fsm"
    RSS = "rss"


REACTING: Final = (Driver.R157, Driver.CC, Driver.FSM, Driver.RSS)
"""Those that follow the recording until they find something unsafe."""
_DELAY_STEPS: Final = {Driver.R157: 4, Driver.CC: 8, Driver.FSM: 8, Driver.RSS: 8}
"""0.35 and 0.75 s, counted down in steps of 0.1 s until nothing is left."""
_COASTING: Final = 0.4
"""Braking of the careful human while it reacts, m/s^2."""
_BUILD_UP: Final = 12.65 * STEP_S
"""How much braking rises in a step, m/s^2."""


@dataclass(slots=True)
class ReactionState:
    """Memory of R drivers of `REACTING`.

    ``delay``, unsafe steps of reaction left, and ``braking``, m/s^2, are (R, 1), or (R, C) for C situations each.
    """

    drivers: tuple[Driver, ...]
    delay: Floats
    braking: Floats

    @classmethod
    def fresh(cls, drivers: Sequence[Driver], situations: int = 1) -> "ReactionState":
        """Drivers who have not reacted to anything yet."""
        delay = np.array([_DELAY_STEPS.get(driver, 0) for driver in drivers], np.float64)
        shape = (len(drivers), situations)
        return cls(tuple(drivers), np.broadcast_to(delay[:, None], shape).copy(), np.zeros(shape))

    def react(self, unsafe: Bools, speed: Floats, target: Floats) -> Floats:
        """(R, C) speed after one step of those in an ``unsafe`` situation; the others remember as before.

        It may be negative during the reaction of the careful human. ``target`` is (R, C), the braking that FSM asks
        for, m/s^2; other drivers do not look at it.
        """
        regulation, careful, fuzzy = (self._are(driver) for driver in (Driver.R157, Driver.CC, Driver.FSM))
        waiting = self.delay > 0
        built_up = np.minimum(self.braking + _BUILD_UP, HARDEST_BRAKING)
        built_up = np.where(fuzzy, np.minimum(built_up, target), built_up)
        built_up = np.where(regulation, REGULATION_BRAKING, built_up)
        braking = np.where(waiting, np.where(careful, _COASTING, 0.0), built_up)
        self.braking = np.where(unsafe & ~regulation, braking, self.braking)
        self.delay = np.where(unsafe & waiting, self.delay - 1, self.delay)
        slower = speed - STEP_S * braking
        return np.where(waiting, slower, np.maximum(slower, 0.0))

    def _are(self, driver: Driver) -> Bools:
        return np.array([[own_driver is driver] for own_driver in self.drivers], np.bool_)
