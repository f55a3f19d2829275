"""Scene assessments of a split in records, and the severity of a planner's plans, with a contact and without."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.metrics.attacks import select_counted_rows
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.fault import FaultVerdict
from benchmark.records.row_schema import PlanCollision, PlanNearRow
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import DEFINITION, DRIVER_NAMES, AssessmentSummary, DriverName, KindName

CRITICAL_BTN: Final = 1.0
"""From here on braking alone is not enough."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and worst tenth of a quantity over the samples of which it is known; both are values that samples have.

    One in ten reaches the worst tenth, or worse; worse is more, or less where the quantity is a distance or a time that
    is left.
    """

    samples: int
    median: float | None
    worst_tenth: float | None


@dataclass(frozen=True, slots=True)
class ContactSeverities:
    """Samples whose first contact is with an adversary, or of those with a bystander; speeds in m/s.

    ``faults`` are by whose fault they are (``fault@1``), ``None`` where that is not said, as in older records;
    ``mean_fatal`` and ``most_fatal`` are of the probability that an occupant of the ego dies.
    """

    samples: int
    faults: dict[FaultVerdict | None, int]
    kinds: dict[KindName, int]
    impact_speed: Spread
    delta_v_ego: Spread
    delta_v_other: Spread
    mean_fatal: float | None
    most_fatal: float | None


@dataclass(frozen=True, slots=True)
class NearPassSeverities:
    """Samples without a contact at which an adversary is there.

    Smallest distance, metres; least time to contact of those that head for one another, time exposed and
    post-encroachment time of those whose ways meet, seconds; time integrated, s^2; largest braking threat number. At
    ``critical`` ones braking alone is not enough.
    """

    samples: int
    gap: Spread
    ttc: Spread
    tet: Spread
    tit: Spread
    pet: Spread
    btn: Spread
    critical: int


def summarise_contacts(record: RunRecord, *, bystanders: bool = False) -> ContactSeverities:
    """The first contacts of a record's plans with an adversary, or those with a bystander instead."""
    rows = [row.severity.contact for row in select_counted_rows(record) if row.severity is not None]
    contacts = [contact for contact in rows if contact is not None and contact.adversary is not bystanders]
    fatal = [contact.fatal_probability for contact in contacts]

    def spread(value: Callable[[PlanCollision], float]) -> Spread:
        return compute_spread([value(contact) for contact in contacts])

    return ContactSeverities(
        samples=len(contacts),
        faults=dict(Counter(None if contact.fault is None else contact.fault.verdict for contact in contacts)),
        kinds=dict(Counter(contact.kind for contact in contacts)),
        impact_speed=spread(lambda contact: contact.impact_speed_m_s),
        delta_v_ego=spread(lambda contact: contact.delta_v_ego_m_s),
        delta_v_other=spread(lambda contact: contact.delta_v_other_m_s),
        mean_fatal=float(np.mean(fatal)) if fatal else None,
        most_fatal=max(fatal, default=None),
    )


def summarise_near_passes(record: RunRecord) -> NearPassSeverities:
    """How near a record's plans without contact come to the adversaries."""
    rows = [row.severity.near for row in select_counted_rows(record) if row.severity is not None]
    passes = [near for near in rows if near is not None]

    def spread(value: Callable[[PlanNearRow], float | None], *, less_is_worse: bool = False) -> Spread:
        known = [one for one in map(value, passes) if one is not None]
        return compute_spread(known, less_is_worse=less_is_worse)

    return NearPassSeverities(
        samples=len(passes),
        gap=spread(lambda near: near.least_gap_m, less_is_worse=True),
        ttc=spread(lambda near: near.least_ttc_s, less_is_worse=True),
        tet=spread(lambda near: near.tet_s),
        tit=spread(lambda near: near.tit_s2),
        pet=spread(lambda near: near.pet_s, less_is_worse=True),
        btn=spread(lambda near: near.max_btn),
        critical=sum(near.max_btn >= CRITICAL_BTN for near in passes),
    )


def compute_spread(values: Sequence[float], *, less_is_worse: bool = False) -> Spread:
    """Median and worst tenth: values among those given, the worse of two where a middle lies between them."""
    if not values:
        return Spread(0, None, None)
    order = sorted(values) if less_is_worse else sorted(values, reverse=True)
    return Spread(len(order), order[(len(order) - 1) // 2], order[(len(order) - 1) // 10])


@dataclass(frozen=True, slots=True)
class SplitReferenceDrivers:
    """Judgement ladder over the scenes of a split that were judged; all records of the split say the same.

    Attributes:
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


def read_scene_assessments(record: RunRecord) -> dict[str, AssessmentSummary]:
    """Assessments of a record's scenes, by scene; only of those that were assessed."""
    facts_of_scene = {scene: record.run.scene_facts.get(scene) for scene in record.run.scenes}
    return {
        scene: facts.judgement
        for scene, facts in facts_of_scene.items()
        if facts is not None and facts.judgement is not None
    }


def collect_split_reference_drivers(records: Sequence[RunRecord]) -> dict[str, SplitReferenceDrivers]:
    """The ladder by split, from records of one data set, at most one a planner and split.

    From the record with most scenes that were judged, the first of equals.
    """
    best: dict[str, RunRecord] = {}
    for record in records:
        judged, before = read_scene_assessments(record), best.get(record.run.split)
        if judged and (before is None or len(judged) > len(read_scene_assessments(before))):
            best[record.run.split] = record
    return {split: _summarise_split(record) for split, record in best.items()}


def _summarise_split(record: RunRecord) -> SplitReferenceDrivers:
    judged = read_scene_assessments(record)
    summaries = list(judged.values())
    survived = np.array(
        [[summary.survives.get(name, np.nan) for name in DRIVER_NAMES] for summary in summaries], np.float64
    )
    # Without a known adversary, track defects and solvability are undefined.
    answerable = [summary.least_gap_m is not None or bool(summary.faults) for summary in summaries]
    values = np.column_stack([np.nan_to_num(survived), [not summary.faults for summary in summaries]]).astype(
        np.float64
    )
    weights = np.column_stack([~np.isnan(survived), answerable]).astype(np.float64)
    sources = map_scenes_to_sources(record)
    rates = compute_ratios_over_scenes(
        values * weights, weights, [sources[name] for name in judged], seed=record.run.seed
    )
    margins = [summary.margin_s for summary in summaries if summary.margin_s is not None]
    return SplitReferenceDrivers(
        record=record,
        scenes=len(summaries),
        survives=dict(zip(DRIVER_NAMES, rates[:-1], strict=True)),
        unsolvable=sum(summary.unsolvable is True for summary in summaries),
        margin=compute_spread(margins, less_is_worse=True),
        too_late=sum(margin < 0 for margin in margins),
        gap=_least([summary.least_gap_m for summary in summaries]),
        ttc=_least([summary.least_ttc_s for summary in summaries]),
        btn=compute_spread([summary.max_btn for summary in summaries if summary.max_btn is not None]),
        without_map=sum(not summary.has_map for summary in summaries),
        annotated=sum(summary.tracks == "annotated" for summary in summaries),
        outdated=sum(summary.definition != DEFINITION for summary in summaries),
        without_fault=rates[-1],
    )


def _least(values: Sequence[float | None]) -> Spread:
    return compute_spread([value for value in values if value is not None], less_is_worse=True)
