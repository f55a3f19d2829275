"""What plans that go on beyond 3 s come to at 4, 5 and 6 s."""

from collections.abc import Sequence

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.longer_plans import HORIZONS, longer_rates
from benchmark.records.run import RunRecord
from benchmark.report.cells import Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.rows import in_table_order, row_name, run_notes, stale_notes


def longer_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Collision rates and L2 beyond 3 s.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set.

    Returns:
        One row per planner and split with plans that reach 4 s, or ``None`` where there are none.
    """
    found = [(record, longer_rates(record)) for record in in_table_order(records)]
    rows: list[tuple[str | Shown, ...]] = []
    runs = []
    for record, rates in found:
        if rates is None:
            continue
        origin = origin_of(record, EXACT)
        collision = {horizon: origin.percent(rate) for horizon, rate in rates.collision.items()}
        runs.append(record)
        rows.append(
            (
                row_name(record, EXACT),
                record.run.split,
                *(collision[horizon].shown(2) for horizon in HORIZONS),
                *(collision[horizon].interval() for horizon in HORIZONS),
                *(origin.amount(rates.l2[horizon], "m").shown(2) for horizon in HORIZONS),
                *(
                    origin.count(rates.collision[horizon].denominator, "samples", record.summary.samples).shown()
                    for horizon in HORIZONS
                ),
            )
        )
    if not rows:
        return None
    title = f"{data_name}: collision rate (%) and L2 (m) of plans beyond 3 s, protocol {EXACT}"
    notes = (
        "Any contact up to the horizon, and displacement there, of plans and recordings that both reach it: the "
        "horizons are not counted over the same samples. No official protocol judges beyond 3 s.",
        *run_notes(runs, [note for record in runs for note in stale_notes(record, (EXACT,))]),
    )
    return table_of(
        "longer-plans",
        title,
        (
            *("planner", "split"),
            *(f"col. {horizon}" for horizon in HORIZONS),
            *(f"95 % of {horizon}" for horizon in HORIZONS),
            *(f"L2 {horizon}" for horizon in HORIZONS),
            *(f"samples {horizon}" for horizon in HORIZONS),
        ),
        rows,
        notes=notes,
        brief=Brief(title, (0, 1, 2, 3, 4, 11), notes, text_columns=2),
        text_columns=2,
        groups=(
            ("", 2),
            (f"collision rate in %, {EXACT}", 3),
            (f"intervals, {EXACT}", 3),
            (f"L2 in m, {EXACT}", 3),
            (f"counted, {EXACT}", 3),
        ),
    )
