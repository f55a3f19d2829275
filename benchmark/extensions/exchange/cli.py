"""Commands that write scenes for others: ``data export scenarionet|openscenario|nuscenes``."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_json
from benchmark.cli.settings import Option, command
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.datasets.roots import DataSet
    from benchmark.extensions.exchange.exporting import ExportedScene


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Options of ``data export scenarionet``, ``openscenario`` and ``nuscenes``."""

    root: shared.Root
    to: Annotated[Path, Option("Folder to write to.", "Output")]
    split: Annotated[str | None, Option("Only this split; all scenes if not given.", "Input")] = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(ExportOptions)
def export_scenarionet_command(options: ExportOptions) -> None:
    """Write scenes as ScenarioNet files, which MetaDrive opens too; who is adversarial travels along."""
    from benchmark.extensions.exchange.exporting import export_scenarionet

    dataset, names = _scenes_to_export(options)
    files = export_scenarionet(dataset, names, options.to, workers=api.worker_count(options.workers))
    _print_exported(files, options.to, options.json_output)


@command(ExportOptions)
def export_openscenario_command(options: ExportOptions) -> None:
    """Write scenes as OpenSCENARIO 1.2: a trajectory for every object, no road network."""
    from benchmark.datasets.scenario_map import NEEDS_A_PACKAGE
    from benchmark.machine.extension import require_package

    require_package("scenariogeneration", NEEDS_A_PACKAGE)
    from benchmark.extensions.exchange.openscenario import export_openscenario

    dataset, names = _scenes_to_export(options)
    files = export_openscenario(dataset, names, options.to, workers=api.worker_count(options.workers))
    _print_exported(files, options.to, options.json_output)


@command(ExportOptions)
def export_nuscenes_command(options: ExportOptions) -> None:
    """Write a root under names of nuScenes' validation scenes, for readers that know no others; at most 150 scenes."""
    from benchmark.extensions.exchange.borrowed_names import NAMES_FILE, export_nuscenes

    dataset, names = _scenes_to_export(options)
    roots = export_nuscenes(dataset, names, options.to)
    if options.json_output:
        print_json({"roots": [asdict(root) | {"folder": str(root.folder)} for root in roots]})
        return
    for root in roots:
        typer.echo(
            f"{pluralise(len(root.names), 'scene')} in {root.folder}, called as nuScenes' validation scenes are "
            f"({NAMES_FILE} says which is which); no command here evaluates that root"
        )
        if root.cities_without_lanes:
            cities = ", ".join(root.cities_without_lanes)
            typer.echo(f"warning: there are no lanes in the map of {cities}, on which readers of maps may fail")


def _scenes_to_export(options: ExportOptions) -> "tuple[DataSet, tuple[str, ...]]":
    """The data set and the scenes that are exported; what cannot be is refused before anything is built."""
    from benchmark.datasets.scene_names import resolve_names
    from benchmark.machine.path_checks import require_place

    data, named, split = api.DataSource.of(options), parse_name_list(options.scenes), options.split
    data.require(named) if split is None else data.require_split(split, named, options.limit)
    require_place(options.to, "--to")
    dataset = data.open() if split is None else data.open_split(split)
    known = dataset.scene_names(split)
    named = None if named is None else resolve_names(dataset.provenance(), named)
    return dataset, tuple(name for name in known if named is None or name in named)[: options.limit]


def _print_exported(files: "Sequence[ExportedScene]", to: Path, json_output: bool) -> None:
    if json_output:
        file_rows = [{"scene": file.scene, "file": str(file.path), "adversaries": file.adversaries} for file in files]
        print_json({"folder": str(to), "scenes": file_rows})
        return
    adversaries = sum(len(file.adversaries) for file in files)
    named = f"{adversaries} adversar{'y' if adversaries == 1 else 'ies'} named in {'it' if len(files) == 1 else 'them'}"
    typer.echo(f"{pluralise(len(files), 'scene')} in {to}, {named}")
