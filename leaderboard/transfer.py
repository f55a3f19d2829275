"""Transfer tables: who else fails the scenes that one planner fails."""

from benchmark.rates import Rate
from benchmark.transfer import TransferMatrix
from leaderboard.collision import PRIVILEGED_NOTE, marked
from leaderboard.tables import UNDEFINED, Table


def transfer_table(data_name: str, matrix: TransferMatrix) -> Table:
    """The transfer matrix with its counts.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.transfer.transfer`.

    Returns:
        One row per surrogate; cells are percentages with ``victim fails / surrogate fails``.
    """
    names = [marked(name, privileged=seen) for name, seen in zip(matrix.planners, matrix.privileged)]
    rows = []
    for own, (surrogate, cells) in enumerate(zip(names, matrix.cells)):
        shown = [UNDEFINED if column == own else _cell(cell) for column, cell in enumerate(cells)]
        rows.append((surrogate, str(round(cells[own].numerator)), *shown))
    rows.append(("all scenes", UNDEFINED, *(_cell(rate) for rate in matrix.base_rates)))
    undecided = [
        f"{planner}: no verdict on {len(scenes)} scenes ({', '.join(scenes[:3])}{', …' if len(scenes) > 3 else ''})."
        for planner, scenes in zip(matrix.planners, matrix.undecided)
        if scenes
    ]
    return Table(
        name=f"transfer-{matrix.split}-{matrix.protocol}",
        title=f"{data_name}, split {matrix.split}: transfer of failures (%), protocol {matrix.protocol}",
        columns=("surrogate", "its failed scenes", *names),
        rows=tuple(rows),
        notes=(
            "Cell: share of the surrogate's failed scenes that the victim (column) fails too, with counts. "
            f"{UNDEFINED}: the diagonal (100 by construction), or undefined because the surrogate fails no scene.",
            "A scene fails a planner if any counted sample of it collides. Last row: the victim's failure rate over "
            "all scenes; transfer is what exceeds it.",
            *undecided,
            *((PRIVILEGED_NOTE,) if any(matrix.privileged) else ()),
        ),
    )


def _cell(rate: Rate) -> str:
    if rate.value is None:
        return UNDEFINED
    return f"{100 * rate.value:.0f} ({round(rate.numerator)}/{rate.denominator})"
