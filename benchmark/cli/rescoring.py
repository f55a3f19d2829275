"""Commands on what planners planned: ``rescore`` and ``transfer``."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, print_tables, repeat_out_option
from benchmark.cli.settings import Option, command
from benchmark.cli.splits import say_default_split
from benchmark.errors import InputError
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from benchmark.metrics.transfer import TransferMatrix
    from benchmark.records.run import RunRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class RescoreOptions:
    """Options of ``rescore``."""

    data: shared.Data = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    records: shared.Records = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(RescoreOptions, panel="Results")
def rescore_command(options: RescoreOptions) -> None:
    """Judge stored plans anew, of run records under every protocol and of drives, without running a planner."""
    from benchmark.machine.path_checks import require_folder
    from benchmark.runs.rescoring import rescore_all
    from benchmark.runs.rescoring_drives import rescore_all_drives

    place = api.workspace(options.out)
    folders = options.records or [root for root in (place.run_root(), place.drive_root()) if root.is_dir()]
    data = api.DataSource.of(options)
    data.require()
    for folder in options.records or ():
        require_folder(folder, "--records")
    if not folders:
        raise InputError(
            f"no evaluation records in {place.run_root()} and no drive records in {place.drive_root()}; run "
            "challenger-bench eval first, or challenger-bench drive"
        )
    source = data.open()
    opener = partial(data.open_split, source=source)
    results = [
        result
        for folder in folders
        for folder_results in (
            rescore_all(folder, opener, source.name),
            rescore_all_drives(folder, opener, source.name),
        )
        for result in folder_results
    ]
    if options.json_output:
        print_json([{"directory": str(result.directory), "says": result.sentence} for result in results])
    else:
        for result in results:
            typer.echo(f"{result.directory}: {result.sentence}")
    raise typer.Exit(1 if any(result.failed for result in results) else 0)


MapName = Literal["transfer", "adversary", "lift"]
"""Which picture of the transfer between planners."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferOptions:
    """Options of ``transfer``."""

    split: shared.Split = "adv"
    out: shared.Out = api.OUT
    records: shared.Records = None
    protocol: Annotated[str, Option("Whose verdicts count; native: of each planner's own.", "Output")] = "exact"
    data: Annotated[str | None, Option("Only records of the data set of this name.", "Input")] = None
    figure: Annotated[Path | None, Option("Write a heat map to this .png or .svg file.", "Output")] = None
    figure_of: Annotated[
        MapName,
        Option(
            "Of what: transfer of any failure, of contacts with the adversary, or lift and φ of the latter (of any "
            "failure where records do not say whom contacts are with).",
            "Output",
        ),
    ] = "transfer"
    pairs: Annotated[bool, Option("Also a row for every two planners.", "Output")] = False
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    json_output: shared.Json = False


@command(TransferOptions, panel="Results")
def transfer_command(options: TransferOptions) -> None:
    """Show who else fails the scenes that one planner fails: the surrogate-filtered matrix, from run records."""
    from benchmark.machine.path_checks import require_output_file
    from benchmark.machine.workspace import EMBEDDED, read_embedded_version
    from benchmark.metrics.disagreement import EXACT
    from benchmark.protocols import find_protocol as known_protocol
    from benchmark.records.run import NATIVE, find_records
    from benchmark.records.store import describe_recorded, list_recorded
    from benchmark.report.plots import FORMATS
    from leaderboard.figures.heat_map import write_heat_map, write_lift_map
    from leaderboard.tables.transfer import (
        agreement_table,
        describe_single,
        lift_table,
        transfer_matrices,
        transfer_table,
    )

    if options.protocol != NATIVE:
        known_protocol(options.protocol)
    require_output_file(options.figure, "--figure", FORMATS)
    folders = options.records or [api.workspace(options.out).run_root()]
    known = find_records(*folders)
    say_default_split(options.split)
    for record in known:
        if record.run.split == options.split and not record.covers_split:
            typer.echo(f"left out: {record.directory} covers only part of the split", err=True)
    matrices = transfer_matrices(known, options.split, protocol=options.protocol, data=options.data)
    if not matrices:
        of_data = "" if options.data is None else f" for data set {options.data!r}"
        raise InputError(
            f"no complete run records of split {options.split!r} below {', '.join(map(str, folders))}{of_data}; "
            f"{describe_recorded(list_recorded(folders))}; name one of these or run challenger-bench eval --split "
            f"{options.split} first"
        )
    if options.figure is not None:
        if len(matrices) > 1:
            raise InputError(f"--figure draws one matrix, not {', '.join(matrices)}; choose one with --data")
        ((name, drawn),) = matrices.items()
        of_adversary = _adversary_matrices(known, options.split, name) if options.protocol == EXACT else []
        if options.figure_of == "adversary" and not of_adversary:
            raise InputError(
                "--figure-of adversary needs two records, judged by exact, that name the other party of each contact; "
                "update older records with challenger-bench rescore"
            )
        drawn = drawn if options.figure_of == "transfer" else (*of_adversary, drawn)[0]
        (write_lift_map if options.figure_of == "lift" else write_heat_map)(drawn, options.figure)
    if options.json_output:
        print_json(
            {
                name: {
                    **asdict(matrix),
                    "adversary": [
                        asdict(shown_matrix) for shown_matrix in _adversary_matrices(known, options.split, name)
                    ]
                    if options.protocol == EXACT
                    else [],
                }
                for name, matrix in matrices.items()
            }
        )
        return
    make = (transfer_table, lift_table, *([agreement_table] if options.pairs else []))
    compared = {name: matrix for name, matrix in matrices.items() if len(matrix.planners) > 1}
    shown = [
        (name, shown_matrix)
        for name, matrix in compared.items()
        for shown_matrix in (
            matrix,
            *(_adversary_matrices(known, options.split, name) if options.protocol == EXACT else ()),
        )
    ]
    tables = [table_of(name, matrix) for name, matrix in shown for table_of in make]
    print_tables(tables, wide=options.wide, verbose=options.verbose)
    for name, matrix in matrices.items():
        if name not in compared:
            given = "ROOT" if read_embedded_version(name) is None else None if name == EMBEDDED else name
            data = format_options(data=given, split=options.split, model="NAME")
            typer.echo(f"{describe_single(name, matrix)}: challenger-bench eval{data}{repeat_out_option(options.out)}")


def _adversary_matrices(known: "Sequence[RunRecord]", split: str, data: str) -> "list[TransferMatrix]":
    """The matrix of contacts with the adversary alone, where the records say whom contacts are with."""
    from benchmark.metrics.effect import knows_contact_partners
    from leaderboard.tables.transfer import transfer_matrices

    telling = [record for record in known if record.run.split != split or knows_contact_partners(record)]
    matrices = transfer_matrices(telling, split, data=data, adversary_only=True)
    return [matrix for matrix in matrices.values() if len(matrix.planners) > 1]
