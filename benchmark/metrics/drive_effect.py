"""The effect of the adversary in closed loop: drives of adversarial scenes beside the same windows of their recordings.

Each recording has the same weight, with any number of variants, as in the effect of open loop (docs/metrics.md): a pair
weighs 1 / (drives of its recording). Differences and intervals are those of `benchmark.metrics.rates`. Km per incident
is a ratio of sums, whose difference is taken as linear in what each recording adds to them.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from benchmark.geometry import Floats
from benchmark.metrics.rates import PairedDifference, compute_paired_difference, count_needed_recordings
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, compute_column_values
from benchmark.records.planner_versions import PLANS_SHA256, describe_version
from benchmark.records.run_schema import find_source

KM_PER_INCIDENT: Final = "km_per_incident"
MEASURES: Final = ("with_adversary", "at_fault", "route", "comfortable", KM_PER_INCIDENT, "nuplan_score")
"""Columns of drives that are paired; an incident is a contact at the ego's fault, or leaving the road."""


@dataclass(frozen=True, slots=True)
class MeasuredEffect:
    """One measure on both sides, over the pairs that have it on both.

    Attributes:
        measure: One of `MEASURES`.
        adversarial: Weighted mean over the adversarial drives; km per incident is infinite without an incident.
        unchanged: The same on the recordings.
        difference: Adversarial less unchanged, with its interval over recordings.
        pairs: How many pairs have it.
    """

    measure: str
    adversarial: float | None
    unchanged: float | None
    difference: PairedDifference
    pairs: int

    @property
    def needed(self) -> int | None:
        """How many recordings would tell the difference from none."""
        return count_needed_recordings(self.difference)


@dataclass(frozen=True, slots=True)
class DriveEffect:
    """A planner's drives through adversarial scenes and through the same windows of the recordings.

    Attributes:
        record: Adversarial drives.
        unchanged: Drives of the recordings.
        effects: One for each measure.
        unpaired: Adversarial drives without a partner, or of which either failed.
    """

    record: DriveRecord
    unchanged: DriveRecord
    effects: tuple[MeasuredEffect, ...]
    unpaired: int


class _Pair(NamedTuple):
    recording: str
    adversarial: Mapping[str, float | None]
    unchanged: Mapping[str, float | None]


def find_unchanged_drives(record: DriveRecord, candidates: Iterable[DriveRecord]) -> DriveRecord | None:
    """Drives of the same planner through the windows of an adversarial record on its recordings, most pairs first."""
    best: tuple[int, DriveRecord] | None = None
    for candidate in candidates:
        pairs = len(_find_partners(record, candidate)) if _is_unchanged_side(record, candidate) else 0
        if pairs and (best is None or pairs >= best[0]):
            best = pairs, candidate
    return None if best is None else best[1]


def compute_drive_effect(record: DriveRecord, unchanged: DriveRecord) -> DriveEffect:
    """Every measure of both, drive by drive; failed drives are in no pair."""
    facts = record.facts.scene_facts
    pairs = [
        _Pair(find_source(row.scene, facts), *map(_read_values, (row, partner)))
        for row, partner in _find_partners(record, unchanged)
        if row.status == partner.status == "ok"
    ]
    effects = tuple(
        _compare_distance(pairs) if name == KM_PER_INCIDENT else _compare_means(name, pairs) for name in MEASURES
    )
    return DriveEffect(record, unchanged, effects, len(record.rows) - len(pairs))


def collect_drive_effects(records: Sequence[DriveRecord]) -> list[DriveEffect]:
    """The effect of every adversarial record whose partner is among the records."""
    found = ((record, find_unchanged_drives(record, records)) for record in records)
    return [compute_drive_effect(record, unchanged) for record, unchanged in found if unchanged is not None]


def drive_effect_to_json(record: DriveRecord, records: Sequence[DriveRecord]) -> dict[str, Any]:
    """Paired differences of a record as JSON values under ``paired``; empty where there is no partner."""
    unchanged = find_unchanged_drives(record, records)
    if unchanged is None:
        return {}
    effect = compute_drive_effect(record, unchanged)
    measures = {
        each.measure: {
            "adversarial": None if each.adversarial == math.inf else each.adversarial,
            "unchanged": None if each.unchanged == math.inf else each.unchanged,
            **asdict(each.difference),
            "needed": each.needed,
            "pairs": each.pairs,
        }
        for each in effect.effects
    }
    return {"paired": {"split": unchanged.facts.split, "unpaired": effect.unpaired, "measures": measures}}


def _is_unchanged_side(record: DriveRecord, candidate: DriveRecord) -> bool:
    mine, theirs = record.facts, candidate.facts
    own, other = mine.measured, theirs.measured
    if own.windows_of or other.windows_of.get("split") != mine.split or mine.data.name != theirs.data.name:
        return False
    versions = [
        {**describe_version(facts.planner), PLANS_SHA256: None, "code": facts.planner.code_sha256}
        for facts in (mine, theirs)
    ]
    same_planner = (record.planner, versions[0]) == (candidate.planner, versions[1])
    return same_planner and other.model_copy(update={"windows_of": {}}) == own


def _find_partners(record: DriveRecord, unchanged: DriveRecord) -> list[tuple[EpisodeRow, EpisodeRow]]:
    """Adversarial rows with the rows of the same window; one whose window has changed since has none."""
    partners = {(row.window.of, row.run): row for row in unchanged.rows if row.window is not None}
    pairs = ((row, partners.get((row.scene, row.run))) for row in record.rows)
    return [(row, partner) for row, partner in pairs if partner is not None and _is_same_window(row, partner)]


def _is_same_window(row: EpisodeRow, partner: EpisodeRow) -> bool:
    first, second = row.window, partner.window
    return first is None or (second is not None and (first.start, first.end) == (second.start, second.end))


def _read_values(row: EpisodeRow) -> dict[str, float | None]:
    values = compute_column_values(row)
    fault, off_road, metres = values["at_fault"], values.get("off_road"), values["progress_m"]
    incident = None if fault is None else float(bool(fault) or bool(off_road))
    return {**values, "incident": incident, "km": None if metres is None else metres / 1000.0}


def _compare_means(name: str, pairs: Sequence[_Pair]) -> MeasuredEffect:
    both, own, names = _collect(pairs, (name,))
    weights = 1.0 / np.bincount(own)[own] if len(own) else np.zeros(0)
    adversarial, unchanged = (float((side[:, 0] * weights).sum()) / len(names) if names else None for side in both)
    sums = np.bincount(own, weights=(both[0] - both[1])[:, 0] * weights, minlength=len(names))
    difference = compute_paired_difference(np.asarray(sums, np.float64), np.ones(len(names)))
    return MeasuredEffect(name, adversarial, unchanged, difference, len(own))


def _compare_distance(pairs: Sequence[_Pair]) -> MeasuredEffect:
    """Km per incident: r = K / I on either side; recording i of N moves r by N (k_i - r n_i) / I."""
    both, own, names = _collect(pairs, ("km", "incident"))
    count = len(names)
    weights = 1.0 / np.bincount(own)[own] if len(own) else np.zeros(0)
    ratios: list[float | None] = []
    moves, incidents = np.zeros(count), np.zeros(count)
    for side, sign in zip(both, (1.0, -1.0), strict=True):
        km, hits = (np.bincount(own, weights=side[:, at] * weights, minlength=count) for at in (0, 1))
        total = float(hits.sum())
        ratio = float(km.sum()) / total if total else math.inf
        ratios.append(ratio if count else None)
        incidents += hits
        if total:
            moves += sign * count * (km - ratio * hits) / total
    adversarial, unchanged = ratios
    if adversarial is None or unchanged is None or math.inf in ratios:
        difference = PairedDifference(None, None, None, count, int(np.count_nonzero(incidents)), None)
    else:
        by_recording = adversarial - unchanged + moves
        difference = compute_paired_difference(by_recording, np.ones(count), differs=incidents > 0.0, most=math.inf)
    return MeasuredEffect(KM_PER_INCIDENT, adversarial, unchanged, difference, len(own))


def _collect(pairs: Sequence[_Pair], columns: Sequence[str]) -> tuple[tuple[Floats, Floats], Any, list[str]]:
    """(P, C) values of the pairs that have all columns on both sides, (P,) places of their recordings, and these."""
    known = [
        pair
        for pair in pairs
        if all(side.get(column) is not None for side in (pair.adversarial, pair.unchanged) for column in columns)
    ]
    names = sorted({pair.recording for pair in known})
    place = {name: number for number, name in enumerate(names)}
    own = np.array([place[pair.recording] for pair in known], np.int64)
    sides = (
        np.array([[getattr(pair, side)[column] for column in columns] for pair in known], np.float64)
        for side in ("adversarial", "unchanged")
    )
    first, second = (values.reshape(len(known), len(columns)) for values in sides)
    return (first, second), own, names
