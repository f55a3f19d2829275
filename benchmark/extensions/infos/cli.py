"""Command that writes info files: ``data export infos``."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    JsonOption,
    OutOption,
    TablesOption,
    WorkersOption,
    print_json,
)
from benchmark.report.words import counted

if TYPE_CHECKING:
    pass


class InfoReader(StrEnum):
    """Whose info files are written."""

    UNIAD = "uniad"
    VAD = "vad"
    SPARSEDRIVE = "sparsedrive"


def export_infos_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")],
    reader: Annotated[InfoReader, typer.Option("--for", help="Whose code reads them; DiffusionDrive: sparsedrive.")],
    to: Annotated[Path, typer.Option("--to", help="Folder for the info files and what official code needs beside.")],
    split: Annotated[
        str | None, typer.Option(help="Only this split; val, or the only one of the data set, if not given.")
    ] = None,
    as_converted: Annotated[
        bool,
        typer.Option("--as-converted", help="Exactly what the official converter writes."),
    ] = False,
    root_as: Annotated[
        str | None, typer.Option("--root-as", help="Where the root will be for the code that reads, if not here.")
    ] = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Write the info files with which UniAD, VAD, SparseDrive or DiffusionDrive evaluate a split."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_places import require_place
    from benchmark.extensions.infos.exporting import InfoSettings, export_infos
    from benchmark.machine.workspace import EMBEDDED_NAMES

    api.worker_count(workers)
    require_root(root, tables, out)
    require_place(to, "--to")
    known = root in EMBEDDED_NAMES
    folder = api.open_data(root, tables=tables, workers=workers, out=out).root if known else Path(root)
    settings = InfoSettings(reader.value, tables, split, as_converted, root_as)
    exported = export_infos(folder, to, settings)
    if json_output:
        files = {str(path): count for path, count in exported.files.items()}
        departures = [departure.as_json() for departure in exported.departures]
        print_json({"files": files, "departures": departures, "not_cured": list(exported.not_cured)})
        return
    for path, count in exported.files.items():
        typer.echo(f"{counted(count, 'info')} in {path}")
    for departure in exported.departures:
        typer.echo(f"otherwise than converted: {departure.what}")
    for sentence in exported.not_cured:
        typer.echo(f"not to be cured here: {sentence}")
