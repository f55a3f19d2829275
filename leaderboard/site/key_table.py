"""The table of the site's first page: each planner's average on every split, and what adversaries cause."""

from collections.abc import Collection, Sequence
from typing import Final

from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlannerFacts
from benchmark.report.cells import MINIATURE_WORDS, UNDEFINED, Cell
from benchmark.report.table import Table
from leaderboard.tables.collision import collision_table
from leaderboard.tables.effect import effect_table
from leaderboard.tables.rows import PRIVILEGED_NOTE, in_table_order, marked, splits_of

RATES: Final = {"average": "col. avg", "95 %": "95 % of avg"}
"""Columns here, and of the table of collision rates that they are taken from."""
EFFECT: Final = {"adversary": "adversary 3s", "difference": "difference", "95 %": "95 % of difference"}
"""The same of the table of the effect of adversaries."""
NOTES: Final = (
    "Average of the collision rates at 1, 2 and 3 s in per cent, protocol exact; brackets: 95 % bootstrap interval "
    "over recorded scenes.",
    "Adversary: samples of adv whose plan touches the adversary before anything else within 3 s. Difference: contacts "
    "with anything within 3 s, in points, beside the same recordings unchanged; its interval is over recordings.",
)


def key_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Averages with their intervals under ``exact``, a row a planner.

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
    whole, effect, splits = (
        collision_table(data_name, EXACT, runs),
        effect_table(data_name, runs, records),
        splits_of(runs),
    )
    found = {(run.planner, run.run.split): row for row, run in enumerate(runs)}
    caused = {run.planner: row for row, run in enumerate(filter(has_adversaries, runs)) if run.run.split == "adv"}
    planners = {run.planner: run.run.planner for run in runs}
    rows: list[tuple[str, ...]] = []
    cells: list[tuple[Cell | None, ...]] = []
    for name, facts in planners.items():
        taken = [_taken(whole, found.get((name, split)), column) for split in splits for column in RATES.values()]
        if effect is not None and caused:
            taken += [_taken(effect, caused.get(name), column) for column in EFFECT.values()]
        shown = marked(name, privileged=facts.privileged, miniature=facts.miniature)
        rows.append((shown, *(text for text, _ in taken)))
        cells.append((None, *(cell for _, cell in taken)))
    of_adversary = tuple(EFFECT) if effect is not None and caused else ()
    return Table(
        "key",
        f"{data_name}: how often plans collide (%), protocol exact",
        ("planner", *(head for _ in splits for head in RATES), *of_adversary),
        tuple(rows),
        _notes(planners.values(), bool(of_adversary)),
        1,
        (("", 1), *((split, 2) for split in splits), *((("effect of the adversary", 3),) if of_adversary else ())),
        tuple(cells),
    )


def _taken(table: Table, row: int | None, column: str) -> tuple[str, Cell | None]:
    if row is None:
        return UNDEFINED, None
    place = table.columns.index(column)
    return table.rows[row][place], None if table.cells is None else table.cells[row][place]


def _notes(planners: Collection[PlannerFacts], of_adversary: bool) -> tuple[str, ...]:
    return (
        *(NOTES if of_adversary else NOTES[:1]),
        *((PRIVILEGED_NOTE,) if any(planner.privileged for planner in planners) else ()),
        *((f"{MINIATURE_WORDS}.",) if any(planner.miniature for planner in planners) else ()),
    )
