"""The main path: plans of some samples in, sub-scores out, all plans at once.

Each plan is judged beside the recorded future, which is brought to motion in the same way: it is the measure of EP, and
what its driver fails is forgiven in the filtered scores.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.pdm.comfort import comfort_checks, comfort_series, extremes_of
from benchmark.pdm.contacts import Collisions, NearMisses, collisions, near_misses
from benchmark.pdm.road import Road, Whereabouts, footprints, whereabouts
from benchmark.pdm.route import Course, course, direction_compliance, ego_progress, lane_keeping
from benchmark.pdm.totals import SubScores
from benchmark.pdm.traffic import Traffic, touching_at_start, without


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Everything that S samples of one place are judged by, beside the plans.

    Attributes:
        now: (S, 11) states of the car.
        history: (S, 14, 11) states before (`benchmark.pdm.comfort.history_rows`).
        has_history: (S,) False where the recording had not begun; HC is 1 there, as officially.
        traffic: Objects, without those that touch the car now.
        route: (M, 2) polyline.
    """

    now: Floats
    history: Floats
    has_history: Bools
    traffic: Traffic
    road: Road
    route: Floats


@dataclass(frozen=True, slots=True)
class Judged:
    """B motions, (B, 31, 11), and all that is said of them but what needs a second one.

    ``extremes`` are (B, 6, 2), lowest and highest value of each series of comfort. Sub-scores are as if each were
    alone: EP is 1.
    """

    states: Floats
    where: Whereabouts
    collisions: Collisions
    near_misses: NearMisses
    course: Course
    extremes: Floats
    scores: SubScores


def log_replay(traffic: Traffic, now: Floats) -> Traffic:
    """Objects without those whose rectangles touch the car's at the start, an (S, 11) state of each sample."""
    return without(traffic, touching_at_start(traffic, footprints(now)))


def judged(states: Floats, samples: NDArray[np.int64], around: Surroundings) -> Judged:
    """Judge (B, 31, 11) motions; ``samples`` are (B,), the sample of each."""
    where = whereabouts(around.road, states)
    contacts = collisions(states, samples, around.traffic, where)
    misses = near_misses(states, samples, around.traffic, where)
    along = course(states, around.route, where.oncoming, where.center_in_intersection)
    extremes = extremes_of(comfort_series(states, around.history[samples]))
    comfortable = comfort_checks(extremes).all(axis=-1) | ~around.has_history[samples]
    scores = SubScores(
        nc=contacts.score,
        dac=(~where.non_drivable.any(axis=1)).astype(np.float64),
        ddc=direction_compliance(along.wrong_way_m),
        ep=np.ones(len(states)),
        ttc=misses.score,
        lk=lane_keeping(along.beside, where.center_in_intersection),
        hc=comfortable.astype(np.float64),
    )
    return Judged(states, where, contacts, misses, along, extremes, scores)


def beside(plans: Judged, reference_m: Floats, reference_multiplier: Floats) -> SubScores:
    """Sub-scores of plans with EP measured by references: the progress of each and its NC DAC DDC, both (B,)."""
    own, multiplier = plans.course.progress_m, plans.scores.multiplier
    return replace(plans.scores, ep=ego_progress(own, reference_m, multiplier, reference_multiplier))


def human_scores(references: Judged) -> SubScores:
    """Sub-scores that the filter goes by: the recorded future scored alone and without a history; EP and HC are 1."""
    ones = np.ones(len(references.states))
    return replace(references.scores, ep=ones, hc=ones)
