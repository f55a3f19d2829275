"""Rates of a protocol that are no collision rates of its table: at the kerb, off the road, other averages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from benchmark.metrics.rates import HORIZONS
from benchmark.records.run import NATIVE
from benchmark.report.cells import AnyRate
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns, RunRow, row_notes
from leaderboard.frame.specification import (
    Value,
    group_columns,
    interval_columns,
    number_columns,
    tabulate,
    text_columns,
)


@dataclass(frozen=True, slots=True)
class FurtherColumn:
    """A column of a summary that has a place of its own in tables."""

    name: str
    head: str
    says: str


COLUMNS: Final = (
    FurtherColumn("kerb", "kerb", "Kerb: any contact with the edge of the road up to this time, after the mask."),
    FurtherColumn("kerb_before_mask", "kerb before mask", "Before mask: the same, regardless of the recorded ego."),
    FurtherColumn(
        "kerb_point",
        "point on kerb",
        "Point on kerb: mean over the steps up to this time, for the point below the waypoint.",
    ),
    FurtherColumn("off_road", "off road", "Off road: any step up to this time with a cell that is not drivable."),
    FurtherColumn("collision_mean", "col. mean", "col. mean: mean of the same flags over the steps up to this time."),
)
"""Each is one average and never another: no column here is comparable with one beside it."""


def further_table(frame: DataSetRuns, protocol: str) -> Table | None:
    """Rates of a protocol beside its collision rates; ``None`` where it has no such columns, and under ``native``."""
    rows = [] if protocol == NATIVE else frame.judged(protocol)
    there = {name for row in rows for name in row.found.columns}
    further = [column for column in COLUMNS if column.name in there]
    if not further:
        return None
    heads = [column.head for column in further]
    columns = [
        *text_columns("planner", "split"),
        *(
            column
            for head in heads
            for column in group_columns(
                f"{head} in %, {protocol}", number_columns(*(f"{head} {horizon}" for horizon in HORIZONS), digits=2)
            )
        ),
        *group_columns(
            f"intervals of the averages, {protocol}",
            interval_columns({f"95 % of {head}": f"{head} avg" for head in heads}),
        ),
    ]
    return tabulate(
        f"further-{protocol}",
        f"{frame.data_name}: further rates (%), protocol {protocol}",
        columns,
        [row.names | further_values(row, further, row.found.columns) for row in rows],
        (*(column.says for column in further), *row_notes(rows)),
        brief=("planner", "split", *(f"{head} avg" for head in heads)),
    )


def further_values(
    row: RunRow[Any], further: Sequence[FurtherColumn], rates: Mapping[str, Mapping[str, AnyRate]]
) -> dict[str, Value]:
    """Values of a row in some of the columns, at every horizon."""
    column_values = [row.by_horizon(f"{column.head} {{}}", column.name, rates[column.name]) for column in further]
    return dict(item for values in column_values for item in values.items())
