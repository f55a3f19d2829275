"""The command that imports 123D logs: ``data import 123d``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_result
from benchmark.cli.settings import Option, command
from benchmark.report.words import pluralise


@dataclass(frozen=True, slots=True, kw_only=True)
class Import123DOptions:
    """Options of ``data import 123d``."""

    logs: Annotated[Path, Option("Folder of logs (DATA/logs), a split below it, or one log.", "Input", names="")]
    maps: Annotated[Path | None, Option("Folder of maps that logs share (DATA/maps).", "Input")] = None
    out: Annotated[Path, Option("Root of the data set to write.", "Output")]
    sensors: Annotated[
        Path | None, Option("Folder that the paths of images begin in, where logs hold paths.", "Input")
    ] = None
    images: Annotated[bool, Option("Whether images go along.", "Output", names="--images/--no-images")] = True
    split: Annotated[str | None, Option("One split for all; what the logs say if not given.", "Output")] = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(Import123DOptions)
def import_123d_command(options: Import123DOptions) -> None:
    """Import 123D logs of nuScenes, nuPlan, Argoverse 2, Waymo and others, with images and maps; resumes."""
    from benchmark.machine.path_checks import require_folder, require_place
    from generation.extensions.logs123d.importing import LogImport, import_123d, summarise_lacks

    require_folder(options.maps, "--maps")
    require_folder(options.sensors, "--sensors")
    require_place(options.out, "--out")
    settings = LogImport(
        options.maps, options.sensors, options.images, options.split, parse_name_list(options.scenes), options.limit
    )
    imported = import_123d(options.logs, options.out, settings, workers=api.worker_count(options.workers))
    scenes = [{"name": log.name, "split": log.split, **log.facts} for log in imported]
    lacks = summarise_lacks(imported)
    text = "\n".join([f"{pluralise(len(imported), 'scene')} in {options.out}", *lacks])
    print_result({"root": str(options.out), "scenes": scenes}, text, json_output=options.json_output)
