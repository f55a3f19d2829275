"""Collision rates and displacements of longer plans at 4, 5 and 6 s."""

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.longer_plans import HORIZONS, LongerRates, compute_longer_rates
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns, RunRow, row_notes
from leaderboard.frame.specification import (
    Values,
    group_columns,
    interval_columns,
    number_columns,
    tabulate,
    text_columns,
)

_COLLISIONS = [f"col. {horizon}" for horizon in HORIZONS]
_COLUMNS = [
    *text_columns("planner", "split"),
    *group_columns(f"collision rate in %, {EXACT}", number_columns(*_COLLISIONS, digits=2)),
    *group_columns(
        f"intervals, {EXACT}", interval_columns({f"95 % of {horizon}": f"col. {horizon}" for horizon in HORIZONS})
    ),
    *group_columns(f"L2 in m, {EXACT}", number_columns(*(f"L2 {horizon}" for horizon in HORIZONS), digits=2)),
    *group_columns(f"counted, {EXACT}", number_columns(*(f"samples {horizon}" for horizon in HORIZONS))),
]
_NOTE = (
    "Any contact up to the horizon, and displacement there, of plans and recordings that both reach it: the "
    "horizons cover different samples. No official protocol goes beyond 3 s."
)


def longer_table(frame: DataSetRuns) -> Table | None:
    """Collision rates and L2 beyond 3 s; ``None`` where no plan reaches 4 s."""
    rows = frame.rows(EXACT, compute_longer_rates)
    if not rows:
        return None
    title = f"{frame.data_name}: collision rate (%) and L2 (m) of plans beyond 3 s, protocol {EXACT}"
    notes = (_NOTE, *row_notes(rows))
    brief = ("planner", "split", *_COLLISIONS, "samples 4s")
    return tabulate("longer-plans", title, _COLUMNS, map(_values, rows), notes, brief=brief)


def _values(row: RunRow[LongerRates]) -> Values:
    rates = row.found
    return {
        **row.names,
        **row.by_horizon("col. {}", "collision", rates.collision),
        **row.by_horizon("L2 {}", "l2", rates.l2),
        **{f"samples {horizon}": row.samples(rate.denominator) for horizon, rate in rates.collision.items()},
    }
