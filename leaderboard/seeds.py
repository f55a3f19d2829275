"""How far the collision rate of one planner moves with its seed alone."""

import json
from collections.abc import Sequence

import numpy as np

from benchmark.errors import InputError
from benchmark.records import RunRecord, protocol_of
from benchmark.scores import require_current
from leaderboard.collision import in_table_order, marked
from leaderboard.tables import UNDEFINED, Table, percent

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
    rows = []
    for runs in _versions(records):
        if len({run.run.planner.seed for run in runs}) < 2:
            continue
        rates = []
        for run in runs:
            refusal = _refusal(run, protocol)
            if refusal is None:
                rates.append(run.summary.protocols[protocol_of(run, protocol)].columns["collision"]["avg"].value)
            else:
                notes.append(f"Left out: {refusal}.")
        rows.append(_row(runs[0], protocol, [rate for rate in rates if rate is not None]))
    if not rows:
        return None
    return Table(
        name=f"seeds-{protocol}",
        title=f"{data_name}: average collision rate (%) over the seeds of a planner, protocol {protocol}",
        columns=("planner", "split", "protocol", "seeds", "mean", "lowest", "highest", "deviation"),
        rows=tuple(rows),
        notes=tuple(notes),
        text_columns=3,
    )


def _versions(records: Sequence[RunRecord]) -> list[list[RunRecord]]:
    """Records of one planner with one set of weights and settings on one split, at most one a seed."""
    found: dict[str, dict[int, RunRecord]] = {}
    for record in in_table_order(records):
        planner = record.run.planner
        facts = [planner.name, planner.weights_sha256, planner.settings, record.run.split]
        found.setdefault(json.dumps(facts, sort_keys=True), {}).setdefault(planner.seed, record)
    return [list(runs.values()) for runs in found.values()]


def _refusal(record: RunRecord, protocol: str) -> str | None:
    """Why a run is not comparable with those of other seeds."""
    if not (record.covers_split and record.complete):
        return f"{record.planner} on {record.run.split} has no plan for some samples of the split"
    try:
        require_current(record, protocol_of(record, protocol))
    except InputError as refusal:
        return str(refusal)
    return None


def _row(record: RunRecord, protocol: str, rates: Sequence[float]) -> tuple[str, ...]:
    planner = record.run.planner
    several = len(rates) > 1
    return (
        marked(planner.name, privileged=planner.privileged),
        record.run.split,
        protocol_of(record, protocol),
        str(len(rates)),
        percent(float(np.mean(rates)) if rates else None, 3),
        percent(min(rates, default=None), 3),
        percent(max(rates, default=None), 3),
        percent(float(np.std(rates, ddof=1)), 3) if several else UNDEFINED,
    )
