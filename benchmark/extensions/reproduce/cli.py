"""The command that is run first with official weights: ``reproduce``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from benchmark import api
from benchmark.cli.options import (
    DataOption,
    DryRunOption,
    JsonOption,
    OutOption,
    SeedOption,
    TablesOption,
    WideOption,
    WorkersOption,
    print_json,
    say_plan,
)
from benchmark.cli.what_next import same_place, say_next
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.extensions.reproduce.reproducing import Expected

_SPLIT: Final = "val"


def reproduce_command(
    model: Annotated[str, typer.Option("--model", help="Model whose published numbers are wanted, such as uniad.")],
    data: DataOption = "mini",
    split: Annotated[str, typer.Option("--split", help="Split of the numbers.")] = _SPLIT,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    expected: Annotated[
        Path | None, typer.Option(help="File of numbers to compare with, if not the published ones.")
    ] = None,
    store: Annotated[
        Path | None, typer.Option(help="Write what came out to this file, for --expected of a later run.")
    ] = None,
    plain: Annotated[
        bool, typer.Option("--plain", help="Run as eval does by default, without --as-published all.")
    ] = False,
    device: Annotated[str | None, typer.Option(help="Where the network runs: cpu, cuda, cuda:1.")] = None,
    precision: Annotated[str | None, typer.Option(help="Of the network: float32 or bfloat16.")] = None,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Run official weights as in their published run, and compare number by number; exit code 1 if any differs."""
    from benchmark.cli.preflight_data_sets import require_data
    from benchmark.cli.preflight_names import require_models, require_published_runs
    from benchmark.cli.preflight_places import require_file, require_output_file, require_place
    from benchmark.evaluation import require_whole_split

    require_file(expected, "--expected", (".json",))
    require_output_file(store, "--store", (".json",))
    require_models([model], checkpoint, data=data, device=device, precision=precision)
    runs = _planner_of(model, checkpoint, data, expected)
    count, published = api.worker_count(workers), _as_published(runs, plain=plain)
    numbers = _expected(runs, expected, split)
    if require_published_runs([runs], checkpoint, published, data=data):
        require_whole_split(runs, None, None, workers)
        count = 1
    ahead = require_data(data, tables, split, out)
    require_place(out, "--out")
    if dry_run:
        how = f"with --as-published {' '.join(published)}" if published else "as eval does by default"
        then = f"run {runs} on {ahead.counted()} of {split} {how}, and compare with {numbers.of}"
        said = ahead.plan(then) if ahead.builds else (f"would {then}",)
        say_plan(said, json_output=json_output)
        return
    from benchmark.extensions.reproduce.reproducing import reproduce, store_expected
    from leaderboard.extensions.reproduction.tables import reproduction_table

    factory = api.load_planner(
        model, checkpoint, data=data, seed=seed, device=device, precision=precision, as_published=published
    )
    source = api.open_data(data, tables=tables, workers=workers, out=out)
    dataset = api.open_split(source, split, out, workers=workers)
    runs_root = api.workspace(out).run_root()
    record, found = reproduce(dataset, split, factory, runs_root, numbers, workers=count, seed=seed)
    if store is not None:
        store_expected(store, record, numbers.protocol)
    if json_output:
        rows = [{**number.model_dump(mode="json"), "ok": number.ok} for number in found.numbers]
        print_json({"directory": str(record.directory), "reproduced": found.reproduced, "numbers": rows})
    else:
        typer.echo(reproduction_table(found).plain(wide=wide), nl=False)
    if not found.reproduced:
        raise typer.Exit(1)
    options = "".join(f" --as-published {option}" for option in published)
    say_next(
        f"record: {record.directory}",
        (
            f"eval --model {model} --split adv{options}{same_place(data, out, tables)}",
            "tables mark runs of the same weights, code and options as reproduced",
        ),
        json_output=json_output,
    )


def _planner_of(model: str, checkpoint: Path | None, data: str, expected: Path | None) -> str:
    """Name of the planner that runs; raises `InputError` where a miniature would run for a published model."""
    from adapters.checkpoints.stand_in import no_weights
    from adapters.models import MODELS

    runs = api.model_that_runs(model, checkpoint, data=data)
    if runs != model and expected is None:
        raise no_weights(MODELS[model].name)
    return MODELS[runs].name if runs in MODELS else runs


def _as_published(name: str, *, plain: bool) -> tuple[str, ...]:
    """Everything that the model does as in its published run, unless that is not wanted or there is nothing."""
    from adapters.as_published import ALL, options_of
    from adapters.models import MODELS

    network = MODELS[name].network if name in MODELS else None
    if plain or network is None or not network.as_published:
        return ()
    return options_of(name, network.as_published, [ALL])


def _expected(name: str, file: Path | None, split: str) -> "Expected":
    """The numbers to compare with; raises `InputError` if there are none."""
    from adapters.models import MODELS
    from benchmark.extensions.reproduce.reproducing import expected_file, published_numbers

    if file is not None:
        return expected_file(file, name, split)
    own = MODELS[name].native_protocol if name in MODELS else None
    if split != _SPLIT:
        raise InputError(f"numbers are published of split {_SPLIT}, not of {split}; leave --split out")
    return published_numbers(name, own or "")
