"""Commands that write scenes for others: ``data export scenarionet|openscenario``."""

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
from benchmark.report.words import counted

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.datasets.roots import DataSet
    from benchmark.extensions.exchange.exporting import ExportedScene


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
