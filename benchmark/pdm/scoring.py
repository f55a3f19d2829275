"""The main path: plans of some samples in, sub-scores out, all plans at once; DDC, EP and LK along the route.

Each plan is judged beside the recorded future, which is brought to motion in the same way: it is the measure of EP
(progress), and what its driver fails is forgiven in the filtered scores. DDC is wrong way, LK lane keeping.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.pdm.collision_scores import (
    NoCollisionScores,
    TimeToCollisionScores,
    score_no_collision,
    score_time_to_collision,
)
from benchmark.pdm.plan_motion import check_comfort, compute_comfort_series, compute_extremes
from benchmark.pdm.road_polygons import RoadPolygons, RoadPositions, compute_footprints, locate_on_road
from benchmark.pdm.totals import SubScores
from benchmark.pdm.traffic import SampleTraffic, find_touching_at_start, remove_objects

WRONG_WAY_STATES: Final = 11
"""Displacements that are added up: 1.1 s, as the official code slices them."""
WRONG_WAY_M: Final = (2.0, 6.0)
"""From here on DDC is 1/2, from there on 0."""
OFF_LANE_M: Final = 0.5
OFF_LANE_STATES: Final = 20
SHORTEST_PROGRESS_M: Final = 5.0


@dataclass(frozen=True, slots=True)
class RouteMeasures:
    """B motions along a route: (B,) progress from the first to the last state, not negative.

    ``wrong_way_m`` is (B,), the longest distance against or off the route within 1.1 s; ``beside`` (B, 31) a centre
    more than 0.5 m from the route.
    """

    wrong_way_m: Floats
    progress_m: Floats
    beside: Bools


def measure_along_route(states: Floats, route: Floats, oncoming: Bools, in_intersection: Bools) -> RouteMeasures:
    """Measure (B, 31, 11) motions along a (M, 2) route.

    (B, 31) ``oncoming`` and ``in_intersection`` are of the car's centre, on no lane of the route or in an intersection.
    """
    center = compute_footprints(states)[..., :2]
    moved = np.zeros(states.shape[:2])
    moved[:, 1:] = np.hypot(*np.moveaxis(np.diff(center, axis=1), -1, 0))
    moved[~oncoming | in_intersection] = 0.0
    padded = np.concatenate([np.zeros((len(states), WRONG_WAY_STATES - 1)), moved], axis=1)
    within = np.lib.stride_tricks.sliding_window_view(padded, WRONG_WAY_STATES, axis=1).sum(axis=-1)
    line = shapely.linestrings(route)
    points = shapely.points(center)
    # The route of a standing car has no length: every position is its start.
    with np.errstate(invalid="ignore"):
        ends = shapely.line_locate_point(line, points[:, [0, -1]])
    return RouteMeasures(
        wrong_way_m=within.max(axis=1),
        progress_m=np.maximum(ends[:, 1] - ends[:, 0], 0.0),
        beside=_find_off_lane(route, points),
    )


def measure_offsets(states: Floats, route: Floats) -> Floats:
    """(B, 31) distance of the car's centre from the route, metres; arguments are those of `measure_along_route`."""
    points = shapely.points(compute_footprints(states)[..., :2])
    return np.asarray(shapely.distance(shapely.linestrings(route), points), np.float64)


def _find_off_lane(route: Floats, points: NDArray[Any]) -> Bools:
    """Whether points are off the lane: `measure_offsets` from it to the near pieces of the route."""
    pieces = shapely.STRtree(shapely.linestrings(np.stack([route[:-1], route[1:]], axis=1)))
    off_lane = np.ones(points.shape, np.bool_)
    off_lane.reshape(-1)[pieces.query(points.reshape(-1), predicate="dwithin", distance=OFF_LANE_M)[0]] = False
    return off_lane


def score_direction_compliance(wrong_way_m: Floats) -> Floats:
    """DDC: 0, 1/2 or 1."""
    return np.select([wrong_way_m < WRONG_WAY_M[0], wrong_way_m < WRONG_WAY_M[1]], [1.0, 0.5], 0.0)


def score_lane_keeping(off_lane: Bools, in_intersection: Bools) -> Floats:
    """LK, (B,) 0 or 1: not more than 19 states in a row beside the route.

    ``off_lane``, (B, 31), is a centre more than 0.5 m from the route. States in an intersection are skipped, not
    forgiven.
    """
    beside = np.zeros(len(off_lane), np.int64)
    longest = beside.copy()
    for state in range(off_lane.shape[1]):
        counted = np.where(off_lane[:, state], beside + 1, 0)
        beside = np.where(in_intersection[:, state], beside, counted)
        longest = np.maximum(longest, beside)
    return (longest < OFF_LANE_STATES).astype(np.float64)


def score_ego_progress(
    progress_m: Floats, reference_m: Floats, multiplier: Floats, reference_multiplier: Floats
) -> Floats:
    """EP, 0 to 1: progress beside that of a reference; what fails a multiplier cannot be the measure of others.

    Multipliers are NC DAC DDC. EP is 1 where the better of the two goes no farther than 5 m.
    """
    best = np.maximum(progress_m * multiplier, reference_m * reference_multiplier)
    far = best > SHORTEST_PROGRESS_M
    return np.where(far, np.clip(progress_m / np.where(far, best, 1.0), 0.0, 1.0), 1.0)


@dataclass(frozen=True, slots=True)
class ScoringContext:
    """Everything that S samples of one place are judged by, beside the plans: states now, (S, 11), and a (M, 2) route.

    ``history`` are (S, 14, 11) states before (`build_history_rows`); ``has_history`` is (S,), False where the recording
    had not begun; HC is 1 there, as officially. ``traffic`` is without objects that touch the car now.
    """

    now: Floats
    history: Floats
    has_history: Bools
    traffic: SampleTraffic
    road: RoadPolygons
    route: Floats


@dataclass(frozen=True, slots=True)
class ScoredMotions:
    """B motions, (B, 31, 11), and all that is said of them but what needs a second one.

    ``extremes`` are (B, 6, 2), lowest and highest value of each series of comfort. Sub-scores are as if each were
    alone: EP is 1.
    """

    states: Floats
    where: RoadPositions
    collisions: NoCollisionScores
    near_misses: TimeToCollisionScores
    course: RouteMeasures
    extremes: Floats
    scores: SubScores


def remove_touching_objects(traffic: SampleTraffic, now: Floats) -> SampleTraffic:
    """Objects without those whose rectangles touch the car's at the start, an (S, 11) state of each sample."""
    return remove_objects(traffic, find_touching_at_start(traffic, compute_footprints(now)))


def score_motions(states: Floats, samples: NDArray[np.int64], around: ScoringContext) -> ScoredMotions:
    """Judge (B, 31, 11) motions; ``samples`` are (B,), the sample of each."""
    where = locate_on_road(around.road, states)
    contacts = score_no_collision(states, samples, around.traffic, where)
    misses = score_time_to_collision(states, samples, around.traffic, where)
    along = measure_along_route(states, around.route, where.oncoming, where.center_in_intersection)
    extremes = compute_extremes(compute_comfort_series(states, around.history[samples]))
    comfortable = check_comfort(extremes).all(axis=-1) | ~around.has_history[samples]
    scores = SubScores(
        nc=contacts.score,
        dac=(~where.non_drivable.any(axis=1)).astype(np.float64),
        ddc=score_direction_compliance(along.wrong_way_m),
        ep=np.ones(len(states)),
        ttc=misses.score,
        lk=score_lane_keeping(along.beside, where.center_in_intersection),
        hc=comfortable.astype(np.float64),
    )
    return ScoredMotions(states, where, contacts, misses, along, extremes, scores)


def score_against_references(plans: ScoredMotions, reference_m: Floats, reference_multiplier: Floats) -> SubScores:
    """Sub-scores of plans with EP measured by references: the progress of each and its NC DAC DDC, both (B,)."""
    own, multiplier = plans.course.progress_m, plans.scores.multiplier
    return replace(plans.scores, ep=score_ego_progress(own, reference_m, multiplier, reference_multiplier))


def score_recorded_motions(references: ScoredMotions) -> SubScores:
    """Sub-scores that the filter goes by: the recorded future scored alone and without a history; EP and HC are 1."""
    ones = np.ones(len(references.states))
    return replace(references.scores, ep=ones, hc=ones)
