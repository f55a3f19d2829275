"""How far the collision rate of one planner moves with its seed alone."""

import json
from collections.abc import Sequence

import numpy as np

from benchmark.errors import InputError
from benchmark.metrics.scores import require_current
from benchmark.records.run import RunRecord, protocol_of
from benchmark.report.cells import Origin, record_name
from benchmark.report.table import Table
from leaderboard.frame.rows import judges, name_cell, notes_of_marks
from leaderboard.frame.runs import Frame, whose
from leaderboard.frame.specification import Values, numbers, tabulate, texts, under

_RULE = (
    "Runs of one planner on one split that differ in the seed and in nothing else that a record names. Deviation: of "
    "the runs' rates around their mean (n − 1). It is what drawing the noise again does, and no interval over scenes."
)


def seed_spread_table(frame: Frame, protocol: str) -> Table | None:
    """Spread of the average collision rate over the seeds of each planner on each split.

    A row for each that ran with at least two seeds; ``None`` where there is none. ``native`` is the protocol of the
    planner's own repository. Runs of a part of their split, with failed samples, or judged by another version of the
    protocol are named below the table.
    """
    notes = [_RULE]
    rows, first = [], []
    for runs in _versions(frame.runs):
        if len(runs) < 2:
            continue
        refused = [_refusal(run, protocol) for run in runs]
        notes += [f"Left out: {reason}." for reason in refused if reason is not None]
        rows.append(_values(runs[0], protocol, [run for run, reason in zip(runs, refused) if reason is None]))
        first.append(runs[0])
    if not rows:
        return None
    columns = [
        *texts("planner", "split", "protocol"),
        *under(
            f"average collision rate in %, {whose(protocol)}",
            numbers("seeds"),
            numbers("mean", "lowest", "highest", "deviation", digits=3),
        ),
    ]
    title = f"{frame.data_name}: average collision rate (%) over the seeds of a planner, {judges(protocol)}"
    return tabulate(f"seeds-{protocol}", title, columns, rows, (*notes, *notes_of_marks(first)))


def _versions(records: Sequence[RunRecord]) -> list[list[RunRecord]]:
    """Records of one planner with one set of weights and settings on one split, at most one a seed, by seed."""
    found: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        planner = record.run.planner
        facts = [planner.name, planner.weights_sha256, planner.settings, record.run.split]
        found.setdefault(json.dumps(facts, sort_keys=True), {}).setdefault(planner.seed, record)
    return [[runs[seed] for seed in sorted(runs)] for runs in found.values()]


def _refusal(record: RunRecord, protocol: str) -> str | None:
    """Reason why a run is not comparable with those of other seeds."""
    if not (record.covers_split and record.complete):
        return f"{record.planner} on {record.run.split} has no plan for some samples of the split"
    try:
        require_current(record, protocol_of(record, protocol))
    except InputError as refusal:
        return str(refusal)
    return None


def _values(first: RunRecord, protocol: str, runs: Sequence[RunRecord]) -> Values:
    """One planner; ``runs`` are those that count."""
    planner, judge = first.run.planner, protocol_of(first, protocol)
    found = [run.summary.protocols[judge].columns["collision"]["avg"].value for run in runs]
    rates = [rate for rate in found if rate is not None]
    origin = Origin(judge, record_name(*runs) or None)
    of_seeds = {
        "mean": float(np.mean(rates)) if rates else None,
        "lowest": min(rates, default=None),
        "highest": max(rates, default=None),
        "deviation": float(np.std(rates, ddof=1)) if len(rates) > 1 else None,
    }
    return {
        "planner": name_cell(planner.name, planner),
        "split": first.run.split,
        "protocol": judge,
        "seeds": origin.count(len(rates), "seeds"),
        **{name: origin.cell(value, "%", len(rates), "seeds", scale=100.0) for name, value in of_seeds.items()},
    }
