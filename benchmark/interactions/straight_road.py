"""The official models on a straight road, ``jrc@code``: two cars, steps of 0.1 s, with every quirk of the public code.

That is the Joint Research Centre's (ec-jrc/JRC-FSM). Its models look at the size of a speed difference and not at its
sign, so that a leader that drives away makes them brake; not so in `benchmark.interactions.safety_checks`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.interactions.reaction import (
    CAREFUL_TIME_S,
    REACTING,
    REGULATION_SIDE_M,
    STEP_S,
    Driver,
    ReactionState,
    critical_score,
    fuzzy_target,
    is_at_most,
    proactive_score,
    regulation_time,
    rss_distance_across,
    rss_distance_along,
)
from benchmark.interactions.tracks import Integers

LENGTH_M: Final = 4.3
WIDTH_M: Final = 1.9
_REACHING_CRUISE: Final = 0.1
"""How much a driver at ease changes its speed in a step at most, m/s."""
EGO_AHEAD, EGO_BEHIND = 1, 2
"""Kinds of crash; 0 is none."""


@dataclass(frozen=True, slots=True)
class OtherCar:
    """The other car of C cases over T steps, whose motion is given; every array (C, T).

    ``x`` is the centre along the road, ``y`` across, metres, the left positive; the ego's ``y`` is 0. Speeds are along
    the road and to its left.
    """

    x: Floats
    y: Floats
    speed: Floats
    side_speed: Floats


@dataclass(frozen=True, slots=True)
class StraightRuns:
    """Runs of R drivers in C cases of T steps.

    Attributes:
        speed: (C, R, T) m/s.
        position: (C, R, T) metres.
        unsafe: (C, R, T - 1) verdicts of each step.
        braking: (C, R, T - 1) the braking remembered after it, m/s^2.
        critical: (C, T - 1) FSM's critical score, 0 where it did not look.
        proactive: (C, T - 1) FSM's proactive score.
        crash_step: (C, R) first step in contact, -1 for none.
        crash_kind: (C, R) 0 none, 1 ego ahead, 2 ego behind.
        abandoned: (C,) first step at which the official tables give up a run of the careful human, -1 for never.
    """

    speed: Floats
    position: Floats
    unsafe: Bools
    braking: Floats
    critical: Floats
    proactive: Floats
    crash_step: Integers
    crash_kind: Integers
    abandoned: Integers


@dataclass(frozen=True, slots=True)
class StraightSituation:
    """Places of the cars at one step: all (R, C) or (C,), metres and m/s.

    Attributes:
        gap: Bumper to bumper, negative where they overlap lengthwise.
        ahead: From the ego's front to the other's rear, whichever is ahead.
        side: Free distance sideways, negative where they overlap.
        closing: Difference of speeds; ``speed`` and ``acceleration`` are the ego's, ``leader_speed`` the other's.
        towards: How fast the other comes from the left.
        behind: Whether the ego's centre is not past the other's.
    """

    gap: Floats
    ahead: Floats
    side: Floats
    closing: Floats
    speed: Floats
    leader_speed: Floats
    towards: Floats
    acceleration: Floats
    behind: Bools


def drive_straight(
    start: Floats,
    speed: Floats,
    cruise: Floats,
    other: OtherCar,
    drivers: tuple[Driver, ...] = REACTING,
    *,
    always_careful: bool = False,
) -> StraightRuns:
    """Drive all cases with all drivers from (C, R) centres and (C,) speeds of the ego at step 0.

    ``cruise`` is the speed that a driver at ease returns to. If ``always_careful``, the careful human holds every step
    to be unsafe that has the other ahead, as in the official tables of following.
    """
    cases, steps, count = *other.x.shape, len(drivers)
    speeds, positions = np.empty((count, cases, steps)), np.empty((count, cases, steps))
    unsafe, braking = np.zeros((count, cases, steps - 1), np.bool_), np.zeros((count, cases, steps - 1))
    scores = np.zeros((2, cases, steps - 1))
    speeds[..., 0], positions[..., 0] = speed, start.T
    memory, latched = ReactionState.fresh(drivers, cases), np.zeros((count, cases), np.bool_)
    for step in range(steps - 1):
        now = _build_situation(positions[..., step], speeds, step, other)
        verdict, scored = _find_unsafe(now, drivers, always_careful)
        unsafe[..., step], scores[..., step] = verdict, scored
        latched |= verdict
        u = speeds[..., step]
        eased = np.clip(cruise, u - _REACHING_CRUISE, u + _REACHING_CRUISE)
        reacted = memory.react(verdict, u, fuzzy_target(scored[0], scored[1])[None])
        speeds[..., step + 1] = np.where(verdict, reacted, np.where(latched, u, eased))
        positions[..., step + 1] = positions[..., step] + STEP_S * speeds[..., step + 1]
        braking[..., step] = memory.braking
    crash_step, crash_kind = _find_crashes(positions, other)
    return StraightRuns(
        speed=speeds.transpose(1, 0, 2),
        position=positions.transpose(1, 0, 2),
        unsafe=unsafe.transpose(1, 0, 2),
        braking=braking.transpose(1, 0, 2),
        critical=scores[0],
        proactive=scores[1],
        crash_step=crash_step.T,
        crash_kind=crash_kind.T,
        abandoned=_find_abandoned(positions, speeds, other, drivers),
    )


def _build_situation(position: Floats, speeds: Floats, step: int, other: OtherCar) -> StraightSituation:
    x, y, leader = other.x[:, step], other.y[:, step], other.speed[:, step]
    speed = speeds[..., step]
    before = speeds[..., max(step - 1, 0)]
    return StraightSituation(
        gap=np.abs(x - position) - LENGTH_M,
        ahead=x - position - LENGTH_M,
        side=np.broadcast_to(np.abs(y) - WIDTH_M, speed.shape),
        closing=speed - leader,
        speed=speed,
        leader_speed=np.broadcast_to(leader, speed.shape),
        towards=np.broadcast_to(-other.side_speed[:, step], speed.shape),
        acceleration=(speed - before) / STEP_S,
        behind=position <= x,
    )


def _find_unsafe(now: StraightSituation, drivers: tuple[Driver, ...], always_careful: bool) -> tuple[Bools, Floats]:
    """(R, C) verdicts, and (2, C) the two scores of FSM."""
    verdict, scored = np.zeros(now.speed.shape, np.bool_), np.zeros((2, now.speed.shape[1]))
    with np.errstate(divide="ignore", invalid="ignore"):
        for row, driver in enumerate(drivers):
            side, closing, gap = now.side[row], now.closing[row], now.gap[row]
            if driver is Driver.CC:
                near = is_at_most(np.abs(now.ahead[row]) / np.abs(closing), CAREFUL_TIME_S)
                verdict[row] = always_careful | ((side <= 0) & near)
            elif driver is Driver.R157:
                verdict[row] = (side <= REGULATION_SIDE_M) & is_at_most(np.abs(gap / closing), regulation_time(closing))
            elif driver is Driver.RSS:
                along = rss_distance_along(now.speed[row], now.leader_speed[row])
                verdict[row] = (gap < along) & (side < rss_distance_across(np.abs(now.towards[row])))
            else:
                looked = now.behind[row] & _must_consider(now, row)
                arguments = (gap, now.speed[row], now.leader_speed[row])
                scored[0] = np.where(looked, critical_score(*arguments, now.acceleration[row]), 0.0)
                scored[1] = np.where(looked, proactive_score(*arguments), 0.0)
                verdict[row] = scored.sum(axis=0) > 0
    return verdict & now.behind, scored


def _must_consider(now: StraightSituation, row: int) -> Bools:
    """Whether the other is in the way, or will be before the ego is past it."""
    side, towards = now.side[row], now.towards[row]
    passing = (now.gap[row] + 2 * LENGTH_M) / now.closing[row] + STEP_S
    return np.asarray((side <= 0) | ((towards > 0) & is_at_most(side / towards, passing)))


def _find_crashes(positions: Floats, other: OtherCar) -> tuple[Integers, Integers]:
    gap, side = np.abs(other.x - positions) - LENGTH_M, np.abs(other.y) - WIDTH_M
    touching = (gap < 0) & (side < 0)
    step = np.where(touching.any(axis=-1), np.argmax(touching, axis=-1), -1)
    at = np.maximum(step, 0)[..., None]
    ahead = np.take_along_axis(positions, at, -1)[..., 0] > np.take_along_axis(other.x[None], at, -1)[..., 0]
    return step, np.where(step < 0, 0, np.where(ahead, EGO_AHEAD, EGO_BEHIND))


def _find_abandoned(positions: Floats, speeds: Floats, other: OtherCar, drivers: tuple[Driver, ...]) -> Integers:
    """The official tables take a run of the careful human for safe at its first overlap more than 2 s from contact."""
    if Driver.CC not in drivers:
        return np.full(len(other.x), -1)
    row = drivers.index(Driver.CC)
    with np.errstate(divide="ignore", invalid="ignore"):
        time = np.abs(other.x - positions[row] - LENGTH_M) / np.abs(speeds[row] - other.speed)
    given_up = (positions[row] <= other.x) & (np.abs(other.y) - WIDTH_M <= 0) & (time > CAREFUL_TIME_S)
    return np.where(given_up.any(axis=-1), np.argmax(given_up, axis=-1), -1)
