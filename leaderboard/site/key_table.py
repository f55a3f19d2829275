"""The table of the site's first page: each planner's average on every split, and how adversaries raise it."""

from collections.abc import Collection, Sequence
from typing import Final

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import attributes, effect_of
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlannerFacts
from benchmark.report.cells import MINIATURE_WORDS, PERCENT, UNDEFINED, Cell, Origin, record_name
from benchmark.report.table import Table
from leaderboard.tables.collision import collision_table
from leaderboard.tables.rows import PRIVILEGED_NOTE, in_table_order, marked, splits_of

AVERAGE, INTERVAL, INCREASE = "col. avg", "95 % of avg", "increase"
"""Columns of the table of collision rates that are taken over."""
NOTES: Final = (
    "Average of the collision rates at 1, 2 and 3 s in per cent, protocol exact; brackets: 95 % bootstrap interval "
    "over recorded scenes.",
    "Increase: (adv − val) / val of the averages, as the paper computes it.",
)
_ADVERSARY_NOTE: Final = (
    "Adversary: average of the rates of samples that touch the adversary first, every recording weighing once "
    f"(docs/metrics.md); {UNDEFINED}: not said of whom, until challenger-bench rescore. Anybody: of all collisions."
)


def key_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Averages with their intervals under ``exact``, a row a planner; contacts with the adversary first, where one is.

    Args:
        data_name: Name of a data set.
        records: Run records of any data sets, at most one for each data set, split and planner.

    Returns:
        The table, or ``None`` where nothing of the data set was judged by ``exact``.
    """
    runs = [
        record
        for record in in_table_order(records)
        if record.run.data.name == data_name and EXACT in record.summary.protocols
    ]
    if not runs:
        return None
    whole, splits = collision_table(data_name, EXACT, runs), splits_of(runs)
    found = {(run.planner, run.run.split): row for row, run in enumerate(runs)}
    planners = {run.planner: run.run.planner for run in runs}
    adversarial = {run.run.split for run in runs if attributes(run)}
    rows: list[tuple[str, ...]] = []
    cells: list[tuple[Cell | None, ...]] = []
    for name, facts in planners.items():
        taken: list[tuple[str, Cell | None]] = []
        for split in splits:
            row = found.get((name, split))
            taken += [_adversary(None if row is None else runs[row])] if split in adversarial else []
            taken += [_taken(whole, row, column) for column in (AVERAGE, INTERVAL)]
        taken += [_taken(whole, found.get((name, "adv")), INCREASE)] if "adv" in splits else []
        shown = marked(name, privileged=facts.privileged, miniature=facts.miniature)
        rows.append((shown, *(text for text, _ in taken)))
        cells.append((None, *(cell for _, cell in taken)))
    increase = ("increase",) if "adv" in splits else ()
    heads = {
        split: ("adversary", "anybody", "95 %") if split in adversarial else ("average", "95 %") for split in splits
    }
    notes = _notes(planners.values(), bool(increase))
    return Table(
        "key",
        f"{data_name}: how often plans collide (%), protocol exact",
        ("planner", *(head for split in splits for head in heads[split]), *increase),
        tuple(rows),
        (_ADVERSARY_NOTE, *notes) if adversarial else notes,
        1,
        (("", 1), *((split, len(heads[split])) for split in splits), *((("", 1),) if increase else ())),
        tuple(cells),
    )


def _adversary(record: RunRecord | None) -> tuple[str, Cell | None]:
    """Average rate of samples that touch the adversary first."""
    effect = None if record is None or EXACT in record.stale_protocols else effect_of(record, None)
    if effect is None or effect.touched is None:
        return UNDEFINED, None
    rate = Origin(EXACT, record_name(effect.record)).cell(effect.touched[3], PERCENT, effect.samples, scale=100.0)
    return rate.shown(2).text, rate


def _taken(table: Table, row: int | None, column: str) -> tuple[str, Cell | None]:
    if row is None:
        return UNDEFINED, None
    place = table.columns.index(column)
    return table.rows[row][place], None if table.cells is None else table.cells[row][place]


def _notes(planners: Collection[PlannerFacts], increase: bool) -> tuple[str, ...]:
    return (
        *(NOTES if increase else NOTES[:1]),
        *((PRIVILEGED_NOTE,) if any(planner.privileged for planner in planners) else ()),
        *((f"{MINIATURE_WORDS}.",) if any(planner.miniature for planner in planners) else ()),
    )
