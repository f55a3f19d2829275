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
from benchmark.cli.whole_help import WholeSummaries

if TYPE_CHECKING:
    from adapters.checkpoints.arrival import KeptWeights
    from adapters.checkpoints.importing import ImportedWeights

app = typer.Typer(
    cls=WholeSummaries, help="List, import and fetch official weights of the native models.", no_args_is_help=True
)


@app.command("list")
def weights_list_command(json_output: JsonOption = False) -> None:
    """List official files, where to get them, and what has been imported."""
    from adapters.checkpoints.listing import known_weights

    known = known_weights()
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
    from benchmark.cli.preflight_names import require_normalisation, require_published
    from benchmark.cli.preflight_places import require_file
    from benchmark.errors import InputError

    if not path.exists():
        raise InputError(f"there is no file or folder {path}; name one that is there")
    if model is not None:
        require_published(model)
    require_normalisation(normalisation)
    require_file(anchors, "--anchors")
    from adapters.checkpoints.arrival import import_weights

    _tell(import_weights(path, model, normalisation=normalisation, anchors=anchors), json_output=json_output)


@app.command("fetch")
def weights_fetch_command(
    name: Annotated[str, typer.Argument(help="Model or file name, as weights list has them.")],
    normalisation: NormalisationOption = None,
    json_output: JsonOption = False,
) -> None:
    """Fetch an official file, or a folder of published weights, from the internet and import it."""
    from benchmark.cli.preflight_names import require_normalisation, require_published

    require_published(name, files=True)
    require_normalisation(normalisation)
    from adapters.checkpoints.arrival import fetch_weights

    _tell(fetch_weights(name, normalisation=normalisation), json_output=json_output)


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
    from benchmark.cli.preflight_data_sets import require_source
    from benchmark.cli.preflight_names import require_clustered
    from benchmark.cli.preflight_places import require_output_file

    api.worker_count(workers)
    require_clustered(model)
    require_output_file(out, "--out", (".safetensors",))
    require_source(data, tables, split, api.OUT, scenes=None, limit=None)
    from adapters.checkpoints.anchor_files import write_anchors

    source = api.open_data(data, tables=tables, workers=workers)
    made = write_anchors(model, source, split, out).as_json()
    if json_output:
        print_json(made)
        return
    counts = ", ".join(f"{count} {what}" for what, count in made["sightings"].items())
    typer.echo(f"{made['path']}: anchors of {model} from {counts}")


def _tell(found: "ImportedWeights | KeptWeights", *, json_output: bool) -> None:
    if json_output:
        print_json(found.as_json())
    else:
        typer.echo(found.sentence())
