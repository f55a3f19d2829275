"""Closed loop: what came of drives, a table for each engine and what else decides a drive; nothing else compares."""

from collections.abc import Sequence
from typing import Final

from benchmark.records.drives import COLLISION_RATE, NNS, DriveRecord
from benchmark.records.run_schema import RateRow
from benchmark.report.cells import UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Brief, Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.rows import FEW_NOTE, FEW_SCENES, mark_notes, name_cell

_PERCENT: Final = "%"
_DEFAULT: Final = (
    ("contact", "contact %", _PERCENT, True),
    ("at_fault", "at fault %", _PERCENT, True),
    ("with_adversary", "adversary %", _PERCENT, False),
    ("impact_speed", "impact m/s", "m/s", False),
    ("delta_v", "delta-v m/s", "m/s", False),
    ("route", "route %", _PERCENT, True),
    ("off_road", "off road %", _PERCENT, False),
    ("comfortable", "comfort %", _PERCENT, False),
    ("nuplan_score", "nuPlan terms", "", True),
    ("nuplan_nc", "NC", "", False),
    ("nuplan_dac", "DAC", "", False),
    ("nuplan_mp", "MP", "", False),
    ("nuplan_ddc", "DDC", "", False),
    ("nuplan_p", "P", "", False),
    ("nuplan_ttc", "TTC", "", False),
    ("nuplan_c", "C", "", False),
    ("hd_score", "HD formula", "", True),
)
_NEURONCAP: Final = (
    (NNS, "NNS", "points", True),
    (COLLISION_RATE, "CR %", _PERCENT, True),
    ("impact_speed", "impact m/s", "m/s", False),
    ("route", "route %", _PERCENT, True),
    ("comfortable", "comfort %", _PERCENT, False),
)
"""Column of a summary, head, unit, and whether its interval stands beside it."""
_FAMILIES: Final = ("stationary", "frontal", "side")
_BRIEF_DEFAULT: Final = (
    "planner",
    "sensor",
    "contact %",
    "at fault %",
    "95 %",
    "impact m/s",
    "route %",
    "off road %",
    "comfort %",
    "nuPlan terms",
    "HD formula",
    "failed",
    "drives",
)
_NOTES_DEFAULT: Final = (
    "Contact: any, whoever it is with; at fault: by nuPlan's rules (docs/severity.md). Impact speed and delta-v: means "
    "over contacts. Route: share of the recorded way. A drive ends at its first contact.",
    "nuPlan terms: NC DAC MP DDC (5 P + 5 TTC + 2 C) / 12, without speed limits, traffic lights and route blocks, "
    "which nuScenes lacks: not nuPlan's score. HD formula: HD-Score's formula with our terms, not HUGSIM.",
)
_NOTES_NEURONCAP: Final = (
    "NNS: 5 without contact, else 4 max(0, 1 - impact / reference); CR: drives with a contact. Numbers of this engine "
    "compare with published ones only on NeuroNCAP's own scenarios and renderer. Families of scenarios count alike.",
)
_FAILED_NOTE: Final = (
    "failed: drives in which the planner raised, answered no usable plan or was late; in no other column."
)


def drive_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """One table for each data set, split, engine, policy of agents and latency.

    Args:
        records: Of any planners.

    Returns:
        The tables, NeuroNCAP's engines last.
    """
    kinds: dict[tuple[str, ...], list[DriveRecord]] = {}
    for record in records:
        facts = record.facts
        key = (facts.data.name, facts.data.fingerprint, facts.split, facts.measured.world, ",".join(facts.scenes))
        kinds.setdefault(key, []).append(record)
    ordered = sorted(kinds.values(), key=lambda found: (found[0].facts.measured.engine != "default", _kind(found[0])))
    return [_table(found, number) for number, found in enumerate(ordered)]


def _kind(record: DriveRecord) -> tuple[str, ...]:
    return record.facts.data.name, record.facts.split, record.facts.measured.world


def _table(records: Sequence[DriveRecord], number: int) -> Table:
    first = records[0].facts
    own = first.measured.engine == "default"
    columns = _DEFAULT if own else (*_NEURONCAP, *_of_families(records))
    heads = ["planner", "sensor"]
    for _, head, _, with_interval in columns:
        heads += [head, "95 %"] if with_interval else [head]
    heads += ["failed", "drives"]
    rows = [_row(record, columns) for record in _in_order(records)]
    title = f"{first.data.name} {first.split}: closed loop, engine {first.measured.world}"
    names = [record.facts.planner for record in records]
    marks = mark_notes(
        privileged=any(each.privileged for each in names), miniature=any(each.miniature for each in names)
    )
    sources = {facts.source for record in records for facts in record.facts.scene_facts.values()}
    few = [FEW_NOTE] if len(sources) < FEW_SCENES else []
    notes = (*(_NOTES_DEFAULT if own else _NOTES_NEURONCAP), _FAILED_NOTE, *few, *marks)
    places = _brief_places(heads) if own else tuple(range(len(heads)))
    return table_of(
        f"drives-{number}" if number else "drives",
        title,
        heads,
        rows,
        notes=notes,
        text_columns=2,
        brief=Brief(title, places, notes, text_columns=2),
    )


def _of_families(records: Sequence[DriveRecord]) -> list[tuple[str, str, str, bool]]:
    """Columns of the families of scenarios that were driven."""
    named = {row.family for record in records for row in record.rows if row.family}
    families = [family for family in _FAMILIES if family in named]
    scores = [(f"{NNS}_{family}", f"NNS {family}", "points", False) for family in families]
    return [*scores, *((f"{COLLISION_RATE}_{family}", f"CR {family} %", _PERCENT, False) for family in families)]


def _brief_places(heads: Sequence[str]) -> tuple[int, ...]:
    """Places of the columns that a terminal shows; of intervals that of blame alone."""
    blamed = heads.index("at fault %") + 1
    return tuple(
        place for place, head in enumerate(heads) if (head in _BRIEF_DEFAULT and head != "95 %") or place == blamed
    )


def _in_order(records: Sequence[DriveRecord]) -> list[DriveRecord]:
    """Planners before those that are privileged, by name."""
    return sorted(records, key=lambda each: (each.facts.planner.privileged, each.planner, each.facts.measured.sensor))


def _row(record: DriveRecord, columns: Sequence[tuple[str, str, str, bool]]) -> tuple[str | Shown, ...]:
    planner, summary = record.facts.planner, record.summary
    origin = Origin(record.facts.measured.world, named_record(record.content_id, record.planner, record.facts.split))
    cells: list[str | Shown] = [
        name_cell(record.planner, privileged=planner.privileged, miniature=planner.miniature),
        record.facts.measured.sensor,
    ]
    for name, _, unit, with_interval in columns:
        rate = summary.columns.get(name)
        cells += _cells(origin, rate, unit, with_interval=with_interval)
    failed = origin.count(summary.failed, "drives", summary.drives)
    return (*cells, failed.shown(), origin.count(summary.drives, "drives").shown())


def _cells(origin: Origin, rate: RateRow | None, unit: str, *, with_interval: bool) -> list[str | Shown]:
    if rate is None:
        return [UNDEFINED, UNDEFINED] if with_interval else [UNDEFINED]
    percent = unit == _PERCENT
    cell = origin.percent(rate, "drives") if percent else origin.amount(rate, unit, "drives")
    digits = 1 if percent else 2
    shown: list[str | Shown] = [cell.shown(digits)]
    return [*shown, cell.interval(digits)] if with_interval else shown


def said_of_failures(record: DriveRecord) -> str:
    """How many drives failed and why, in a sentence."""
    reasons = ", ".join(f"{count} {reason}" for reason, count in record.summary.reasons.items())
    first = next(row for row in record.rows if row.failure is not None)
    assert first.failure is not None
    lines = first.failure.text.strip().splitlines() or [first.failure.reason]
    return (
        f"{record.planner} failed in {record.summary.failed} of {counted(record.summary.drives, 'drive')} ({reasons}; "
        f"the first, {first.scene}: {lines[-1]})"
    )
