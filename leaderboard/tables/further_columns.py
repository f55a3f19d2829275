"""Rates of a protocol that are no collision rates of its table: at the kerb, off the road, other averages."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.rates import HORIZONS
from benchmark.records.run import RunRecord
from benchmark.report.cells import Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.rows import in_table_order, row_name, run_notes, stale_notes


@dataclass(frozen=True, slots=True)
class FurtherColumn:
    """A column of a summary that has a place of its own in tables.

    Attributes:
        name: In the summary.
        head: In the table.
        says: What it is.
    """

    name: str
    head: str
    says: str


COLUMNS: Final = (
    FurtherColumn("kerb", "kerb", "Kerb: any contact with the edge of the road up to there, after the mask."),
    FurtherColumn("kerb_before_mask", "kerb before mask", "Before mask: the same whatever the recorded ego does."),
    FurtherColumn(
        "kerb_point",
        "point on kerb",
        "Point on kerb: mean over the steps up to there, of the point below the waypoint.",
    ),
    FurtherColumn("off_road", "off road", "Off road: any step up to there with a cell that is not drivable."),
    FurtherColumn("collision_mean", "col. mean", "col. mean: mean of the same flags over the steps up to there."),
)
"""Each is one average and never another: no column here is comparable with one beside it."""


def further_table(data_name: str, protocol: str, records: Sequence[RunRecord]) -> Table | None:
    """Rates of a protocol beside its collision rates.

    Args:
        data_name: Name of the data set, for the title.
        protocol: The protocol.
        records: Runs on this data set.

    Returns:
        One row per planner and split, or ``None`` where the protocol has no such columns or nobody was judged by it.
    """
    runs = [record for record in in_table_order(records) if protocol in record.summary.protocols]
    there = {name for record in runs for name in record.summary.protocols[protocol].columns}
    columns = [column for column in COLUMNS if column.name in there]
    if not columns:
        return None
    title = f"{data_name}: further rates (%), protocol {protocol}"
    heads = [f"{column.head} {horizon}" for column in columns for horizon in HORIZONS]
    intervals = [f"95 % of {column.head}" for column in columns]
    averages = [2 + 4 * place + 3 for place in range(len(columns))]
    told = [note for record in runs for note in stale_notes(record, (protocol,))]
    notes = (*(column.says for column in columns), *run_notes(runs, told))
    return table_of(
        f"further-{protocol}",
        title,
        ("planner", "split", *heads, *intervals),
        [_row(record, protocol, columns) for record in runs],
        notes=notes,
        brief=Brief(title, (0, 1, *averages), notes, text_columns=2),
        text_columns=2,
        groups=(
            ("", 2),
            *((f"{column.head} in %, {protocol}", len(HORIZONS)) for column in columns),
            (f"intervals of the averages, {protocol}", len(columns)),
        ),
    )


def _row(record: RunRecord, protocol: str, columns: Sequence[FurtherColumn]) -> tuple[str | Shown, ...]:
    origin, summary = origin_of(record, protocol), record.summary.protocols[protocol]
    cells = [
        {horizon: origin.percent(rate) for horizon, rate in summary.columns[column.name].items()} for column in columns
    ]
    return (
        row_name(record, protocol),
        record.run.split,
        *(of_column[horizon].shown(2) for of_column in cells for horizon in HORIZONS),
        *(of_column["avg"].interval() for of_column in cells),
    )
