"""Closed loop: adversarial drives beside the same windows of the unchanged recordings, measure by measure."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.drive_effect import KM_PER_INCIDENT, DriveEffect, MeasuredEffect, collect_drive_effects
from benchmark.report.cells import PERCENT, TableCell, ValueSource, format_record_name
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.drives import ComparableDrives
from leaderboard.frame.specification import Values, number_columns, tabulate, text_columns

_COLUMNS: Final = [
    *text_columns("planner", "sensor", "measure"),
    *number_columns("adversarial", "unchanged", "difference", "95 % of difference", "recordings needed"),
    *number_columns("recordings", "differing", "pairs"),
]
_BRIEF: Final = ("planner", "measure", *(column.key for column in _COLUMNS[3:8]))
_MEASURES: Final = {
    "with_adversary": ("adversary %", PERCENT, 1),
    "at_fault": ("at fault %", PERCENT, 1),
    "route": ("route %", PERCENT, 1),
    "comfortable": ("comfort %", PERCENT, 1),
    KM_PER_INCIDENT: ("km per incident", "km", 3),
    "nuplan_score": ("nuPlan terms", "", 2),
}
"""Name in the table, unit and decimals of a measure."""
_SHORT_NOTE: Final = (
    "Unchanged: the same windows of the recordings, where whoever became the adversary keeps its recorded track. "
    "Recordings needed: for an interval without 0, or for one at all where too few differ, if all else stays as it is."
)
_NOTE: Final = (
    "Adversary: drives with a contact with the adversary, on the recordings with the same vehicle. Difference: "
    "adversarial less unchanged, paired drive by drive, with its 95 % interval over recordings, each of which has the "
    "same weight with any number of variants (docs/metrics.md). Km per incident: a contact at fault or leaving the "
    "road is an incident; without one the number is infinite and there is no difference."
)


def paired_drive_tables(groups: Sequence[ComparableDrives]) -> list[Table]:
    """A table for each group of adversarial drives that has a partner among the records of all groups."""
    records = [record for group in groups for record in group.records]
    effects = {effect.record.directory: effect for effect in collect_drive_effects(records)}
    return [
        table
        for group in groups
        if (table := _paired_table(group, [effects.get(record.directory) for record in group.records])) is not None
    ]


def _paired_table(group: ComparableDrives, effects: Sequence[DriveEffect | None]) -> Table | None:
    named = [(row, effect) for row, effect in zip(group.rows, effects, strict=True) if effect is not None]
    if not named:
        return None
    rows: list[Values] = []
    notes: list[str] = []
    for row, effect in named:
        records = (effect.record, effect.unchanged)
        names = (format_record_name(record.content_id, row.name, record.facts.split) for record in records)
        origin = ValueSource(effect.record.facts.measured.world, "; ".join(names))
        identity: Values = {"planner": row.planner, "sensor": effect.record.facts.measured.sensor}
        rows += [{**identity, **_values(measured, origin)} for measured in effect.effects]
        if effect.unpaired:
            notes.append(
                f"{row.name}: {pluralise(effect.unpaired, 'drive')} without a partner on the recordings, or failed on "
                "either side: in no pair."
            )
    splits = ", ".join(dict.fromkeys(effect.unchanged.facts.split for _, effect in named))
    title = f"{group.title}: paired with {splits}"
    return tabulate(
        f"drives-paired-{group.name}",
        title,
        _COLUMNS,
        rows,
        (_SHORT_NOTE, _NOTE, *notes, *group.notes),
        brief=_BRIEF,
        brief_notes=(_SHORT_NOTE, *notes, *group.notes),
    )


def _values(measured: MeasuredEffect, origin: ValueSource) -> Values:
    head, unit, digits = _MEASURES[measured.measure]
    scale = 100.0 if unit == PERCENT else 1.0
    difference, pairs = measured.difference, measured.pairs
    sides = {"adversarial": measured.adversarial, "unchanged": measured.unchanged}
    gap = origin.cell(
        difference.value,
        "points" if unit == PERCENT else unit,
        difference.recordings,
        "recordings",
        low=difference.low,
        high=difference.high,
        scale=scale,
    )
    return {
        "measure": TableCell(head),
        **{name: origin.cell(value, unit, pairs, "drives", scale=scale).shown(digits) for name, value in sides.items()},
        "difference": gap.shown(digits, signed=True),
        "95 % of difference": gap.interval(digits),
        "recordings needed": origin.count(measured.needed, "recordings", difference.recordings),
        "recordings": origin.count(difference.recordings, "recordings"),
        "differing": origin.count(difference.differing, "recordings", difference.recordings),
        "pairs": origin.count(pairs, "drives"),
    }
