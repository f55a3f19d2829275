"""Commands on official weights: ``weights list|import|fetch|anchors``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.help import FullSummaryGroup
from benchmark.cli.output import print_json, print_result
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError, did_you_mean

app = typer.Typer(
    cls=FullSummaryGroup,
    help="List, import and fetch official weights of the native models.",
    no_args_is_help=True,
    rich_help_panel="Advanced",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightsListOptions:
    """Options of ``weights list``."""

    json_output: shared.Json = False


@command(WeightsListOptions, app, "list")
def weights_list_command(options: WeightsListOptions) -> None:
    """List official files, where to get them, and what has been imported."""
    from adapters.checkpoints.cache import known_weights

    known = known_weights()
    if options.json_output:
        print_json([entry.as_json() for entry in known])
        return
    for entry in known:
        typer.echo(entry.plain())


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightsImportOptions:
    """Options of ``weights import``."""

    path: Annotated[Path, Option("An official .pth file, or a folder of published weights.", names="")]
    model: Annotated[str | None, Option("What it must be for; found out if not given.", "Planner")] = None
    normalisation: shared.Normalisation = None
    anchors: Annotated[
        Path | None, Option("Of weights anchors, or UniAD's .pkl, for weights that come without.", "Planner")
    ] = None
    json_output: shared.Json = False


@command(WeightsImportOptions, app, "import")
def weights_import_command(options: WeightsImportOptions) -> None:
    """Check an official checkpoint without running anything in it, and keep its weights."""
    from benchmark.machine.path_checks import require_file

    if not options.path.exists():
        raise InputError(f"{options.path} does not exist; give an existing file or folder")
    _require_weights(options.model, options.normalisation)
    require_file(options.anchors, "--anchors")
    from adapters.checkpoints.loading import import_weights

    imported_weights = import_weights(
        options.path, options.model, normalisation=options.normalisation, anchors=options.anchors
    )
    print_result(imported_weights.as_json(), imported_weights.sentence(), json_output=options.json_output)


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightsFetchOptions:
    """Options of ``weights fetch``."""

    name: Annotated[str, Option("Model or file name, as weights list has them.", "Planner", names="")]
    normalisation: shared.Normalisation = None
    json_output: shared.Json = False


@command(WeightsFetchOptions, app, "fetch")
def weights_fetch_command(options: WeightsFetchOptions) -> None:
    """Fetch an official file, or a folder of published weights, from the internet and import it."""
    _require_weights(options.name, options.normalisation, files=True)
    from adapters.checkpoints.loading import fetch_weights

    imported_weights = fetch_weights(options.name, normalisation=options.normalisation)
    print_result(imported_weights.as_json(), imported_weights.sentence(), json_output=options.json_output)


@dataclass(frozen=True, slots=True, kw_only=True)
class WeightsAnchorsOptions:
    """Options of ``weights anchors``."""

    model: Annotated[str, Option("sparsedrive or diffusiondrive.", "Planner")]
    data: shared.Data
    out: Annotated[Path, Option("File of anchors to write (.safetensors).", "Output")]
    split: shared.Split = "train"
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(WeightsAnchorsOptions, app, "anchors")
def weights_anchors_command(options: WeightsAnchorsOptions) -> None:
    """Compute anchors from a data set by k-means, for weights that come without them."""
    from adapters.models import published_models
    from benchmark.machine.path_checks import require_output_file

    known = [name for name, model in published_models().items() if model.net.clustered]
    if options.model not in known:
        close = did_you_mean(options.model, known)
        raise InputError(f"{options.model!r} is not a model with anchors; {close}choose from {', '.join(known)}")
    require_output_file(options.out, "--out", (".safetensors",))
    data = api.DataSource.of(options, out=api.OUT)
    data.require_source(options.split)
    from adapters.checkpoints.anchor_files import write_anchors

    report = write_anchors(options.model, data.open(), options.split, options.out).as_json()
    counts = ", ".join(f"{count} {kind}" for kind, count in report["sightings"].items())
    print_result(report, f"{report['path']}: anchors of {options.model} from {counts}", json_output=options.json_output)


def _require_weights(name: str | None, normalisation: str | None, *, files: bool = False) -> None:
    """Refuse what names no model with published weights, nor a file of theirs where one may be named; `InputError`."""
    from adapters.camera_inputs import find_normalisation
    from adapters.models import published_model
    from benchmark.weights.catalogue import FOLDERS, find_checkpoint

    if name is not None and name not in {entry.name for entry in FOLDERS}:
        find_checkpoint(name) if files else published_model(name)
    if normalisation is not None:
        find_normalisation(normalisation)
