"""What each protocol misses and invents, measured by ``exact`` on the same plans."""

from collections.abc import Sequence

from benchmark.metrics.disagreement import (
    CAUSES,
    EXACT,
    OTHER_INSTANTS,
    RUNGS,
    Confusion,
    ProtocolComparison,
    comparisons,
)
from benchmark.records.run import RunRecord
from benchmark.report.cells import Origin, Shown, number, record_name
from benchmark.report.table import Table
from benchmark.report.words import titled
from leaderboard.frame.rows import (
    STALE_MARK,
    completeness_notes,
    in_table_order,
    notes_of_marks,
    row_name,
    stale_notes,
)
from leaderboard.frame.runs import Frame, Row
from leaderboard.frame.specification import Values, numbers, tabulate, texts, under

_SHORT = dict(
    zip(
        (*RUNGS, OTHER_INSTANTS),
        ("between", "class", "later", "range", "points", "heading", "raster", "mask", "instants"),
        strict=True,
    )
)
"""Column heads."""
_Found = Row[ProtocolComparison]
"""A run, a protocol, and how the two compare."""


def disagreement_table(data_name: str, split: str, records: Sequence[RunRecord]) -> Table:
    """False alarms and misses of every protocol with their causes, from rows alone.

    Args:
        data_name: Name of the data set, for the title.
        split: The split.
        records: Run records; those of other data sets or splits, or not judged by ``exact``, are left out.

    Returns:
        One row for each planner and protocol but ``exact``; causes that nobody shows have no column.
    """
    runs = [
        record
        for record in in_table_order(records)
        if record.run.data.name == data_name and record.run.split == split and EXACT in record.run.protocols
    ]
    rows = [Row(record, protocol, confusion) for record in runs for protocol, confusion in comparisons(record).items()]
    shown_causes = [cause for cause in CAUSES if any(row.found.causes and row.found.causes[cause] for row in rows)]
    columns = [
        *texts("planner", "protocol"),
        *under(
            "samples, exact and the row's protocol",
            numbers("samples", "exact +", "official +", "misses", "false alarms"),
        ),
        *under("causes, the row's protocol against exact", numbers(*(_short(cause) for cause in shown_causes))),
        *under("steps, exact and the row's protocol", numbers("mask took", "step misses", "step false alarms")),
    ]
    title = f"{titled(data_name, split)}: what each protocol misses and invents, measured by exact"
    brief = ("planner", "protocol", "samples", "misses", "false alarms", "mask took")
    return tabulate(f"disagreement-{split}", title, columns, map(_values, rows), _notes(runs, rows), brief=brief)


def disagreement_tables(frame: Frame) -> list[Table]:
    """`disagreement_table` of each split on which anything compares."""
    tables = (disagreement_table(frame.data_name, split, frame.runs) for split in frame.splits)
    return [table for table in tables if table.rows]


def _values(row: _Found) -> Values:
    origin, confusion = Origin(f"{row.judge} against {EXACT}", record_name(row.record)), row.found
    samples, removed = confusion.samples, origin.count(confusion.mask_removed_steps, "steps", confusion.steps.compared)
    both = {"samples": samples.compared, "exact +": samples.exact, "official +": samples.official}
    counts = both | {_short(cause): None if confusion.causes is None else confusion.causes[cause] for cause in CAUSES}
    return {
        "planner": row_name(row.record, EXACT),
        "protocol": f"{row.judge} {STALE_MARK}" if row.judge in row.record.stale_protocols else row.judge,
        **{head: origin.count(count, "samples", samples.compared) for head, count in counts.items()},
        **_wrong(origin, samples, "samples", ""),
        "mask took": removed.shown(after=f" ({confusion.samples_with_removed_steps})"),
        **_wrong(origin, confusion.steps, "steps", "step "),
    }


def _wrong(origin: Origin, confusion: Confusion, of: str, before: str) -> dict[str, Shown]:
    """Misses and false alarms with their shares."""
    missed = origin.count(confusion.missed, of, confusion.exact)
    false_alarms = origin.count(confusion.false_alarms, of, confusion.official)
    return {
        f"{before}misses": missed.shown(after=_share(confusion.missed_share)),
        f"{before}false alarms": false_alarms.shown(after=_share(confusion.false_share)),
    }


def _share(share: float | None) -> str:
    return f" ({number(None if share is None else 100 * share, 1)})"


def _short(cause: str) -> str:
    kind, _, counterfactual = cause.partition(": ")
    return f"{kind.partition(' ')[0]}: {_SHORT[counterfactual]}"


def _notes(runs: Sequence[RunRecord], rows: Sequence[_Found]) -> tuple[str, ...]:
    notes = [
        "A sample is positive if the plan collides at any time within 3 s; exact looks at all objects all the time, "
        "the official verdict is the one after the protocol's mask. Only samples count that both count. Brackets: % of "
        "exact + for misses, of official + for false alarms.",
        f"Causes (docs/footguns.md): {', '.join(f'{_SHORT[counterfactual]} = {counterfactual}' for counterfactual in RUNGS[:5])}.",
        "Mask took: steps (and samples with such steps) that a protocol drops because, in its eyes, the recorded ego "
        "collides there too. Steps: the verdicts at the six waypoints, where exact looks at the waypoint alone.",
    ]
    unknown = sorted({f"{row.record.planner} ({row.judge})" for row in rows if row.found.causes is None})
    if unknown:
        notes.append(
            f"No causes in the records of {', '.join(unknown)}; challenger-bench rescore finds them with the data set."
        )
    notes += notes_of_marks(runs)
    for record in runs:
        notes += stale_notes(record, sorted(record.run.protocols))
    return (*notes, *completeness_notes(runs))
