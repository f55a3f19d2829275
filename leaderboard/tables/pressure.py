"""Pressure at which a planner breaks: drives against adversaries of several budgets, and against others' tracks.

A budget is how often the adversary is planned anew, with how many refinement rounds of how many candidates; everything
else of what was measured is the same in one table.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.metrics.rates import compute_ratios_over_scenes
from benchmark.records.drives import AT_FAULT, ATTRIBUTABLE, BYSTANDER, DriveRecord
from benchmark.records.fault import blames_ego
from benchmark.records.run_schema import find_source
from benchmark.report.cells import CellSource, ValueSource
from benchmark.report.table import Table
from leaderboard.frame.drives import DriveTableRow, group_comparable_drives
from leaderboard.frame.specification import (
    TableColumn,
    Value,
    Values,
    number_columns,
    numbered_columns,
    tabulate,
    text_columns,
)

BUDGET: Final = ("every_s", "rounds", "candidates")
"""Fields of a budget, by the names of a record's `agents_facts`."""
TRACKS_OF, RECORD = "tracks_of", "record"
"""Source of given tracks: the name of the planner in whose drives they were searched, and its record's content id."""
_OF_SEARCH: Final = ("search",)
"""Of the facts, what follows from a budget: the fingerprint of all settings."""
_PRESSURE_NOTE: Final = (
    "Each row is one budget of the adversary: the time between its plans, the number of refinement "
    "rounds and of candidates. Attributable: contacts at fault with the adversary, in encounters that a careful "
    "human survives against the same budget; bystander: the same with other road users; at fault: with any object; "
    "impact: mean over contacts. All other settings are the same in all rows."
)
_TRANSFER_NOTE: Final = (
    "Rows: the planner in whose drives the adversary was planned; columns: the planner that drives against the same "
    "track. Of encounters in which the row's planner had a contact at fault with the adversary, the share in which the "
    "column's has one too; the diagonal is the row's planner against its own tracks. A dash: the row's planner never "
    "failed, or a record does not say whose fault its contacts are by fault@1 (challenger-bench rescore adds it)."
)
_SHARES: Final = {
    ATTRIBUTABLE: "attributable %",
    BYSTANDER: "bystander %",
    AT_FAULT: "at fault %",
    "survives_cc": "careful survives %",
}
_COLUMNS: Final = [
    *text_columns("planner", "every s", "rounds", "candidates"),
    *(
        column
        for name, head, digits in (*((*each, 1) for each in _SHARES.items()), ("impact_speed", "impact m/s", 2))
        for column in (TableColumn(head, name, digits=digits), TableColumn("95 %", name, digits=digits, interval=True))
    ),
    *number_columns("drives"),
]


@dataclass(frozen=True, slots=True)
class DrivePressure:
    """Drives of one planner against one budget: seconds between plans, rounds, candidates."""

    row: DriveTableRow
    budget: tuple[float, int, int]

    @property
    def candidates(self) -> float:
        """Candidates that are looked at a second, all rounds together: how hard the adversary searches."""
        every_s, rounds, candidates = self.budget
        return (1 + rounds) * candidates / every_s


def group_by_pressure(records: Sequence[DriveRecord]) -> list[tuple[str, list[DrivePressure]]]:
    """Drives that differ in the adversary's budget alone, by title, weakest first, where there are several."""
    kinds: dict[str, list[DrivePressure]] = {}
    titles: dict[str, str] = {}
    for world in group_comparable_drives([drive for drive in records if _find_budget(drive) is not None]):
        for row in world.rows:
            facts, budget = row.record.facts, _find_budget(row.record)
            assert budget is not None
            rest = _remove_names(facts.measured.agents_facts, (*BUDGET, *_OF_SEARCH))
            key = json.dumps([facts.data.fingerprint, facts.split, facts.scenes, facts.runs, rest, world.sensor])
            measured_texts = ", ".join(f"{word.replace('_', ' ')} {value}" for word, value in rest.items())
            titles[key] = f"{facts.data.name} {facts.split}: pressure of a reactive adversary ({measured_texts})"
            kinds.setdefault(key, []).append(DrivePressure(row, budget))
    several = {key: group for key, group in kinds.items() if len({drive.budget for drive in group}) > 1}
    return [
        (titles[key], sorted(group, key=lambda each: (each.row.name, each.candidates, each.budget)))
        for key, group in sorted(several.items(), key=lambda item: titles[item[0]])
    ]


def name_pressure(number: int) -> str:
    """Name of the table and the figure of one of `group_by_pressure`, by its place."""
    return "drives-pressure" if not number else f"drives-pressure-{number + 1}"


def pressure_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """A table of every adversary that was given several budgets, then transfer between drives."""
    tables = [
        tabulate(name_pressure(number), title, _COLUMNS, map(_values, rows), (_PRESSURE_NOTE,))
        for number, (title, rows) in enumerate(group_by_pressure(records))
    ]
    return [*tables, *transfer_tables(records)]


def _values(pressure: DrivePressure) -> Values:
    row, (every_s, rounds, candidates) = pressure.row, pressure.budget
    budget: Values = {"every s": f"{every_s:g}", "rounds": str(rounds), "candidates": str(candidates)}
    rates = {name: row.cell(name) for name in _SHARES}
    impact = row.cell("impact_speed", "m/s")
    return {"planner": row.planner, **budget, **rates, "impact_speed": impact, "drives": row.drives()}


def transfer_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """Transfer of adversarial tracks, a table for each data set and split, where the source's record is given."""
    sources = {record.content_id: record for record in records if _find_budget(record) is not None}
    kinds: dict[str, list[tuple[DriveRecord, DriveRecord]]] = {}
    for record in records:
        facts = record.facts.measured.agents_facts
        source = sources.get(str(facts.get(RECORD)))
        if TRACKS_OF in facts and source is not None:
            key = json.dumps([record.facts.data.name, record.facts.split, source.facts.measured.world])
            kinds.setdefault(key, []).append((source, record))
    return [_transfer_table(number, pairs) for number, (_, pairs) in enumerate(sorted(kinds.items()))]


def _transfer_table(number: int, pairs: Sequence[tuple[DriveRecord, DriveRecord]]) -> Table:
    first = pairs[0][0].facts
    by_name = {(source.planner, record.planner): (source, record) for source, record in pairs}
    rows_of = sorted({source for source, _ in by_name})
    columns_of = sorted({victim for _, victim in by_name} | set(rows_of))
    rows: list[dict[str, Value]] = []
    for name in rows_of:
        source = next(pair[0] for (by, _), pair in by_name.items() if by == name)
        failed = _find_failures(source)
        fails = None if failed is None else ValueSource().count(len(failed), "drives", len(source.rows))
        rows.append({"planned against": name, "fails": fails})
        for place, column in enumerate(columns_of):
            pair = by_name.get((name, column), (source, source) if column == name else None)
            rows[-1][f"#{place}"] = None if pair is None else _transfer_cell(*pair, column)
    name = "drives-transfer" if not number else f"drives-transfer-{number + 1}"
    title = f"{first.data.name} {first.split}: transfer in closed loop, {first.measured.world}"
    columns = [*text_columns("planned against"), *number_columns("fails"), *numbered_columns(columns_of, 1)]
    return tabulate(name, title, columns, rows, (_TRANSFER_NOTE,))


def _find_failures(record: DriveRecord) -> set[tuple[str, int]] | None:
    """Encounters with a contact at fault with the adversary; ``None`` where one does not say whose fault it is."""
    if not all(row.says_fault for row in record.rows):
        return None
    return {
        (row.scene, row.run)
        for row in record.rows
        if not row.unlabelled and any(touch.adversary and blames_ego(touch.fault) for touch in row.touches)
    }


def _transfer_cell(source: DriveRecord, victim: DriveRecord, name: str) -> CellSource | None:
    """Share of the source's failures that the victim fails too, with scenes as the drawn unit."""
    failed, also = _find_failures(source), _find_failures(victim)
    if failed is None or also is None:
        return None
    drove = {(row.scene, row.run) for row in victim.rows if row.status == "ok" and not row.unlabelled}
    counted = sorted(failed & drove)
    if not counted:
        return None
    scenes = [find_source(scene, source.facts.scene_facts) for scene, _ in counted]
    hits = np.array([[float(encounter in also)] for encounter in counted])
    (rate,) = compute_ratios_over_scenes(hits, np.ones_like(hits), scenes, seed=source.facts.seed)
    return DriveTableRow(victim, name).origin.percent(rate, "drives")


def _find_budget(record: DriveRecord) -> tuple[float, int, int] | None:
    facts = record.facts.measured.agents_facts
    if any(name not in facts for name in BUDGET):
        return None
    return float(facts["every_s"]), int(facts["rounds"]), int(facts["candidates"])


def _remove_names(facts: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    return {name: value for name, value in facts.items() if name not in names}
