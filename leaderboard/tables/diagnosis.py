"""Why plans collide, by planner and by manoeuvre: the diagnoses of records, counted."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import find_attributed_collisions
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.row_schema import CAUSES, DiagnosisRow
from benchmark.records.run import RunRecord
from benchmark.report.table import Table
from leaderboard.frame.rows import run_notes, stale_notes
from leaderboard.frame.runs import DataSetRuns, RunRow
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    share_cell,
    tabulate,
    text_columns,
)

_RULE: Final = (
    "Unseen: no forecast of the planner is near the object hit. Misforecast: the plan is clear of the planner's own "
    "forecast of it. Misplanned: it hits that forecast too. Not attributable: the planner gives no forecasts. The rule "
    "is in docs/diagnosis.md. On splits with adversaries only samples whose first contact is with one are diagnosed."
)
_MANOEUVRE_NOTE: Final = "Col. 3s: share of samples that collide within 3 s; the other shares are of these."
_BY_CAUSE: Final = group_columns(f"% of the colliding samples, {EXACT}", estimate_columns(*CAUSES))
_CAUSES: Final = [
    *text_columns("planner", "split"),
    *group_columns(f"counted, {EXACT}", number_columns("samples", "colliding")),
    *_BY_CAUSE,
]
_CASES: Final = [
    *text_columns("planner", "split", "cause", "case"),
    *group_columns(f"colliding samples, {EXACT}", number_columns("samples"), number_columns("%", digits=1)),
]
_MANOEUVRES: Final = [
    *text_columns("split", "manoeuvre", "planner"),
    *group_columns(f"counted, {EXACT}", number_columns("scenes", "samples", "colliding")),
    *group_columns(f"collision rate in %, {EXACT}", estimate_columns("col. 3s", digits=2, beside="95 %")),
    *_BY_CAUSE,
]


@dataclass(frozen=True, slots=True)
class _DiagnosedSamples:
    """Samples of a record that ``exact`` counts: scene and whether it collides; `colliding` are scenes and reasons."""

    rows: tuple[tuple[str, bool], ...]
    colliding: tuple[tuple[str, DiagnosisRow | None], ...]

    @property
    def diagnosed(self) -> bool:
        """Whether its collisions were diagnosed; those of old records were not."""
        return all(diagnosis is not None for _, diagnosis in self.colliding)

    def of_scenes(self, scenes: set[str]) -> "_DiagnosedSamples":
        """The same for some scenes."""
        rows = tuple(row for row in self.rows if row[0] in scenes)
        return _DiagnosedSamples(rows, tuple(row for row in self.colliding if row[0] in scenes))


def _read_samples(record: RunRecord) -> _DiagnosedSamples | None:
    if EXACT not in record.run.protocols:
        return None
    columns = record.columns
    scenes, causes, hits = columns.values("scene"), columns.values("diagnosis"), find_attributed_collisions(record)
    counted = columns.counted(EXACT)
    hits = hits & counted
    return _DiagnosedSamples(
        tuple((scenes[place], bool(hits[place])) for place in np.flatnonzero(counted).tolist()),
        tuple((scenes[place], causes[place]) for place in np.flatnonzero(hits).tolist()),
    )


def diagnosis_tables(frame: DataSetRuns) -> list[Table]:
    """Reasons why the plans of each planner collide under ``exact``; empty where no run was judged by it.

    Shares of the causes, the cases behind them, and the same by manoeuvre, where the data set says which. Runs from
    before there were diagnoses get a note in place of rows.
    """
    runs = frame.rows(EXACT, _read_samples)
    if not runs:
        return []
    name, notes, known = frame.data_name, _notes(runs), [run for run in runs if run.found.diagnosed]
    why = f"{name}: causes of collisions (% of the colliding samples), protocol {EXACT}"
    tables = [tabulate("diagnosis", why, _CAUSES, [run.names | _values(run) for run in known], notes)]
    if any(run.found.colliding for run in known):
        cases = [case for run in known for case in _case_rows(run)]
        title = f"{name}: cases of the diagnosis (colliding samples), protocol {EXACT}"
        tables.append(tabulate("diagnosis-cases", title, _CASES, cases, notes))
    if any(_group_scenes_by_manoeuvre(run.record) for run in known):
        title = f"{name}: collisions (%) and causes, by manoeuvre of the first adversary, protocol {EXACT}"
        rows = _group_by_manoeuvre(known)
        tables.append(tabulate("diagnosis-manoeuvres", title, _MANOEUVRES, rows, (_MANOEUVRE_NOTE, *notes)))
    return tables


def _values(run: RunRow[_DiagnosedSamples]) -> dict[str, Any]:
    """Counts, and the share of each cause among the colliding samples."""
    rows, colliding = run.found.rows, run.found.colliding
    shares = _compute_rates(
        run, colliding, [[_find_cause(diagnosis) == cause for cause in CAUSES] for _, diagnosis in colliding]
    )
    return {
        "samples": run.origin.count(len(rows), "samples"),
        "colliding": run.origin.count(len(colliding), "samples", len(rows)),
        **{cause: run.origin.percent(rate, "colliding samples") for cause, rate in zip(CAUSES, shares, strict=True)},
    }


def _compute_rates(
    run: RunRow[_DiagnosedSamples], rows: Sequence[tuple[str, Any]], outcomes: Sequence[Sequence[bool]]
) -> list[Rate]:
    """Share of `rows` with each outcome."""
    sources = map_scenes_to_sources(run.record)
    values = np.array(outcomes, dtype=np.float64).reshape(len(rows), -1 if rows else len(CAUSES))
    scenes = [sources[scene] for scene, _ in rows]
    return compute_ratios_over_scenes(values, np.ones_like(values), scenes, seed=run.record.run.seed)


def _case_rows(run: RunRow[_DiagnosedSamples]) -> Iterable[Values]:
    among = len(run.found.colliding)
    cases = Counter(
        (_find_cause(diagnosis), diagnosis.reason) for _, diagnosis in run.found.colliding if diagnosis is not None
    )
    for (cause, reason), count in sorted(cases.items(), key=lambda case: (CAUSES.index(case[0][0]), case[0][1])):
        counted = run.origin.count(count, "samples", among)
        part = share_cell(run.origin, count, among, "colliding samples")
        yield {**run.names, "cause": cause, "case": reason, "samples": counted, "%": part}


def _group_by_manoeuvre(runs: Sequence[RunRow[_DiagnosedSamples]]) -> list[Values]:
    """The most frequent manoeuvres first; planners stay in their order."""
    by_kind: dict[tuple[str, str], list[tuple[int, RunRow[_DiagnosedSamples]]]] = {}
    for run in runs:
        for kind, names in _group_scenes_by_manoeuvre(run.record).items():
            part = RunRow(run.record, EXACT, run.found.of_scenes(names))
            by_kind.setdefault((run.split, kind), []).append((len(names), part))
    order = sorted(by_kind, key=lambda key: (key[0], -max(scenes for scenes, _ in by_kind[key]), key[1]))
    return [
        {
            **run.names,
            "manoeuvre": key[1],
            "scenes": run.scenes(scenes),
            "col. 3s": run.origin.percent(_compute_rates(run, run.found.rows, [[hit] for _, hit in run.found.rows])[0]),
            **_values(run),
        }
        for key in order
        for scenes, run in by_kind[key]
    ]


def _find_cause(diagnosis: DiagnosisRow | None) -> str:
    return "" if diagnosis is None else diagnosis.cause


def _group_scenes_by_manoeuvre(record: RunRecord) -> dict[str, set[str]]:
    """Scenes that ran by the manoeuvre of their first adversary."""
    scenes_by_manoeuvre: dict[str, set[str]] = {}
    for name in record.run.scenes:
        facts = record.run.scene_facts.get(name)
        if facts is not None and facts.manoeuvre is not None:
            scenes_by_manoeuvre.setdefault(facts.manoeuvre, set()).add(name)
    return scenes_by_manoeuvre


def _notes(runs: Sequence[RunRow[_DiagnosedSamples]]) -> tuple[str, ...]:
    sentences = []
    for run in runs:
        if not run.found.diagnosed:
            sentences.append(f"{run.describe_run}: no diagnoses in this record; run challenger-bench rescore.")
        sentences += stale_notes(run.record, (EXACT,))
    brackets = "Brackets: 95 % bootstrap interval over recorded scenes with collisions."
    return (_RULE, brackets, *run_notes([run.record for run in runs], sentences))
