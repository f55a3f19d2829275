"""Transfer tables: who else fails the scenes that one planner fails, and how far that is more than chance."""

from benchmark.rates import Rate
from benchmark.records import NATIVE
from benchmark.transfer import Agreement, TransferMatrix
from leaderboard.collision import FEW_NOTE, FEW_SCENES, PRIVILEGED_NOTE, judges, marked
from leaderboard.tables import UNDEFINED, Table, interval, number


def transfer_table(data_name: str, matrix: TransferMatrix) -> Table:
    """The transfer matrix with its counts.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.transfer.transfer`.

    Returns:
        One row per surrogate; cells are percentages with their interval and ``victim fails / surrogate fails``.
    """
    names = planner_names(matrix)
    rows = []
    for own, (surrogate, cells) in enumerate(zip(names, matrix.cells)):
        shown = [UNDEFINED if column == own else _cell(cell) for column, cell in enumerate(cells)]
        rows.append((surrogate, str(round(cells[own].numerator)), *shown))
    rows.append(("all scenes", UNDEFINED, *(_cell(rate) for rate in matrix.base_rates)))
    return Table(
        name=f"transfer-{matrix.split}-{matrix.protocol}",
        title=f"{data_name}, split {matrix.split}: transfer of failures (%), {judges(matrix.protocol)}",
        columns=("surrogate", "its failed scenes", *names),
        rows=tuple(rows),
        notes=(
            "Cell: share of the surrogate's failed scenes that the victim (column) fails too, with counts and the 95 % "
            "bootstrap interval over recorded scenes. "
            f"{UNDEFINED}: the diagonal (100 by construction), or undefined because the surrogate fails no scene.",
            "A scene fails a planner if any counted sample of it collides. Last row: the victim's failure rate over "
            "all scenes; transfer is what exceeds it.",
            *_undecided(matrix),
            *_common_notes(matrix),
        ),
    )


def agreement_table(data_name: str, matrix: TransferMatrix) -> Table:
    """How far two planners fail the same scenes beyond what their failure rates give.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.transfer.transfer`.

    Returns:
        One row per pair of planners: counts, phi with its interval, lift.
    """
    name_of = dict(zip(matrix.planners, planner_names(matrix)))
    return Table(
        name=f"agreement-{matrix.split}-{matrix.protocol}",
        title=f"{data_name}, split {matrix.split}: do planners fail the same scenes, {judges(matrix.protocol)}",
        columns=("first", "second", "both", "only first", "only second", "neither", "φ", "95 % of φ", "lift"),
        rows=tuple(_agreement_row(agreement, name_of) for agreement in matrix.agreements),
        notes=(
            "φ: correlation of the two verdicts over the scenes that both were judged on: 1 the same scenes, 0 as by "
            f"chance, below 0 other ones; {UNDEFINED} where one of them fails all or none.",
            "Lift: how many times more often they fail together than by chance. It is near 1 where both fail nearly "
            "everything, whatever the transfer matrix says.",
            *_undecided(matrix),
            *_common_notes(matrix),
        ),
        text_columns=2,
    )


def planner_names(matrix: TransferMatrix) -> list[str]:
    """Names as they are shown: with the mark of privileged planners, and the judge where judges differ."""
    judged = matrix.protocol == NATIVE
    return [
        f"{marked(name, privileged=seen)}{f' ({judge})' if judged else ''}"
        for name, seen, judge in zip(matrix.planners, matrix.privileged, matrix.judges)
    ]


def _undecided(matrix: TransferMatrix) -> list[str]:
    return [
        f"{planner}: no verdict on {len(scenes)} scenes ({', '.join(scenes[:3])}{', …' if len(scenes) > 3 else ''}); "
        "they are in no denominator."
        for planner, scenes in zip(matrix.planners, matrix.undecided)
        if scenes
    ]


def _common_notes(matrix: TransferMatrix) -> list[str]:
    few = [FEW_NOTE] if matrix.recordings < FEW_SCENES else []
    return [*few, *([PRIVILEGED_NOTE] if any(matrix.privileged) else [])]


def _cell(rate: Rate) -> str:
    if rate.value is None:
        return UNDEFINED
    ends = interval(rate.low, rate.high, scale=100.0, digits=0)
    shown = "" if ends == UNDEFINED else f" {ends}"
    return f"{100 * rate.value:.0f}{shown} ({round(rate.numerator)}/{rate.denominator})"


def _agreement_row(agreement: Agreement, name_of: dict[str, str]) -> tuple[str, ...]:
    phi = agreement.phi
    return (
        *(name_of[name] for name in agreement.planners),
        *(str(count) for count in (agreement.both, agreement.only_first, agreement.only_second, agreement.neither)),
        number(phi.value),
        interval(phi.low, phi.high, digits=2),
        number(agreement.lift),
    )
