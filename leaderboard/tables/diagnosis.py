"""Why plans collide, by planner and by manoeuvre: the diagnoses of records, counted."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import attributed_collisions
from benchmark.metrics.rates import Rate, ratios_over_scenes
from benchmark.metrics.scores import source_of_scenes
from benchmark.records.row_schema import CAUSES, DiagnosisRow
from benchmark.records.run import RunRecord
from benchmark.report.cells import Cell, Origin, Shown, origin_of
from benchmark.report.table import Table, table_of
from leaderboard.tables.rows import in_table_order, row_name, run_notes, stale_notes

_RULE: Final = (
    "Unseen: no forecast of the planner is near what it hits. Misforecast: the plan is clear of the planner's own "
    "forecast of it. Misplanned: it hits that forecast too. Not attributable: the planner gives no forecasts. The rule "
    "is in docs/diagnosis.md. On splits with adversaries only samples whose first contact is with one are diagnosed."
)
_CAUSE_GROUP: Final = (f"% of the colliding samples, {EXACT}", 2 * len(CAUSES))


@dataclass(frozen=True, slots=True)
class _Run:
    """One record and those of its samples that ``exact`` counts.

    Attributes:
        record: The record.
        rows: Of each counted sample its scene, and whether it collides.
        colliding: Of those that collide the scene, and why.
    """

    record: RunRecord
    rows: tuple[tuple[str, bool], ...]
    colliding: tuple[tuple[str, DiagnosisRow | None], ...]

    @classmethod
    def of(cls, record: RunRecord) -> "_Run":
        columns = record.columns
        scenes, causes, hits = columns.values("scene"), columns.values("diagnosis"), attributed_collisions(record)
        counted = columns.counted(EXACT)
        hits = hits & counted
        return cls(
            record,
            tuple((scenes[place], bool(hits[place])) for place in np.flatnonzero(counted).tolist()),
            tuple((scenes[place], causes[place]) for place in np.flatnonzero(hits).tolist()),
        )

    @property
    def diagnosed(self) -> bool:
        """Whether its collisions were diagnosed: those of old records were not."""
        return all(diagnosis is not None for _, diagnosis in self.colliding)

    @property
    def label(self) -> tuple[Shown, str]:
        """Planner and split, the first two cells of its rows."""
        return row_name(self.record, EXACT), self.record.run.split

    @property
    def origin(self) -> Origin:
        """Where its numbers come from."""
        return origin_of(self.record, EXACT)

    def counts(self) -> tuple[Shown, Shown]:
        """Counted samples and those that collide."""
        rows, colliding = len(self.rows), len(self.colliding)
        return self.origin.count(rows, "samples").shown(), self.origin.count(colliding, "samples", rows).shown()

    def of_scenes(self, scenes: set[str]) -> "_Run":
        """The same for some scenes."""
        rows = tuple(row for row in self.rows if row[0] in scenes)
        return _Run(self.record, rows, tuple(row for row in self.colliding if row[0] in scenes))

    def _sources(self, rows: Sequence[tuple[str, Any]]) -> list[str]:
        source_of = source_of_scenes(self.record)
        return [source_of[scene] for scene, _ in rows]

    def shares(self) -> list[Rate]:
        """Share of each cause among the colliding samples."""
        found = [[_cause(diagnosis) == cause for cause in CAUSES] for _, diagnosis in self.colliding]
        values = np.array(found, dtype=np.float64).reshape(-1, len(CAUSES))
        scenes = self._sources(self.colliding)
        return ratios_over_scenes(values, np.ones_like(values), scenes, seed=self.record.run.seed)

    def collision_rate(self) -> Rate:
        """Share of the counted samples that collide within 3 s."""
        values = np.array([[hit] for _, hit in self.rows], dtype=np.float64).reshape(-1, 1)
        scenes = self._sources(self.rows)
        return ratios_over_scenes(values, np.ones_like(values), scenes, seed=self.record.run.seed)[0]


def diagnosis_tables(data_name: str, records: Sequence[RunRecord]) -> list[Table]:
    """Why the plans of each planner collide under ``exact``.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set; those that ``exact`` did not judge are left out.

    Returns:
        Shares of the causes by planner and split; the cases behind them; the same by manoeuvre, where the data set
        says which. Empty where no run was judged by ``exact``. Runs from before there were diagnoses get a note in
        place of rows.
    """
    runs = [_Run.of(record) for record in in_table_order(records) if EXACT in record.run.protocols]
    if not runs:
        return []
    known = [run for run in runs if run.diagnosed]
    notes = _notes(runs)
    tables = [_cause_table(data_name, known, notes)]
    if any(run.colliding for run in known):
        tables.append(_reason_table(data_name, known, notes))
    if any(_manoeuvres(run) for run in known):
        tables.append(_manoeuvre_table(data_name, known, notes))
    return tables


def _cause_table(data_name: str, runs: Sequence[_Run], notes: tuple[str, ...]) -> Table:
    return table_of(
        "diagnosis",
        f"{data_name}: why plans collide (% of the colliding samples), protocol {EXACT}",
        ("planner", "split", "samples", "colliding", *_cause_columns()),
        [(*run.label, *run.counts(), *_cause_cells(run)) for run in runs],
        notes=notes,
        text_columns=2,
        groups=(("", 2), (f"counted, {EXACT}", 2), _CAUSE_GROUP),
    )


def _reason_table(data_name: str, runs: Sequence[_Run], notes: tuple[str, ...]) -> Table:
    rows: list[tuple[str | Shown, ...]] = []
    for run in runs:
        cases = Counter((_cause(said), said.reason) for _, said in run.colliding if said is not None)
        for (cause, reason), count in sorted(cases.items(), key=lambda case: (CAUSES.index(case[0][0]), case[0][1])):
            among = len(run.colliding)
            share = run.origin.cell(count / among, "%", among, "colliding samples", scale=100.0)
            rows.append((*run.label, cause, reason, run.origin.count(count, "samples", among).shown(), share.shown(1)))
    return table_of(
        "diagnosis-cases",
        f"{data_name}: cases of the diagnosis (colliding samples), protocol {EXACT}",
        ("planner", "split", "cause", "case", "samples", "%"),
        rows,
        notes=notes,
        text_columns=4,
        groups=(("", 4), (f"colliding samples, {EXACT}", 2)),
    )


def _manoeuvre_table(data_name: str, runs: Sequence[_Run], notes: tuple[str, ...]) -> Table:
    by_kind: dict[tuple[str, str], list[tuple[int, _Run]]] = {}
    for run in runs:
        for kind, names in _manoeuvres(run).items():
            by_kind.setdefault((run.record.run.split, kind), []).append((len(names), run.of_scenes(names)))
    # The most frequent manoeuvres first; planners stay in their order.
    order = sorted(by_kind, key=lambda key: (key[0], -max(scenes for scenes, _ in by_kind[key]), key[1]))
    rows = [_manoeuvre_row(key[1], scenes, run) for key in order for scenes, run in by_kind[key]]
    return table_of(
        "diagnosis-manoeuvres",
        f"{data_name}: collisions (%) and why, by manoeuvre of the first adversary, protocol {EXACT}",
        ("split", "manoeuvre", "planner", "scenes", "samples", "colliding", "col. 3s", "95 %", *_cause_columns()),
        rows,
        notes=("Col. 3s: share of the samples that collide within 3 s; the other shares are of those.", *notes),
        text_columns=3,
        groups=(("", 3), (f"counted, {EXACT}", 3), (f"collision rate in %, {EXACT}", 2), _CAUSE_GROUP),
    )


def _manoeuvre_row(kind: str, scenes: int, run: _Run) -> tuple[str | Shown, ...]:
    planner, split = run.label
    rate = run.origin.percent(run.collision_rate())
    counts = (run.origin.count(scenes, "scenes", len(run.record.run.scenes)).shown(), *run.counts())
    return (split, kind, planner, *counts, rate.shown(2), rate.interval(), *_cause_cells(run))


def _cause_columns() -> tuple[str, ...]:
    return tuple(head for cause in CAUSES for head in (cause, f"95 % of {cause}"))


def _cause_cells(run: _Run) -> tuple[Shown, ...]:
    cells: list[Cell] = [run.origin.percent(rate, "colliding samples") for rate in run.shares()]
    return tuple(shown for cell in cells for shown in (cell.shown(1), cell.interval()))


def _cause(diagnosis: DiagnosisRow | None) -> str:
    return "" if diagnosis is None else diagnosis.cause


def _manoeuvres(run: _Run) -> dict[str, set[str]]:
    """Scenes that ran by the manoeuvre of their first adversary."""
    found: dict[str, set[str]] = {}
    for name in run.record.run.scenes:
        facts = run.record.run.scene_facts.get(name)
        if facts is not None and facts.manoeuvre is not None:
            found.setdefault(facts.manoeuvre, set()).add(name)
    return found


def _notes(runs: Sequence[_Run]) -> tuple[str, ...]:
    notes = [_RULE, "Brackets: 95 % bootstrap interval over recorded scenes with collisions."]
    told = []
    for run in runs:
        if not run.diagnosed:
            where = f"{run.record.planner} on {run.record.run.split}"
            told.append(f"{where}: no diagnoses in this record; run challenger-bench rescore.")
        told += stale_notes(run.record, (EXACT,))
    return (*notes, *run_notes([run.record for run in runs], told))
