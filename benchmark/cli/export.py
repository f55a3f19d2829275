"""Commands that write a data set for code of others: ``data export infos|scenarionet|openscenario``."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    JsonOption,
    LimitOption,
    OutOption,
    ScenesOption,
    TablesOption,
    WorkersOption,
    name_list,
    print_json,
)
from benchmark.cli.whole_help import WholeSummaries
from benchmark.report.words import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.datasets.roots import DataSet
    from benchmark.extensions.exchange.exporting import ExportedScene

app = typer.Typer(cls=WholeSummaries, help="Write a data set for the code of others.", no_args_is_help=True)


class InfoReader(StrEnum):
    """Whose info files are written."""

    UNIAD = "uniad"
    VAD = "vad"
    SPARSEDRIVE = "sparsedrive"


@app.command("infos")
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


@app.command("scenarionet")
def export_scenarionet_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")],
    to: Annotated[Path, typer.Option("--to", help="Folder for the files, one a scene.")],
    split: Annotated[str | None, typer.Option(help="Only this split; all scenes if not given.")] = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Write scenes as ScenarioNet files, which MetaDrive opens too; who is adversarial travels along."""
    from benchmark.extensions.exchange.exporting import export_scenarionet

    dataset, names = _scenes_to_export(root, to, split, scenes, limit, out, tables, workers)
    _say_exported(export_scenarionet(dataset, names, to, workers=api.worker_count(workers)), to, json_output)


@app.command("openscenario")
def export_openscenario_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")],
    to: Annotated[Path, typer.Option("--to", help="Folder for the files, one a scene.")],
    split: Annotated[str | None, typer.Option(help="Only this split; all scenes if not given.")] = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Write scenes as OpenSCENARIO 1.2: a trajectory for every object, no road network."""
    from benchmark.cli.preflight_names import require_package
    from benchmark.datasets.own_words import NEEDS_A_PACKAGE

    require_package("scenariogeneration", NEEDS_A_PACKAGE)
    from benchmark.extensions.exchange.openscenario import export_openscenario

    dataset, names = _scenes_to_export(root, to, split, scenes, limit, out, tables, workers)
    _say_exported(export_openscenario(dataset, names, to, workers=api.worker_count(workers)), to, json_output)


def _scenes_to_export(
    root: str,
    to: Path,
    split: str | None,
    scenes: str | None,
    limit: int | None,
    out: Path,
    tables: str | None,
    workers: int,
) -> "tuple[DataSet, tuple[str, ...]]":
    """The data set and the scenes that are exported; what cannot be is refused before anything is built."""
    from benchmark.cli.preflight_data_sets import require_data, require_root
    from benchmark.cli.preflight_places import require_place

    api.worker_count(workers)
    named = name_list(scenes)
    if split is None:
        require_root(root, tables, out, named)
    else:
        require_data(root, tables, split, out, scenes=named, limit=limit)
    require_place(to, "--to")
    dataset = api.open_data(root, tables=tables, workers=workers, out=out)
    if split is not None:
        dataset = api.open_split(dataset, split, out, workers=workers)
    known = dataset.scene_names(split)
    return dataset, tuple(name for name in known if named is None or name in named)[:limit]


def _say_exported(files: "Sequence[ExportedScene]", to: Path, json_output: bool) -> None:
    if json_output:
        said = [{"scene": file.scene, "file": str(file.path), "adversaries": file.adversaries} for file in files]
        print_json({"folder": str(to), "scenes": said})
        return
    adversaries = sum(len(file.adversaries) for file in files)
    who = f"{adversaries} adversar{'y' if adversaries == 1 else 'ies'} named in {'it' if len(files) == 1 else 'them'}"
    typer.echo(f"{counted(len(files), 'scene')} in {to}, {who}")
