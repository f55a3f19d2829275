"""How far consecutive plans of each planner disagree about the same place and time."""

from collections.abc import Sequence

from benchmark.metrics.consistency import INSTANTS, MEAN, consistency
from benchmark.records.run import RunRecord
from benchmark.report.cells import Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.rows import in_table_order, name_cell, run_notes


def consistency_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Distances between consecutive plans, from rows alone.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set.

    Returns:
        One row per planner and split, or ``None`` where no two consecutive samples have plans.
    """
    found = [(record, consistency(record)) for record in in_table_order(records)]
    shown = [(record, one) for record, one in found if one.pairs]
    if not shown:
        return None
    title = f"{data_name}: how far consecutive plans disagree about the same place and time (m)"
    told = [
        f"{record.planner} on {record.run.split}: {one.without} pairs are left out because a plan is missing."
        for record, one in shown
        if one.without
    ]
    notes = (
        "Two plans half a second apart, the recorded motion between them taken out: distance at the same instants, by "
        "seconds after the later one. Brackets: 95 % bootstrap interval over recorded scenes. 0: one fixed path is "
        "followed. Who changes a plan for a good reason is not told from who dithers.",
        *run_notes([record for record, _ in shown], told),
    )
    columns = ("planner", "split", MEAN, f"95 % of {MEAN}", *(f"after {instant}" for instant in INSTANTS), "pairs")
    rows: list[tuple[str | Shown, ...]] = []
    for record, one in shown:
        origin, planner = origin_of(record, None), record.run.planner
        cells = {name: origin.amount(rate, "m", "pairs") for name, rate in one.distances.items()}
        rows.append(
            (
                name_cell(record.planner, privileged=planner.privileged, miniature=planner.miniature),
                record.run.split,
                cells[MEAN].shown(2),
                cells[MEAN].interval(),
                *(cells[instant].shown(2) for instant in INSTANTS),
                origin.count(one.pairs, "pairs", one.pairs + one.without).shown(),
            )
        )
    return table_of(
        "consistency",
        title,
        columns,
        rows,
        notes=notes,
        brief=Brief(title, (0, 1, 2, 3, len(columns) - 1), notes, text_columns=2),
        text_columns=2,
        groups=(("", 2), ("distance in m", 2 + len(INSTANTS)), ("counted", 1)),
    )
