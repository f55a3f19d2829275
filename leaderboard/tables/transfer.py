"""Transfer tables: who else fails the scenes that one planner fails, and how far that is more than chance."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import says_whom
from benchmark.metrics.rates import Estimate, Rate
from benchmark.metrics.transfer import Agreement, TransferMatrix, transfer
from benchmark.records.planner_versions import labelled
from benchmark.records.run import NATIVE, RunRecord
from benchmark.report.cells import UNDEFINED, Origin, Shown, interval, named_record
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted, titled
from leaderboard.tables.rows import FEW_NOTE, FEW_SCENES, in_table_order, judges, mark_notes, marked


def transfer_matrices(
    records: Sequence[RunRecord],
    split: str,
    *,
    protocol: str = EXACT,
    data: str | None = None,
    adversary_only: bool = False,
) -> dict[str, TransferMatrix]:
    """Transfer matrices of a split from whatever records there are; those of a part of the split are left out.

    Args:
        records: Of any planners, splits and data sets.
        split: The split.
        protocol: Whose verdicts count; ``native`` takes those of each planner's own repository.
        data: Only the data set of this name.
        adversary_only: Whether only first contacts with an adversary fail a scene.

    Returns:
        A matrix for each data set that has records of the whole split, by its name; planners in the order of tables.

    Raises:
        InputError: If records of one data set cannot be compared (`benchmark.metrics.transfer.transfer`).
    """
    of_split = [record for record in labelled(records) if record.run.split == split and record.covers_split]
    return {
        name: transfer(
            in_table_order([each for each in of_split if each.run.data.name == name]),
            protocol=protocol,
            adversary_only=adversary_only,
        )
        for name in sorted({record.run.data.name for record in of_split})
        if data in (None, name)
    }


def both_matrices(records: Sequence[RunRecord], protocol: str) -> list[TransferMatrix]:
    """The paper's matrix and, under ``exact``, that of contacts with the adversary alone.

    Args:
        records: Of several planners on the same scenes.
        protocol: Whose verdicts count.

    Returns:
        One or two matrices: the second of the planners whose records say whom contacts are with, if two do.

    Raises:
        InputError: As `benchmark.metrics.transfer.transfer`.
    """
    found = [transfer(records, protocol=protocol)]
    telling = [record for record in records if says_whom(record)]
    if protocol == EXACT and len(telling) > 1 and any(map(has_adversaries, telling)):
        found.append(transfer(telling, adversary_only=True))
    return found


def transfer_table(data_name: str, matrix: TransferMatrix) -> Table:
    """The transfer matrix with its counts.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.metrics.transfer.transfer`.

    Returns:
        One row per surrogate; cells are percentages with their interval and ``victim fails / surrogate fails``.
    """
    names = planner_names(matrix)
    rows: list[tuple[str | Shown, ...]] = []
    for own, (surrogate, cells) in enumerate(zip(names, matrix.cells)):
        shown = [
            Shown(UNDEFINED) if victim == own else _cell(cell, _origin(matrix, own, victim))
            for victim, cell in enumerate(cells)
        ]
        failed = round(cells[own].numerator)
        rows.append(
            (
                Shown(surrogate, miniature=matrix.miniatures[own]),
                _origin(matrix, own).count(failed, "scenes").shown(),
                *shown,
            )
        )
    everywhere = (_cell(rate, _origin(matrix, victim)) for victim, rate in enumerate(matrix.base_rates))
    rows.append(("all scenes", UNDEFINED, *everywhere))
    return table_of(
        f"transfer-{matrix.split}-{_kind(matrix)}",
        f"{titled(data_name, matrix.split)}: transfer of {_failures(matrix)} (%), {judges(matrix.protocol)}",
        ("surrogate", "its failed scenes", *names),
        rows,
        notes=(
            "Cell: share of the surrogate's failed scenes that the victim (column) fails too, with counts and the 95 % "
            "bootstrap interval over recorded scenes. "
            f"{UNDEFINED}: the diagonal (100 by construction), or undefined because the surrogate fails no scene.",
            f"A scene fails a planner if {_FAILS[matrix.adversary_only]}. Last row: the victim's failure rate over "
            "all scenes; transfer is what exceeds it.",
            *_undecided(matrix),
            *_common_notes(matrix),
        ),
        groups=(("", 1), (f"surrogate, {_who(matrix)}", 1), (f"failed by the victim in %, {_who(matrix)}", len(names))),
    )


def agreement_table(data_name: str, matrix: TransferMatrix) -> Table:
    """How far two planners fail the same scenes beyond what their failure rates give.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.metrics.transfer.transfer`.

    Returns:
        One row per pair of planners: counts, phi with its interval, lift.
    """
    return table_of(
        f"agreement-{matrix.split}-{_kind(matrix)}",
        f"{titled(data_name, matrix.split)}: do planners fail the same scenes{_BY[matrix.adversary_only]}, "
        f"{judges(matrix.protocol)}",
        ("first", "second", "both", "only first", "only second", "neither", "φ", "95 % of φ", "lift", "95 % of lift"),
        [_agreement_row(matrix, agreement) for agreement in matrix.agreements],
        notes=(
            "φ: correlation of the two verdicts over the scenes that both were judged on: 1 the same scenes, 0 as by "
            f"chance, below 0 other ones; {UNDEFINED} where one of them fails all or none.",
            "Lift: how many times more often they fail together than by chance. It is near 1 where both fail nearly "
            "everything, whatever the transfer matrix says.",
            *_undecided(matrix),
            *_common_notes(matrix),
        ),
        text_columns=2,
        groups=(("", 2), (f"scenes that fail, {_who(matrix)}", 4), (f"agreement, {_who(matrix)}", 4)),
    )


def lift_table(data_name: str, matrix: TransferMatrix) -> Table:
    """How far failures transfer beyond what failure rates give: lift and phi of every two planners, as a matrix.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.metrics.transfer.transfer`.

    Returns:
        One row and one column per planner: lift with its interval above the diagonal, phi with its below it.
    """
    names = planner_names(matrix)
    cells: dict[tuple[int, int], Shown] = {}
    for agreement in matrix.agreements:
        first, second = (matrix.planners.index(name) for name in agreement.planners)
        origin, scenes = _origin(matrix, first, second), agreement.scenes
        lift = Estimate(agreement.lift, agreement.lift_low, agreement.lift_high)
        for place, found, unit in (((first, second), lift, "×"), ((second, first), agreement.phi, "φ")):
            cell = origin.cell(found.value, unit, scenes, "scenes", low=found.low, high=found.high)
            ends = interval(cell.low, cell.high, digits=1)
            cells[place] = cell.shown(1, after="" if ends == UNDEFINED else f" {ends}")
    rows = [
        (
            Shown(name, miniature=matrix.miniatures[own]),
            _origin(matrix, own).percent(matrix.base_rates[own], "scenes").shown(0),
            *(cells.get((own, other), Shown(UNDEFINED)) for other in range(len(names))),
        )
        for own, name in enumerate(names)
    ]
    return table_of(
        f"lift-{matrix.split}-{_kind(matrix)}",
        f"{titled(data_name, matrix.split)}: do planners fail the same scenes{_BY[matrix.adversary_only]}, "
        f"{judges(matrix.protocol)}",
        ("planner", "fails %", *names),
        rows,
        notes=(
            "Above the diagonal: lift, how many times more often both fail a scene than their failure rates give by "
            "chance (1: as by chance). Below it: φ, the correlation of the two verdicts (0: as by chance). Brackets: "
            f"95 % bootstrap interval over recorded scenes. {UNDEFINED}: one of them fails all scenes, or none.",
            f"A scene fails a planner if {_FAILS[matrix.adversary_only]}.",
            *_undecided(matrix),
            *_common_notes(matrix),
        ),
        groups=(("", 1), (f"scenes in %, {_who(matrix)}", 1), (f"lift and φ, {_who(matrix)}", len(names))),
    )


def _kind(matrix: TransferMatrix) -> str:
    """What files of a matrix are named after."""
    return "adversary" if matrix.adversary_only else matrix.protocol


def _failures(matrix: TransferMatrix) -> str:
    return "contacts with the adversary" if matrix.adversary_only else "failures"


_BY: Final = {False: "", True: " by contacts with the adversary"}
_FAILS: Final = {
    False: "any counted sample of it collides, whoever it is with",
    True: "the first contact of any counted sample is with the adversary",
}


def planner_names(matrix: TransferMatrix) -> list[str]:
    """Names as they are shown: with their marks, and the judge where judges differ."""
    judged = matrix.protocol == NATIVE
    return [
        f"{marked(name, privileged=seen, miniature=small)}{f' ({judge})' if judged else ''}"
        for name, seen, small, judge in zip(matrix.planners, matrix.privileged, matrix.miniatures, matrix.judges)
    ]


def _undecided(matrix: TransferMatrix) -> list[str]:
    return [
        f"{planner}: no verdict on {counted(len(scenes), 'scene')} ({', '.join(scenes[:3])}"
        f"{', …' if len(scenes) > 3 else ''}), in no denominator."
        for planner, scenes in zip(matrix.planners, matrix.undecided)
        if scenes
    ]


def _common_notes(matrix: TransferMatrix) -> list[str]:
    few = [FEW_NOTE] if matrix.recordings < FEW_SCENES else []
    marks = mark_notes(privileged=any(matrix.privileged), miniature=any(matrix.miniatures))
    return [*few, *marks, *matrix.file_notes]


def _who(matrix: TransferMatrix) -> str:
    return "own protocols" if matrix.protocol == NATIVE else matrix.protocol


def _origin(matrix: TransferMatrix, *planners: int) -> Origin:
    """Where numbers of some of the planners come from, by their places in the matrix."""
    judged = " and ".join(dict.fromkeys(matrix.judges[place] for place in planners))
    records = (named_record(matrix.records[place], matrix.planners[place], matrix.split) for place in planners)
    return Origin(judged, "; ".join(records))


def _cell(rate: Rate, origin: Origin) -> Shown:
    cell = origin.percent(rate, "scenes")
    ends = interval(cell.low, cell.high, digits=0)
    shown = "" if ends == UNDEFINED else f" {ends}"
    return cell.shown(0, after=f"{shown} ({round(rate.numerator)}/{rate.denominator})")


def _agreement_row(matrix: TransferMatrix, agreement: Agreement) -> tuple[str | Shown, ...]:
    places = [matrix.planners.index(name) for name in agreement.planners]
    names, origin = planner_names(matrix), _origin(matrix, *places)
    counts = (agreement.both, agreement.only_first, agreement.only_second, agreement.neither)
    phi = origin.cell(agreement.phi.value, "φ", sum(counts), "scenes", low=agreement.phi.low, high=agreement.phi.high)
    lift = origin.cell(agreement.lift, "×", sum(counts), "scenes", low=agreement.lift_low, high=agreement.lift_high)
    return (
        *(Shown(names[place], miniature=matrix.miniatures[place]) for place in places),
        *(origin.count(count, "scenes", sum(counts)).shown() for count in counts),
        phi.shown(2),
        phi.interval(2),
        lift.shown(2),
        lift.interval(2),
    )
