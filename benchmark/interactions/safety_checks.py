"""When a reference driver on a recorded path finds an agent unsafe: the checks of `rules`, with the signs put right.

A leader that drives away is no danger however near, except where the bodies already overlap along the path; and one
that rolls backwards is taken to stand where a rule squares its speed.
"""

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.interactions.reaction import (
    CAREFUL_TIME_S,
    REGULATION_SIDE_M,
    STEP_S,
    Driver,
    critical_score,
    fuzzy_target,
    proactive_score,
    regulation_time,
    rss_distance_across,
    rss_distance_along,
)
from benchmark.interactions.relations import RelativeAgents


def find_unsafe_agents(driver: Driver, around: RelativeAgents, speed: Floats) -> Bools:
    """(R, N) which of N agents a driver of R egos finds unsafe; whether it sees them is another question.

    The driver is the careful human, that of the regulation, or RSS; FSM's question is `compute_fuzzy_targets`. Speeds
    are (R, 1) m/s.
    """
    closing = speed - around.along
    if driver is Driver.CC:
        near = (around.gap <= 0) | ((closing > 0) & (around.gap <= CAREFUL_TIME_S * closing))
        verdict = (around.side <= 0) & near
    elif driver is Driver.R157:
        near = (around.gap <= 0) | ((closing > 0) & (around.gap <= regulation_time(closing) * closing))
        verdict = (around.side <= REGULATION_SIDE_M) & near
    else:
        along = rss_distance_along(speed, np.maximum(around.along, 0.0))
        verdict = (around.gap < along) & (around.side < rss_distance_across(np.abs(around.across)))
    return np.asarray(verdict & around.ahead)


def compute_fuzzy_targets(around: RelativeAgents, speed: Floats, acceleration: Floats, length: float) -> Floats:
    """(R, N) braking that FSM asks for because of each agent, m/s^2; 0 where it is at ease or does not look.

    Speed, m/s, and acceleration over the step before, m/s^2, are (R, 1) of the egos, whose length is in metres.
    """
    closing = speed - around.along
    with np.errstate(divide="ignore", invalid="ignore"):
        passing = (around.gap + length + around.extent) / closing + STEP_S
        arrives = around.side / around.towards <= passing
    looks = (around.side <= 0) | ((around.towards > 0) & (closing > 0) & arrives)
    critical = critical_score(around.gap, speed, around.along, acceleration)
    proactive = proactive_score(around.gap, speed, np.maximum(around.along, 0.0))
    return np.where(looks & around.ahead, fuzzy_target(critical, proactive), 0.0)
