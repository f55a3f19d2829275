"""Commands on official weights: ``weights list|import|fetch|anchors``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    DataOption,
    JsonOption,
    NormalisationOption,
    SplitOption,
    TablesOption,
    WorkersOption,
    print_json,
)

if TYPE_CHECKING:
    from adapters.checkpoints.importing import ImportedWeights
    from benchmark.weights.catalogue import PublishedWeights

app = typer.Typer(help="Official weights of the native models.", no_args_is_help=True)


@app.command("list")
def weights_list_command(json_output: JsonOption = False) -> None:
    """Official files, where to get them, and what has been imported."""
    from adapters.checkpoints.cache import weights_folder
    from adapters.checkpoints.listing import known_weights

    known = known_weights(weights_folder())
    if json_output:
        print_json([entry.as_json() for entry in known])
        return
    for entry in known:
        typer.echo(entry.plain())


@app.command("import")
def weights_import_command(
    path: Annotated[Path, typer.Argument(help="An official .pth file, or a folder of published weights.")],
    model: Annotated[str | None, typer.Option(help="What it must be for; found out if not given.")] = None,
    normalisation: NormalisationOption = None,
    anchors: Annotated[
        Path | None, typer.Option(help="Of weights anchors, or UniAD's .pkl, for weights that come without.")
    ] = None,
    json_output: JsonOption = False,
) -> None:
    """Check an official checkpoint without running anything in it, and keep its weights."""
    from adapters.checkpoints.importing import import_checkpoint
    from benchmark.weights.folders import import_folder, weights_at

    published = weights_at(path, model)
    if published is not None:
        _tell_kept(published, import_folder(published, path), json_output=json_output)
        return
    found = import_checkpoint(path, model, normalisation=normalisation, anchors=anchors)
    _tell_imported(found, json_output=json_output)


@app.command("fetch")
def weights_fetch_command(
    name: Annotated[str, typer.Argument(help="Model or file name, as weights list has them.")],
    normalisation: NormalisationOption = None,
    json_output: JsonOption = False,
) -> None:
    """Fetch an official file, or a folder of published weights, from the internet and import it."""
    from adapters.checkpoints.cache import weights_folder
    from adapters.checkpoints.importing import fetch_checkpoint
    from benchmark.weights.catalogue import FOLDERS, checkpoint_of
    from benchmark.weights.folders import fetch_folder

    published = next((entry for entry in FOLDERS if entry.name == name), None)
    if published is not None:
        _tell_kept(published, fetch_folder(published), json_output=json_output)
        return
    found = fetch_checkpoint(checkpoint_of(name), weights_folder(), normalisation=normalisation)
    _tell_imported(found, json_output=json_output)


@app.command("anchors")
def weights_anchors_command(
    model: Annotated[str, typer.Option(help="sparsedrive or diffusiondrive.")],
    data: DataOption,
    out: Annotated[Path, typer.Option("--out", help="File of anchors to write (.safetensors).")],
    split: SplitOption = "train",
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Compute anchors from a data set by k-means, for weights that come without them."""
    from adapters.checkpoints.anchor_files import write_anchors

    source = api.open_data(data, tables=tables, workers=workers)
    made = write_anchors(model, source, split, out).as_json()
    if json_output:
        print_json(made)
        return
    counts = ", ".join(f"{count} {what}" for what, count in made["sightings"].items())
    typer.echo(f"{made['path']}: anchors of {model} from {counts}")


def _tell_kept(weights: "PublishedWeights", folder: Path, *, json_output: bool) -> None:
    if json_output:
        print_json({"model": weights.name, "path": str(folder)})
    else:
        typer.echo(f"{folder}: {weights.name}, for {weights.used_by}")


def _tell_imported(found: "ImportedWeights", *, json_output: bool) -> None:
    facts = found.provenance.model_dump(mode="json")
    if json_output:
        print_json({"path": str(found.path), "tensors": found.tensors, "parameters": found.parameters, **facts})
        return
    typer.echo(
        f"{found.path}: {found.provenance.model}, {found.tensors} tensors, {found.parameters / 1e6:.1f} M numbers, "
        f"pixel values {found.provenance.normalisation} (said by: {found.provenance.normalisation_from})"
    )
