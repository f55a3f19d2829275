"""Command that writes info files: ``data export infos``."""

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, repeat_out_option
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import format_options, pluralise

InfoReader = Literal["uniad", "vad", "sparsedrive"]
"""Repository that reads the info files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportInfosOptions:
    """Options of ``data export infos``."""

    root: shared.Root
    reader: Annotated[
        InfoReader, Option("Whose code reads them; DiffusionDrive: sparsedrive.", "Output", names="--for")
    ]
    to: Annotated[Path, Option("Folder for the info files and what official code needs beside.", "Output")]
    split: Annotated[
        str | None, Option("Only this split; val, or the only one of the data set, if not given.", "Input")
    ] = None
    as_converted: Annotated[bool, Option("Exactly what the official converter writes.", "Output")] = False
    planning_only: Annotated[
        bool, Option("No network will open images: warn of none that are missing or of another size.", "Output")
    ] = False
    root_as: Annotated[str | None, Option("Where the root will be for the code that reads, if not here.", "Output")] = (
        None
    )
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(ExportInfosOptions)
def export_infos_command(options: ExportInfosOptions) -> None:
    """Write the info files with which UniAD, VAD, SparseDrive or DiffusionDrive evaluate a split."""
    from benchmark.extensions.infos.exporting import InfoSettings, export_infos
    from benchmark.extensions.infos.repairs import SameTimeError
    from benchmark.machine.path_checks import require_place

    data, split = api.DataSource.of(options), options.split
    data.require() if split is None else data.require_split(split)
    require_place(options.to, "--to")
    given = data.open().root if data.is_embedded else Path(options.root)
    root = given if split is None else data.open_split(split).root
    settings = InfoSettings(
        options.reader,
        options.tables if root == given else None,
        split,
        options.as_converted,
        options.root_as,
        options.planning_only,
    )
    try:
        exported = export_infos(root, options.to, settings)
    except SameTimeError as error:
        again = {name: getattr(options, name) for name in ("split", "to", "tables", "root_as")}
        raise InputError(
            f"{error}: challenger-bench data export infos {shlex.quote(options.root)}"
            f"{format_options(**{'for': options.reader}, **again)}{repeat_out_option(options.out)}"
        ) from error
    if options.json_output:
        files = {str(path): count for path, count in exported.files.items()}
        departures = [difference.as_json() for difference in exported.differences]
        print_json({"files": files, "departures": departures, "not_cured": list(exported.unrepaired)})
        return
    for path, count in exported.files.items():
        typer.echo(f"{pluralise(count, 'info')} in {path}")
    for difference in exported.differences:
        typer.echo(f"differs from the converter: {difference.what}")
    for sentence in exported.unrepaired:
        typer.echo(f"warning: {sentence}")
