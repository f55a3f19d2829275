"""The table of the site's first page: each planner's average on every split, and what adversaries cause."""

from typing import Final

from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.report.cells import MINIATURE_WORDS, Shown
from benchmark.report.table import Table
from leaderboard.frame.rows import PRIVILEGED_NOTE, name_cell, splits_of
from leaderboard.frame.runs import Frame
from leaderboard.frame.specification import Column, Value, numbers, tabulate, texts, under
from leaderboard.tables.collision import collision_table
from leaderboard.tables.effect import effect_table

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


def key_table(frame: Frame) -> Table | None:
    """Averages with their intervals under ``exact``, a row a planner; ``None`` where nothing was judged by it."""
    judged = [row.record for row in frame.judged(EXACT)]
    if not judged:
        return None
    whole, effect = frame.once(collision_table, EXACT), frame.once(effect_table)
    found = {(run.planner, run.run.split): row for row, run in enumerate(judged)}
    attacked = enumerate(filter(has_adversaries, frame.runs))
    caused = {run.planner: row for row, run in attacked if run.run.split == "adv" and EXACT in run.summary.protocols}
    planners, splits = {run.planner: run.run.planner for run in judged}, splits_of(judged)
    of_adversary = EFFECT if effect is not None and caused else {}
    rows: list[dict[str, Value]] = []
    for name, facts in planners.items():
        rows.append({"planner": name_cell(name, facts).text})
        for split in splits:
            taken = {head: _taken(whole, found.get((name, split)), column) for head, column in RATES.items()}
            rows[-1] |= {f"{head} on {split}": value for head, value in taken.items()}
        if effect is not None:
            rows[-1] |= {head: _taken(effect, caused.get(name), column) for head, column in of_adversary.items()}
    columns = [
        *texts("planner"),
        *(Column(head, f"{head} on {split}", split) for split in splits for head in RATES),
        *under("effect of the adversary", numbers(*of_adversary)),
    ]
    notes = (
        *(NOTES if of_adversary else NOTES[:1]),
        *((PRIVILEGED_NOTE,) if any(facts.privileged for facts in planners.values()) else ()),
        *((f"{MINIATURE_WORDS}.",) if any(facts.miniature for facts in planners.values()) else ()),
    )
    return tabulate("key", f"{frame.data_name}: how often plans collide (%), protocol exact", columns, rows, notes)


def _taken(table: Table, row: int | None, column: str) -> Shown | None:
    """A cell of another table."""
    if row is None or table.cells is None:
        return None
    place = table.columns.index(column)
    return Shown(table.rows[row][place], table.cells[row][place])
