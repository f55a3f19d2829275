"""What plans that go on beyond 3 s come to at 4, 5 and 6 s."""

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.longer_plans import HORIZONS, LongerRates, longer_rates
from benchmark.report.table import Table
from leaderboard.frame.runs import Frame, Row, row_notes
from leaderboard.frame.specification import Values, intervals, numbers, tabulate, texts, under

_COLLISIONS = [f"col. {horizon}" for horizon in HORIZONS]
_COLUMNS = [
    *texts("planner", "split"),
    *under(f"collision rate in %, {EXACT}", numbers(*_COLLISIONS, digits=2)),
    *under(f"intervals, {EXACT}", intervals({f"95 % of {horizon}": f"col. {horizon}" for horizon in HORIZONS})),
    *under(f"L2 in m, {EXACT}", numbers(*(f"L2 {horizon}" for horizon in HORIZONS), digits=2)),
    *under(f"counted, {EXACT}", numbers(*(f"samples {horizon}" for horizon in HORIZONS))),
]
_NOTE = (
    "Any contact up to the horizon, and displacement there, of plans and recordings that both reach it: the "
    "horizons are not counted over the same samples. No official protocol judges beyond 3 s."
)


def longer_table(frame: Frame) -> Table | None:
    """Collision rates and L2 beyond 3 s; ``None`` where no plan reaches 4 s."""
    rows = frame.rows(EXACT, longer_rates)
    if not rows:
        return None
    title = f"{frame.data_name}: collision rate (%) and L2 (m) of plans beyond 3 s, protocol {EXACT}"
    notes = (_NOTE, *row_notes(rows))
    brief = ("planner", "split", *_COLLISIONS, "samples 4s")
    return tabulate("longer-plans", title, _COLUMNS, map(_values, rows), notes, brief=brief)


def _values(row: Row[LongerRates]) -> Values:
    rates = row.found
    return {
        **row.names,
        **row.by_horizon("col. {}", "collision", rates.collision),
        **row.by_horizon("L2 {}", "l2", rates.l2),
        **{f"samples {horizon}": row.samples(rate.denominator) for horizon, rate in rates.collision.items()},
    }
