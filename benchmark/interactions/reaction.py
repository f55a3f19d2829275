"""How reference drivers brake once they find a situation unsafe: reaction time, then braking that builds up.

A driver brakes in unsafe steps only and holds its speed in others; its clock and its braking are never set back.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.interactions.rules import HARDEST_BRAKING, REGULATION_BRAKING, STEP_S


class Driver(StrEnum):
    """Who drives.

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
class Reactions:
    """Memory of R drivers of `REACTING`.

    ``delay``, unsafe steps of reaction left, and ``braking``, m/s^2, are (R, 1), or (R, C) for C situations each.
    """

    drivers: tuple[Driver, ...]
    delay: Floats
    braking: Floats

    @classmethod
    def fresh(cls, drivers: Sequence[Driver], situations: int = 1) -> "Reactions":
        """Drivers who have not reacted to anything yet."""
        delay = np.array([_DELAY_STEPS.get(driver, 0) for driver in drivers], np.float64)
        shape = (len(drivers), situations)
        return cls(tuple(drivers), np.broadcast_to(delay[:, None], shape).copy(), np.zeros(shape))

    def react(self, unsafe: Bools, speed: Floats, target: Floats) -> Floats:
        """One step of those in an unsafe situation.

        Args:
            unsafe: (R, C) whose situation is unsafe; the others remember as before.
            speed: (R, C) m/s.
            target: (R, C) the braking that FSM asks for, m/s^2; the others do not look at it.

        Returns:
            (R, C) speed after the step where it is unsafe; during the reaction of the careful human it may be negative.
        """
        regulation, careful, fuzzy = (self._are(who) for who in (Driver.R157, Driver.CC, Driver.FSM))
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
        return np.array([[each is driver] for each in self.drivers], np.bool_)
