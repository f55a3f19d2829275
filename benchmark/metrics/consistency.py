"""Plan consistency: how far two consecutive plans of a planner are apart about the same place and time.

The plan at a sample and the one at the next sample, half a second later, speak of the same instants: waypoint j + 1 of
the first is waypoint j of the second. Both are brought into one frame by the *recorded* motion between the two samples,
so that what the car itself drove is taken out, and the distance between the two waypoints is what the planner changed
its mind by. A planner that follows one fixed path at fixed times changes its mind by nothing.

The distance does not say who was right: a planner that learns something new has reason to change its plan, and one that
never looks is perfectly consistent. It is to be read beside the collision rate.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.steps import is_step
from benchmark.geometry import Floats, to_global
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord
from benchmark.waypoints import waypoints_in_lidar

COMMON_STEPS: Final = PLAN_STEPS - 1
"""Instants that two consecutive plans of 3 s share."""
INSTANTS: Final = tuple(f"{PLAN_STEP_S * (step + 1):g} s" for step in range(COMMON_STEPS))
"""Times of these after the second of the two samples."""
MEAN: Final = "mean"


@dataclass(frozen=True, slots=True)
class Consistency:
    """Distances between consecutive plans of a record.

    ``distances`` are metres by instant (`INSTANTS`) and their ``mean``, with 95 % intervals over recorded scenes;
    ``without`` are pairs left out because a plan, or the motion between them, is missing.
    """

    distances: dict[str, Rate]
    pairs: int
    without: int


def measure_consistency(record: RunRecord) -> Consistency:
    """Compare each plan of a record with the next one, by plans and recorded motion alone, so in old records too."""
    sources, columns = map_scenes_to_sources(record), record.columns
    scenes, place_of = columns.values("scene"), {row: place for place, row in enumerate(columns.planned.tolist())}
    pairs = [
        (at, at + 1)
        for at, (first, second) in enumerate(
            pairwise(zip(scenes, columns.values("index"), columns.values("timestamp_us")))
        )
        if first[0] == second[0] and second[1] == first[1] + 1 and is_step(second[2] - first[2])
    ]
    still = np.isnan(columns.moved[:, 0]).tolist()
    compared_pairs = [
        (place_of[first], place_of[second], sources[scenes[first]])
        for first, second in pairs
        if first in place_of and second in place_of and not still[place_of[first]]
    ]
    first, second = [one for one, _, _ in compared_pairs], [other for _, other, _ in compared_pairs]
    values = measure_plan_distances(columns.in_lidar[first], columns.moved[first], columns.in_lidar[second])
    with_mean = np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)
    rates = compute_ratios_over_scenes(
        with_mean, np.ones_like(with_mean), [scene for *_, scene in compared_pairs], seed=record.run.seed
    )
    return Consistency(
        dict(zip((*INSTANTS, MEAN), rates, strict=True)), len(compared_pairs), len(pairs) - len(compared_pairs)
    )


def measure_plan_distances(first: Floats, moved: Floats, second: Floats) -> Floats:
    """(P, 5) metres between the plans of P pairs of samples, at 0.5 to 2.5 s after the second sample.

    ``first`` and ``second`` are (P, 6, 2) waypoints of the lidar origin, each in the lidar frame of its sample, and
    ``moved`` is the (P, 3) pose of the second sample's lidar in that of the first.
    """
    # Straight ahead is pi/2 in the lidar frame: a pose there looks along its y axis.
    pose = np.stack([moved[:, 0], moved[:, 1], moved[:, 2] - np.pi / 2], axis=-1)
    later = to_global(second[:, :COMMON_STEPS], pose[:, None, :])
    offset = later - first[:, 1 : COMMON_STEPS + 1]
    return np.asarray(np.hypot(offset[..., 0], offset[..., 1]).reshape(-1, COMMON_STEPS))


def measure_plan_distance(first: SampleRow, second: SampleRow) -> Floats:
    """Distances between the plans at a sample and at the next one: (5,) metres at 0.5 to 2.5 s after the second."""
    moved = first.recorded_future[0]
    assert moved is not None
    x, y, yaw = moved
    # Straight ahead is pi/2 in the lidar frame: a pose there looks along its y axis.
    later = to_global(_waypoints(second)[:COMMON_STEPS], np.array([x, y, yaw - np.pi / 2]))
    offset = later - _waypoints(first)[1 : COMMON_STEPS + 1]
    return np.hypot(offset[:, 0], offset[:, 1])


def _waypoints(row: SampleRow) -> Floats:
    """(6, 2) of the lidar origin, x right, y forward."""
    assert row.plan is not None
    waypoints = np.array(row.plan.waypoints, np.float64)[:PLAN_STEPS]
    return waypoints_in_lidar(waypoints, row.plan.frame, row.lidar_ahead_m)
