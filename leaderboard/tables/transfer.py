"""Transfer tables: who else fails the scenes that one planner fails, and how far that is more than chance."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import knows_contact_partners
from benchmark.metrics.rates import Estimate, Rate
from benchmark.metrics.scores import require_current
from benchmark.metrics.transfer import Agreement, TransferMatrix, transfer
from benchmark.records.planner_versions import label_versions
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol
from benchmark.report.cells import UNDEFINED, CellSource, TableCell, ValueSource, format_interval, format_record_name
from benchmark.report.table import Table
from benchmark.report.words import format_title, pluralise
from leaderboard.frame.rows import (
    FEW_NOTE,
    FEW_SCENES,
    describe_split_part,
    mark_notes,
    mark_planner_name,
    name_judge,
    sort_for_tables,
)
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import (
    Value,
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    numbered_columns,
    tabulate,
    text_columns,
)


def transfer_matrices(
    records: Sequence[RunRecord],
    split: str,
    *,
    protocol: str = EXACT,
    data: str | None = None,
    adversary_only: bool = False,
) -> dict[str, TransferMatrix]:
    """Transfer matrices of a split from all given records; those of a part of the split are left out.

    Args:
        records: Of any planners, splits and data sets.
        split: The split.
        protocol: Protocol of the verdicts; ``native`` uses that of each planner's own repository.
        data: Only the data set of this name.
        adversary_only: Whether only first contacts with an adversary fail a scene.

    Returns:
        A matrix for each data set that has records of the whole split, by its name; planners in the order of tables.

    Raises:
        InputError: If records of one data set cannot be compared (`benchmark.metrics.transfer.transfer`).
    """
    of_split = [record for record in label_versions(records) if record.run.split == split and record.covers_split]
    return {
        name: transfer(
            sort_for_tables([run for run in of_split if run.run.data.name == name]),
            protocol=protocol,
            adversary_only=adversary_only,
        )
        for name in sorted({record.run.data.name for record in of_split})
        if data in (None, name)
    }


def build_both_matrices(records: Sequence[RunRecord], protocol: str) -> list[TransferMatrix]:
    """The paper's matrix and, under ``exact``, that of contacts with the adversary, if two records name contacts."""
    matrices = [transfer(records, protocol=protocol)]
    telling = [record for record in records if knows_contact_partners(record)]
    if protocol == EXACT and len(telling) > 1 and any(map(has_adversaries, telling)):
        matrices.append(transfer(telling, adversary_only=True))
    return matrices


def build_frame_matrices(frame: DataSetRuns, protocol: str, split: str) -> tuple[list[TransferMatrix], list[str]]:
    """`build_both_matrices` of at least two planners on the whole split, and sentences on those who are left out."""
    complete, refused = [], []
    for record in frame.runs:
        if record.run.split != split:
            continue
        if not record.covers_split:
            ran = describe_split_part(len(record.run.scenes), record.run.scenes_in_split)
            refused.append(f"Left out: {record.planner} ran on {ran}.")
            continue
        try:
            require_current(record, resolve_protocol(record, protocol))
        except InputError as refusal:
            refused.append(f"Left out: {refusal}.")
            continue
        complete.append(record)
    return (build_both_matrices(complete, protocol) if len(complete) > 1 else []), refused


def transfer_tables(frame: DataSetRuns, protocol: str, split: str) -> list[Table]:
    """Tables of each of `build_frame_matrices`: one of shares and one of lift and φ."""
    matrices, refused = frame.once(build_frame_matrices, protocol, split)
    tables = [make(frame.data_name, matrix) for matrix in matrices for make in (transfer_table, lift_table)]
    return [replace(table, notes=(*table.notes, *refused)) for table in tables]


def transfer_table(data_name: str, matrix: TransferMatrix) -> Table:
    """The transfer matrix with its counts.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.metrics.transfer.transfer`.

    Returns:
        One row per surrogate; cells are percentages with their interval and ``victim fails / surrogate fails``.
    """
    names = format_planner_names(matrix)
    rows: list[Values] = []
    for own, (surrogate, cells) in enumerate(zip(names, matrix.cells)):
        failed = _find_origin(matrix, own).count(round(cells[own].numerator), "scenes")
        shares = {
            f"#{victim}": _share_cell(cell, _find_origin(matrix, own, victim))
            for victim, cell in enumerate(cells)
            if victim != own
        }
        name = TableCell(surrogate, miniature=matrix.miniatures[own])
        rows.append({"surrogate": name, "its failed scenes": failed, **shares})
    rates = {
        f"#{victim}": _share_cell(rate, _find_origin(matrix, victim)) for victim, rate in enumerate(matrix.base_rates)
    }
    run_notes = _list_run_notes(matrix)
    columns = [
        *text_columns("surrogate"),
        *group_columns(f"surrogate, {_describe_failures(matrix)}", number_columns("its failed scenes")),
        *group_columns(f"failed by the victim in %, {_describe_failures(matrix)}", numbered_columns(names)),
    ]
    return tabulate(
        *name_transfer(data_name, matrix),
        columns,
        [*rows, {"surrogate": "all scenes", **rates}],
        (
            "Cell: share of the surrogate's failed scenes that the victim (column) fails too, with counts and the 95 % "
            "bootstrap interval over recorded scenes. "
            f"{UNDEFINED}: the diagonal (100 by construction), or undefined because the surrogate fails no scene.",
            f"A scene fails a planner if {_FAILS[matrix.adversary_only]}. Last row: the victim's failure rate over "
            "all scenes; transfer is what exceeds it.",
            *run_notes,
        ),
        brief_notes=(
            "Cell: share of the surrogate's failed scenes that the victim (column) fails too, with counts; last row: "
            "its failure rate over all scenes.",
            *run_notes,
        ),
    )


def describe_single(data_name: str, matrix: TransferMatrix) -> str:
    """Sentence on the matrix of one planner, which has nothing to compare it with."""
    (name,), (rate,) = format_planner_names(matrix), matrix.base_rates
    return (
        f"{format_title(data_name, matrix.split)}, {name_judge(matrix.protocol)}: {name} fails {round(rate.numerator)} "
        f"of {pluralise(rate.denominator, 'scene')}; records of other planners tell who else does"
    )


def agreement_table(data_name: str, matrix: TransferMatrix) -> Table:
    """Agreement of every two planners: failures on the same scenes beyond what their failure rates give.

    Args:
        data_name: Name of the data set, for the title.
        matrix: From `benchmark.metrics.transfer.transfer`.

    Returns:
        One row per pair of planners: counts, phi with its interval, lift.
    """
    columns = [
        *text_columns("first", "second"),
        *group_columns(
            f"scenes that fail, {_describe_failures(matrix)}",
            number_columns("both", "only first", "only second", "neither"),
        ),
        *group_columns(f"agreement, {_describe_failures(matrix)}", estimate_columns("φ", "lift", digits=2, ends=2)),
    ]
    _, title = name_lift(data_name, matrix)
    run_notes = _list_run_notes(matrix)
    return tabulate(
        f"agreement-{matrix.split}-{_name_contacts(matrix)}",
        title,
        columns,
        [_agreement_values(matrix, agreement) for agreement in matrix.agreements],
        (
            "φ: correlation of the two verdicts over the scenes with verdicts of both: 1 the same scenes, 0 as by "
            f"chance, below 0 other ones; {UNDEFINED} where one of them fails all or none.",
            "Lift: how many times more often they fail together than by chance. It is near 1 where both fail nearly "
            "everything, regardless of the transfer matrix.",
            *run_notes,
        ),
        brief_notes=run_notes,
    )


def lift_table(data_name: str, matrix: TransferMatrix) -> Table:
    """Lift of every two planners above the diagonal and phi below it, with intervals: transfer beyond failure rates."""
    names = format_planner_names(matrix)
    rows: list[dict[str, Value]] = [
        {
            "planner": TableCell(name, miniature=matrix.miniatures[own]),
            "fails %": _find_origin(matrix, own).percent(matrix.base_rates[own], "scenes"),
        }
        for own, name in enumerate(names)
    ]
    for agreement in matrix.agreements:
        first, second = (matrix.planners.index(name) for name in agreement.planners)
        origin, scenes = _find_origin(matrix, first, second), agreement.scenes
        lift = Estimate(agreement.lift, agreement.lift_low, agreement.lift_high)
        for row, column, estimate, unit in ((first, second, lift, "×"), (second, first, agreement.phi, "φ")):
            cell = origin.cell(estimate.value, unit, scenes, "scenes", low=estimate.low, high=estimate.high)
            rows[row][f"#{column}"] = cell.shown(1, after=_format_interval(cell, 1))
    run_notes = _list_run_notes(matrix)
    columns = [
        *text_columns("planner"),
        *group_columns(f"scenes in %, {_describe_failures(matrix)}", number_columns("fails %")),
        *group_columns(f"lift and φ, {_describe_failures(matrix)}", numbered_columns(names)),
    ]
    return tabulate(
        *name_lift(data_name, matrix),
        columns,
        rows,
        (
            "Above the diagonal: lift, how many times more often both fail a scene than their failure rates give by "
            "chance (1: as by chance). Below it: φ, the correlation of the two verdicts (0: as by chance). Brackets: "
            f"95 % bootstrap interval over recorded scenes. {UNDEFINED}: one of them fails all scenes, or none.",
            f"A scene fails a planner if {_FAILS[matrix.adversary_only]}.",
            *run_notes,
        ),
        brief_notes=("Above the diagonal: lift (1: as by chance). Below it: φ (0: as by chance).", *run_notes),
    )


def name_transfer(data_name: str, matrix: TransferMatrix) -> tuple[str, str]:
    """Name and title of what shows a matrix."""
    failures = "contacts with the adversary" if matrix.adversary_only else "failures"
    title = f"{format_title(data_name, matrix.split)}: transfer of {failures} (%), {name_judge(matrix.protocol)}"
    return f"transfer-{matrix.split}-{_name_contacts(matrix)}", title


def name_lift(data_name: str, matrix: TransferMatrix) -> tuple[str, str]:
    """Name and title of what shows lift and φ of a matrix."""
    by = " by contacts with the adversary" if matrix.adversary_only else ""
    about = f"agreement of planners on failed scenes{by}, {name_judge(matrix.protocol)}"
    title = f"{format_title(data_name, matrix.split)}: {about}"
    return f"lift-{matrix.split}-{_name_contacts(matrix)}", title


def _name_contacts(matrix: TransferMatrix) -> str:
    """Part of the names of a matrix's files: which contacts count."""
    return "adversary" if matrix.adversary_only else matrix.protocol


_FAILS: Final = {
    False: "any counted sample of it collides with any object",
    True: "the first contact of any counted sample is with the adversary",
}


def format_planner_names(matrix: TransferMatrix) -> list[str]:
    """Names as they are shown: with their marks, and the judge where judges differ."""
    judged = matrix.protocol == NATIVE
    return [
        f"{mark_planner_name(name, privileged=privileged, miniature=small)}{f' ({judge})' if judged else ''}"
        for name, privileged, small, judge in zip(matrix.planners, matrix.privileged, matrix.miniatures, matrix.judges)
    ]


def _list_run_notes(matrix: TransferMatrix) -> list[str]:
    """Notes that the rows of a matrix need: scenes without a verdict, few scenes, marks, plans of files."""
    undecided = [
        f"{planner}: no verdict on {pluralise(len(scenes), 'scene')} ({', '.join(scenes[:3])}"
        f"{', …' if len(scenes) > 3 else ''}), left out of the rates."
        for planner, scenes in zip(matrix.planners, matrix.undecided)
        if scenes
    ]
    few = [FEW_NOTE] if matrix.recordings < FEW_SCENES else []
    marks = mark_notes(privileged=any(matrix.privileged), miniature=any(matrix.miniatures))
    return [*undecided, *few, *marks, *matrix.file_notes]


def _describe_failures(matrix: TransferMatrix) -> str:
    return "own protocols" if matrix.protocol == NATIVE else matrix.protocol


def _find_origin(matrix: TransferMatrix, *planners: int) -> ValueSource:
    """Origin of numbers of some planners, by their places in the matrix."""
    judged = " and ".join(dict.fromkeys(matrix.judges[place] for place in planners))
    records = (format_record_name(matrix.records[place], matrix.planners[place], matrix.split) for place in planners)
    return ValueSource(judged, "; ".join(records))


def _share_cell(rate: Rate, origin: ValueSource) -> TableCell:
    cell = origin.percent(rate, "scenes")
    return cell.shown(0, after=f"{_format_interval(cell, 0)} ({round(rate.numerator)}/{rate.denominator})")


def _format_interval(cell: CellSource, digits: int) -> str:
    ends = format_interval(cell.low, cell.high, digits=digits)
    return "" if ends == UNDEFINED else f" {ends}"


def _agreement_values(matrix: TransferMatrix, agreement: Agreement) -> Values:
    places = [matrix.planners.index(name) for name in agreement.planners]
    names, origin = format_planner_names(matrix), _find_origin(matrix, *places)
    counts = {"both": agreement.both, "only first": agreement.only_first, "only second": agreement.only_second}
    counts |= {"neither": agreement.neither}
    among = sum(counts.values())
    return {
        **{
            head: TableCell(names[at], miniature=matrix.miniatures[at]) for head, at in zip(("first", "second"), places)
        },
        **{head: origin.count(count, "scenes", among) for head, count in counts.items()},
        "φ": origin.cell(agreement.phi.value, "φ", among, "scenes", low=agreement.phi.low, high=agreement.phi.high),
        "lift": origin.cell(agreement.lift, "×", among, "scenes", low=agreement.lift_low, high=agreement.lift_high),
    }
