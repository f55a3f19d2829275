"""What records say of the scenes of a split: who survives them, how near the recorded ego comes, what is wrong."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.metrics.rates import Rate, ratios_over_scenes
from benchmark.metrics.scores import source_of_scenes
from benchmark.metrics.severities import Spread, spread_of
from benchmark.records.judgement import DEFINITION, DRIVER_NAMES, DriverName, JudgementSummary
from benchmark.records.run import RunRecord


@dataclass(frozen=True, slots=True)
class SplitLadder:
    """Judgement ladder over the scenes of a split that were judged.

    Attributes:
        record: Which record says it; all of the split say the same.
        survives: Share of them that each reference driver survives.
        unsolvable: How many no driver could have avoided.
        margin: Seconds between when a driver could have reacted and the last chance, where there is one.
        too_late: How many have a negative margin.
        gap: The recorded ego's smallest distance to an adversary, metres.
        ttc: Its least time to contact, seconds.
        btn: Its largest braking threat number.
        without_map: How many were judged without a map: manoeuvres might have left the road.
        annotated: How many were judged by what lies between keyframes, because no generated track was at hand.
        outdated: How many were judged by an earlier `DEFINITION`.
        without_fault: Share of them whose adversaries have no fault that was found.
    """

    record: RunRecord
    scenes: int
    survives: dict[DriverName, Rate]
    unsolvable: int
    margin: Spread
    too_late: int
    gap: Spread
    ttc: Spread
    btn: Spread
    without_map: int
    annotated: int
    outdated: int
    without_fault: Rate


def judged_scenes(record: RunRecord) -> dict[str, JudgementSummary]:
    """What a record says of its scenes, by scene; only of those that were judged."""
    found = {scene: record.run.scene_facts.get(scene) for scene in record.run.scenes}
    return {
        scene: facts.judgement for scene, facts in found.items() if facts is not None and facts.judgement is not None
    }


def split_ladders(records: Sequence[RunRecord]) -> dict[str, SplitLadder]:
    """The ladder of every split that was judged, from records of one data set, at most one a planner and split.

    By split: from the record with most scenes that were judged, the first of equals.
    """
    best: dict[str, RunRecord] = {}
    for record in records:
        judged, before = judged_scenes(record), best.get(record.run.split)
        if judged and (before is None or len(judged) > len(judged_scenes(before))):
            best[record.run.split] = record
    return {split: _ladder(record) for split, record in best.items()}


def _ladder(record: RunRecord) -> SplitLadder:
    judged = judged_scenes(record)
    said = list(judged.values())
    survived = np.array([[each.survives.get(name, np.nan) for name in DRIVER_NAMES] for each in said], np.float64)
    # Without a known adversary nobody can be asked for faults, nor whether the scene is solvable.
    asked = [each.least_gap_m is not None or bool(each.faults) for each in said]
    values = np.column_stack([np.nan_to_num(survived), [not each.faults for each in said]]).astype(np.float64)
    weights = np.column_stack([~np.isnan(survived), asked]).astype(np.float64)
    sources = source_of_scenes(record)
    rates = ratios_over_scenes(values * weights, weights, [sources[name] for name in judged], seed=record.run.seed)
    margins = [each.margin_s for each in said if each.margin_s is not None]
    return SplitLadder(
        record=record,
        scenes=len(said),
        survives=dict(zip(DRIVER_NAMES, rates[:-1], strict=True)),
        unsolvable=sum(each.unsolvable is True for each in said),
        margin=spread_of(margins, less_is_worse=True),
        too_late=sum(margin < 0 for margin in margins),
        gap=_least([each.least_gap_m for each in said]),
        ttc=_least([each.least_ttc_s for each in said]),
        btn=spread_of([each.max_btn for each in said if each.max_btn is not None]),
        without_map=sum(not each.has_map for each in said),
        annotated=sum(each.tracks == "annotated" for each in said),
        outdated=sum(each.definition != DEFINITION for each in said),
        without_fault=rates[-1],
    )


def _least(values: Sequence[float | None]) -> Spread:
    return spread_of([value for value in values if value is not None], less_is_worse=True)
