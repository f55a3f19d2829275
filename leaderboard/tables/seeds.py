"""How far the collision rate of one planner moves with its seed alone."""

import json
from collections.abc import Sequence

import numpy as np

from benchmark.errors import InputError
from benchmark.metrics.scores import require_current
from benchmark.records.run import NATIVE, RunRecord, protocol_of
from benchmark.report.cells import Cell, Origin, Shown, record_name
from benchmark.report.table import Table, table_of
from leaderboard.tables.rows import in_table_order, judges, name_cell, notes_of_marks

_RULE = (
    "Runs of one planner on one split that differ in the seed and in nothing else that a record names. Deviation: of "
    "the runs' rates around their mean (n − 1). It is what drawing the noise again does, and no interval over scenes."
)


def seed_spread_table(data_name: str, protocol: str, records: Sequence[RunRecord]) -> Table | None:
    """Spread of the average collision rate over the seeds of each planner on each split.

    Args:
        data_name: Name of the data set, for the title.
        protocol: Whose verdicts; ``native`` is that of the planner's own repository.
        records: Runs on this data set. Runs of a part of their split, with failed samples, or judged by another version
            of the protocol are named below the table.

    Returns:
        One row for each planner and split that ran with at least two seeds, or ``None`` where there is none.
    """
    notes = [_RULE]
    rows, shown = [], []
    for runs in _versions(records):
        if len({run.run.planner.seed for run in runs}) < 2:
            continue
        kept = []
        for run in runs:
            refusal = _refusal(run, protocol)
            if refusal is None:
                kept.append(run)
            else:
                notes.append(f"Left out: {refusal}.")
        rows.append(_row(runs[0], protocol, kept))
        shown.append(runs[0])
    if not rows:
        return None
    who = "own protocol" if protocol == NATIVE else protocol
    return table_of(
        f"seeds-{protocol}",
        f"{data_name}: average collision rate (%) over the seeds of a planner, {judges(protocol)}",
        ("planner", "split", "protocol", "seeds", "mean", "lowest", "highest", "deviation"),
        rows,
        notes=(*notes, *notes_of_marks(shown)),
        text_columns=3,
        groups=(("", 3), (f"average collision rate in %, {who}", 5)),
    )


def _versions(records: Sequence[RunRecord]) -> list[list[RunRecord]]:
    """Records of one planner with one set of weights and settings on one split, at most one a seed, by seed."""
    found: dict[str, dict[int, RunRecord]] = {}
    for record in in_table_order(records):
        planner = record.run.planner
        facts = [planner.name, planner.weights_sha256, planner.settings, record.run.split]
        found.setdefault(json.dumps(facts, sort_keys=True), {}).setdefault(planner.seed, record)
    return [[runs[seed] for seed in sorted(runs)] for runs in found.values()]


def _refusal(record: RunRecord, protocol: str) -> str | None:
    """Why a run is not comparable with those of other seeds."""
    if not (record.covers_split and record.complete):
        return f"{record.planner} on {record.run.split} has no plan for some samples of the split"
    try:
        require_current(record, protocol_of(record, protocol))
    except InputError as refusal:
        return str(refusal)
    return None


def _row(first: RunRecord, protocol: str, runs: Sequence[RunRecord]) -> tuple[str | Shown, ...]:
    """One planner; ``runs`` are those that count."""
    planner, judge = first.run.planner, protocol_of(first, protocol)
    found = [run.summary.protocols[judge].columns["collision"]["avg"].value for run in runs]
    rates = [rate for rate in found if rate is not None]
    origin = Origin(judge, record_name(*runs) or None)

    def of_seeds(value: float | None) -> Cell:
        return origin.cell(value, "%", len(rates), "seeds", scale=100.0)

    numbers = (
        float(np.mean(rates)) if rates else None,
        min(rates, default=None),
        max(rates, default=None),
        float(np.std(rates, ddof=1)) if len(rates) > 1 else None,
    )
    return (
        name_cell(planner.name, privileged=planner.privileged, miniature=planner.miniature),
        first.run.split,
        judge,
        origin.count(len(rates), "seeds").shown(),
        *(of_seeds(value).shown(3) for value in numbers),
    )
