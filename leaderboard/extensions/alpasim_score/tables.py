"""AlpaSim's scene score with its parts, under both rule sets, of drives in our engine: one table a measured world."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.records.drives import DriveRecord
from benchmark.records.run_schema import find_source
from benchmark.report.cells import PERCENT
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.drives import ComparableDrives, DriveTableRow, group_comparable_drives
from leaderboard.frame.rows import CAVEAT_MARK
from leaderboard.frame.specification import Value, Values, estimate_columns, number_columns, tabulate, text_columns

RULE_SETS: Final = ("alpasim@2026-07", "alpasim@2026-09")
"""Rules of NVlabs/alpasim 3032e0c, and of its challenge branch at 6f1029c."""
_CORRIDOR: Final = "left corridor %"
_MEANS: Final = {
    "score": "score",
    "progress %": "progress",
    "at fault %": "at_fault",
    "rear %": "rear",
    "off road %": "off_road",
    _CORRIDOR: "corridor",
}
"""Parts whose means over drives are shown, by head; only September's rules have the corridor."""
_KILOMETRES: Final = ("km per incident", "km per incident at fault")
_COLUMNS: Final = [
    *text_columns("planner", "sensor", "rules"),
    *estimate_columns("score", digits=2, ends=2, beside="95 %"),
    *number_columns(*list(_MEANS)[1:], digits=1),
    *number_columns(*_KILOMETRES, digits=3),
    *number_columns("drives"),
]
_NOTE: Final = (
    "AlpaSim's scene score of each drive, under the rules of July and of September 2026: share of the recorded way "
    "(80 % are all of it), 0 with a contact at fault (front or side), off the road or, in September, 4 m beside the "
    "recorded path. The first contact ends what counts; one from behind is no fault. Km per incident: kilometres of "
    "all drives over their incidents (any contact, off the road), a dash without one. Not comparable with numbers of "
    "AlpaSim's challenge: other scenes, pictures and controller (docs/extensions/alpasim_score.md)."
)


@dataclass(frozen=True, slots=True)
class AlpasimResults:
    """Results of a record under one rule set: means over drives and kilometres for each incident, by head.

    ``unmapped`` of the ``drives`` that have a score are without a map.
    """

    rates: Mapping[str, Rate]
    drives: int
    unmapped: int


def alpasim_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """A table for each group of comparable records in which any drive has a score: a row a planner and rule set."""
    tables = []
    for group in group_comparable_drives(records):
        found = [(row, rules, compute_alpasim_results(row.record, rules)) for row in group.rows for rules in RULE_SETS]
        results = [(row, rules, result) for row, rules, result in found if result is not None]
        if results:
            tables.append(_table(group, results))
    return tables


def compute_alpasim_results(record: DriveRecord, rules: str) -> AlpasimResults | None:
    """Results under a rule set; ``None`` where no drive has a score.

    Failed drives, and those of scenes that are not labelled throughout, are not counted. Intervals are over recordings.
    """
    rows = [row for row in record.rows if row.scores is not None and not row.unlabelled]
    scored = [(row.scene, row.scores.further[rules]) for row in rows if row.scores and rules in row.scores.further]
    if not scored:
        return None
    sources = [find_source(scene, record.facts.scene_facts) for scene, _ in scored]
    ratios = [_list_ratios(parts) for _, parts in scored]
    sums = np.array([list(of_drive.values()) for of_drive in ratios])
    found = compute_ratios_over_scenes(sums[..., 0], sums[..., 1], sources, seed=record.facts.seed)
    unmapped = sum(parts.get("off_road") is None for _, parts in scored)
    return AlpasimResults(dict(zip(ratios[0], found, strict=True)), len(scored), unmapped)


def _list_ratios(parts: Mapping[str, float | None]) -> dict[str, tuple[float, float]]:
    """What a drive adds to the numerator and the denominator of each number; nothing where it says nothing."""
    front, lateral, rear, off_road, km = (
        parts.get(name) or 0.0 for name in ("front", "lateral", "rear", "off_road", "km")
    )
    at_fault = max(front, lateral)
    values = {**parts, "at_fault": at_fault}
    means = {
        head: (value or 0.0, float(value is not None)) for head, part in _MEANS.items() for value in [values.get(part)]
    }
    incidents = (max(at_fault, rear, off_road), max(at_fault, off_road))
    return means | {head: (km, happened) for head, happened in zip(_KILOMETRES, incidents, strict=True)}


def _table(group: ComparableDrives, results: Sequence[tuple[DriveTableRow, str, AlpasimResults]]) -> Table:
    unmapped = {
        f"{CAVEAT_MARK} {row.name}: {found.unmapped} of {pluralise(found.drives, 'drive')} without a map: only "
        "collisions and the corridor count there, and off road is of the others."
        for row, _, found in results
        if found.unmapped
    }
    notes = (*sorted(unmapped), *group.notes)
    return tabulate(
        f"alpasim-{group.name}",
        f"{group.title}: AlpaSim's scene score",
        _COLUMNS,
        [_values(*result) for result in results],
        (_NOTE, *notes),
        brief_notes=notes,
    )


def _values(row: DriveTableRow, rules: str, found: AlpasimResults) -> Values:
    origin, planner = replace(row.origin, protocol=f"{rules}, {row.origin.protocol}"), row.planner
    if found.unmapped and CAVEAT_MARK not in planner.text:
        planner = replace(planner, text=f"{planner.text} {CAVEAT_MARK}")
    values: dict[str, Value] = {
        head: origin.percent(found.rates[head], "drives")
        if head.endswith(PERCENT)
        else origin.amount(found.rates[head], "")
        for head in _MEANS
        if head != _CORRIDOR or rules == max(RULE_SETS)
    }
    values |= {head: origin.amount(found.rates[head], "km", "incidents") for head in _KILOMETRES}
    drives = origin.count(found.drives, "drives", row.record.summary.drives)
    return {"planner": planner, "sensor": row.record.facts.measured.sensor, "rules": rules, **values, "drives": drives}
