"""Contacts and near contacts: the sub-scores NC (no collision at fault) and TTC (time to collision).

Each object is judged on its own: what excuses one contact with it (NC) or makes one projection irrelevant (TTC) holds
for that object and that plan for good. So all touches are found first, and those after the first excuse are dropped.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.interactions.contacts import AHEAD_RAD, BEHIND_RAD, FRONT, LATERAL, STOPPED_TRACK, classify_contacts
from benchmark.pdm.definition import HEADING, LENGTH_M, SIDE_SPEED, SPEED, STATES, WIDTH_M
from benchmark.pdm.road_polygons import RoadPositions, compute_footprints
from benchmark.pdm.traffic import SampleTraffic

STANDING_M_S: Final = 0.005
"""Below this speed nothing is projected ahead."""
AHEAD_STATES: Final = (0, 3, 6, 9)
"""How far the car is projected, in states of 0.1 s."""
TTC_STATES: Final = STATES - AHEAD_STATES[-1]
"""States that are projected, the first ones."""

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class NoCollisionScores:
    """NC of B plans, 0, 1/2 or 1, and (B,) first state with a contact at fault, -1 for none.

    ``events`` are (E, 5): plan, state, object, kind of contact, whether at fault; by plan, state and object.
    """

    score: Floats
    step: Integers
    events: Integers


@dataclass(frozen=True, slots=True)
class TimeToCollisionScores:
    """TTC of B plans, 0 or 1, and (B,) first state that is followed by contact, -1 for none.

    ``events`` are (E, 7): plan, state, projection (0..3), object, ahead, behind (-1: not asked), whether it counts.
    """

    score: Floats
    step: Integers
    events: Integers


@dataclass(frozen=True, slots=True)
class _PlanObjectPairs:
    """Plans and objects of the same sample that may come near each other."""

    plan: Integers
    other: Integers


def score_no_collision(
    states: Floats, samples: Integers, traffic: SampleTraffic, where: RoadPositions
) -> NoCollisionScores:
    """Judge contacts of the car, in (B, 31, 11) motions of the samples named, with objects.

    ``traffic`` is without those that touch the car at the start.
    """
    boxes = compute_footprints(states)
    pairs = _find_pairs(boxes, samples, traffic)
    near = traffic.present[pairs.other] & _do_circles_meet(boxes[pairs.plan], traffic.box[pairs.other])
    pair, state = np.nonzero(near)
    hit = boxes_overlap(boxes[pairs.plan[pair], state], traffic.box[pairs.other[pair], state])
    pair, state = pair[hit], state[hit]
    plan, other = pairs.plan[pair], pairs.other[pair]
    mine, theirs = boxes[plan, state], traffic.box[other, state]
    unsure = (where.multiple_lanes | where.non_drivable)[plan, state]
    speed = np.hypot(states[plan, state, SPEED], states[plan, state, SIDE_SPEED])
    kind = classify_contacts(mine, speed, theirs, traffic.speed[other], traffic.is_agent[other])
    at_fault = (kind == STOPPED_TRACK) | (kind == FRONT) | ((kind == LATERAL) & unsure)
    up_to_first = _select_up_to_first(pair, state, ~at_fault, len(pairs.plan))
    plan, state, other, kind, at_fault = (
        plan[up_to_first],
        state[up_to_first],
        other[up_to_first],
        kind[up_to_first],
        at_fault[up_to_first],
    )
    score, step = np.ones(len(states)), np.full(len(states), STATES)
    np.minimum.at(score, plan[at_fault], np.where(traffic.is_agent[other[at_fault]], 0.0, 0.5))
    np.minimum.at(step, plan[at_fault], state[at_fault])
    order = np.lexsort((other, state, plan))
    events = np.column_stack([plan, state, other, kind, at_fault]).astype(np.int64)[order]
    return NoCollisionScores(score, np.where(step == STATES, -1, step), events)


def score_time_to_collision(
    states: Floats, samples: Integers, traffic: SampleTraffic, where: RoadPositions
) -> TimeToCollisionScores:
    """Judge where the car would be 0, 0.3, 0.6 and 0.9 s after each state if it went on straight at its speed.

    ``traffic`` is without those that touch the car at the start.
    """
    scored_states = states[:, :TTC_STATES]
    speed = np.hypot(scored_states[..., SPEED], scored_states[..., SIDE_SPEED])
    boxes = np.repeat(compute_footprints(scored_states)[:, :, None], len(AHEAD_STATES), axis=2)
    ahead_m = speed[..., None] * (np.array(AHEAD_STATES) * 0.1)
    boxes[..., 0] += ahead_m * np.cos(scored_states[..., None, HEADING])
    boxes[..., 1] += ahead_m * np.sin(scored_states[..., None, HEADING])
    boxes = boxes.reshape(len(states), TTC_STATES * len(AHEAD_STATES), 5)
    # An instant is a state and a projection of it, in the order in which the official loops visit them.
    state_of, ahead_of = np.divmod(np.arange(boxes.shape[1]), len(AHEAD_STATES))
    seen_at = state_of + np.array(AHEAD_STATES)[ahead_of]
    pairs = _find_pairs(boxes, samples, traffic)
    near = traffic.present[pairs.other][:, seen_at] & (speed >= STANDING_M_S)[pairs.plan][:, state_of]
    near &= _do_circles_meet(boxes[pairs.plan], traffic.box[pairs.other][:, seen_at])
    pair, instant = np.nonzero(near)
    theirs = traffic.box[pairs.other[pair], seen_at[instant]]
    hit = boxes_overlap(boxes[pairs.plan[pair], instant], theirs)
    pair, instant, theirs = pair[hit], instant[hit], theirs[hit]
    plan, other, state = pairs.plan[pair], pairs.other[pair], state_of[instant]
    angle = _compute_angle(states[plan, state], theirs)
    unsure = (where.multiple_lanes | where.non_drivable | where.axle_in_intersection)[plan, state]
    ahead, behind = angle < AHEAD_RAD, angle > BEHIND_RAD
    counts = ahead | (unsure & ~behind)
    up_to_first = _select_up_to_first(pair, instant, ~counts, len(pairs.plan))
    behind_flag = np.where(~ahead & unsure, behind, -1)
    columns = (plan, state, ahead_of[instant], other, ahead, behind_flag, counts)
    events = np.column_stack(columns).astype(np.int64)[up_to_first]
    step = np.full(len(states), STATES)
    counted = events[events[:, 6] == 1]
    np.minimum.at(step, counted[:, 0], counted[:, 1])
    order = np.lexsort((events[:, 3], events[:, 2], events[:, 1], events[:, 0]))
    return TimeToCollisionScores((step == STATES).astype(np.float64), np.where(step == STATES, -1, step), events[order])


def _find_pairs(boxes: Floats, samples: Integers, traffic: SampleTraffic) -> _PlanObjectPairs:
    """Pairs of one sample whose boxes at (B, T) instants and (N, 31) states keep to ground that they share."""
    count = np.diff(traffic.offsets)[samples]
    plan = np.repeat(np.arange(len(samples)), count)
    within = np.arange(len(plan)) - np.repeat(np.cumsum(count) - count, count)
    other = traffic.offsets[samples][plan] + within
    reach = 0.5 * (np.hypot(LENGTH_M, WIDTH_M) + np.hypot(*traffic.box[..., 2:4].max(axis=1).T)) + 1e-6
    low, high = boxes[..., :2].min(axis=1), boxes[..., :2].max(axis=1)
    there = traffic.present[..., None]
    their_low = np.where(there, traffic.box[..., :2], np.inf).min(axis=1) - reach[:, None]
    their_high = np.where(there, traffic.box[..., :2], -np.inf).max(axis=1) + reach[:, None]
    meet = ((low[plan] <= their_high[other]) & (their_low[other] <= high[plan])).all(axis=-1)
    return _PlanObjectPairs(plan[meet], other[meet])


def _do_circles_meet(first: Floats, second: Floats) -> Bools:
    """Whether the circles around boxes meet: what any contact needs."""
    offset = second[..., :2] - first[..., :2]
    reach = 0.5 * (np.hypot(LENGTH_M, WIDTH_M) + np.hypot(second[..., 2], second[..., 3])) + 1e-6
    return np.asarray(offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)


def _compute_angle(states: Floats, boxes: Floats) -> Floats:
    """Angle between the car's heading and the direction from its rear axle to the centre of a box; 0 to pi."""
    offset = boxes[..., :2] - states[..., :2]
    along = offset[..., 0] * np.cos(states[..., HEADING]) + offset[..., 1] * np.sin(states[..., HEADING])
    across = offset[..., 1] * np.cos(states[..., HEADING]) - offset[..., 0] * np.sin(states[..., HEADING])
    return np.asarray(np.arctan2(np.abs(across), along))


def _select_up_to_first(pair: Integers, instant: Integers, excused: Bools, pairs: int) -> Bools:
    """Touches up to the first excused one of each pair, that one included."""
    first = np.full(pairs, np.iinfo(np.int64).max)
    np.minimum.at(first, pair[excused], instant[excused])
    return np.asarray(instant <= first[pair])
