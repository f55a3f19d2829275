"""Misses and false alarms of each protocol, measured by ``exact`` on the same plans."""

from collections.abc import Sequence

from benchmark.metrics.disagreement import (
    CAUSES,
    COUNTERFACTUALS,
    EXACT,
    OTHER_INSTANTS,
    Confusion,
    ProtocolComparison,
    compare_protocols,
)
from benchmark.records.run import RunRecord
from benchmark.report.cells import TableCell, ValueSource, format_number, join_record_names
from benchmark.report.table import Table
from benchmark.report.words import format_title
from leaderboard.frame.rows import (
    STALE_MARK,
    completeness_notes,
    list_run_marks,
    row_name,
    sort_for_tables,
    stale_notes,
)
from leaderboard.frame.runs import DataSetRuns, RunRow
from leaderboard.frame.specification import Values, group_columns, number_columns, tabulate, text_columns

_SHORT = dict(
    zip(
        (*COUNTERFACTUALS, OTHER_INSTANTS),
        ("between", "class", "later", "range", "points", "heading", "raster", "mask", "instants"),
        strict=True,
    )
)
"""Column heads."""
_DisagreementRow = RunRow[ProtocolComparison]
"""A run, a protocol, and how the two compare."""


def disagreement_table(data_name: str, split: str, records: Sequence[RunRecord]) -> Table:
    """False alarms and misses of every protocol with their causes, from rows alone.

    Args:
        data_name: Name of the data set, for the title.
        split: The split.
        records: Run records; those of other data sets or splits, or not judged by ``exact``, are left out.

    Returns:
        One row for each planner and protocol but ``exact``; causes that never occur have no column.
    """
    runs = [
        record
        for record in sort_for_tables(records)
        if record.run.data.name == data_name and record.run.split == split and EXACT in record.run.protocols
    ]
    rows = [
        RunRow(record, protocol, confusion)
        for record in runs
        for protocol, confusion in compare_protocols(record).items()
    ]
    shown_causes = [cause for cause in CAUSES if any(row.found.causes and row.found.causes[cause] for row in rows)]
    columns = [
        *text_columns("planner", "protocol"),
        *group_columns(
            "samples, exact and the row's protocol",
            number_columns("samples", "exact +", "official +", "misses", "false alarms"),
        ),
        *group_columns(
            "causes, the row's protocol against exact",
            number_columns(*(_shorten_cause(cause) for cause in shown_causes)),
        ),
        *group_columns(
            "steps, exact and the row's protocol", number_columns("mask took", "step misses", "step false alarms")
        ),
    ]
    title = f"{format_title(data_name, split)}: misses and false alarms of each protocol, measured by exact"
    brief = ("planner", "protocol", "samples", "misses", "false alarms", "mask took")
    return tabulate(f"disagreement-{split}", title, columns, map(_values, rows), _notes(runs, rows), brief=brief)


def disagreement_tables(frame: DataSetRuns) -> list[Table]:
    """`disagreement_table` of each split on which anything compares."""
    tables = (disagreement_table(frame.data_name, split, frame.runs) for split in frame.splits)
    return [table for table in tables if table.rows]


def _values(row: _DisagreementRow) -> Values:
    origin, confusion = ValueSource(f"{row.judge} against {EXACT}", join_record_names(row.record)), row.found
    samples, removed = confusion.samples, origin.count(confusion.mask_removed_steps, "steps", confusion.steps.compared)
    both = {"samples": samples.compared, "exact +": samples.exact, "official +": samples.official}
    counts = both | {
        _shorten_cause(cause): None if confusion.causes is None else confusion.causes[cause] for cause in CAUSES
    }
    return {
        "planner": row_name(row.record, EXACT),
        "protocol": f"{row.judge} {STALE_MARK}" if row.judge in row.record.stale_protocols else row.judge,
        **{head: origin.count(count, "samples", samples.compared) for head, count in counts.items()},
        **_error_values(origin, samples, "samples", ""),
        "mask took": removed.shown(after=f" ({confusion.samples_with_removed_steps})"),
        **_error_values(origin, confusion.steps, "steps", "step "),
    }


def _error_values(origin: ValueSource, confusion: Confusion, of: str, before: str) -> dict[str, TableCell]:
    missed = origin.count(confusion.missed, of, confusion.exact)
    false_alarms = origin.count(confusion.false_alarms, of, confusion.official)
    return {
        f"{before}misses": missed.shown(after=_format_share(confusion.missed_share)),
        f"{before}false alarms": false_alarms.shown(after=_format_share(confusion.false_share)),
    }


def _format_share(share: float | None) -> str:
    return f" ({format_number(None if share is None else 100 * share, 1)})"


def _shorten_cause(cause: str) -> str:
    kind, _, counterfactual = cause.partition(": ")
    return f"{kind.partition(' ')[0]}: {_SHORT[counterfactual]}"


def _notes(runs: Sequence[RunRecord], rows: Sequence[_DisagreementRow]) -> tuple[str, ...]:
    notes = [
        "A sample is positive if the plan collides at any time within 3 s; exact checks all objects at all times, and "
        "the official verdict is the one after the protocol's mask. Only samples that both count are used. Brackets: "
        "% of exact + for misses, of official + for false alarms.",
        "Causes (docs/footguns.md): "
        f"{', '.join(f'{_SHORT[counterfactual]} = {counterfactual}' for counterfactual in COUNTERFACTUALS[:5])}.",
        "Mask took: steps (and samples with such steps) that a protocol drops because, by its rule, the recorded ego "
        "collides there too. Steps: the verdicts at the six waypoints, where exact checks only the waypoint.",
    ]
    unknown = sorted({f"{row.record.planner} ({row.judge})" for row in rows if row.found.causes is None})
    if unknown:
        notes.append(
            f"No causes in the records of {', '.join(unknown)}; challenger-bench rescore finds them with the data set."
        )
    notes += list_run_marks(runs)
    for record in runs:
        notes += stale_notes(record, sorted(record.run.protocols))
    return (*notes, *completeness_notes(runs))
