"""The command that is run first with official weights: ``reproduce``."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_next_steps, print_plan, print_result, repeat_data_options
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from benchmark.extensions.reproduce.reproducing import ExpectedNumbers

_SPLIT: Final = "val"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReproduceOptions:
    """Options of ``reproduce``."""

    model: Annotated[str, Option("Model whose published numbers are wanted, such as uniad.", "Planner")]
    data: shared.Data = "mini"
    split: Annotated[str, Option("Split of the numbers.", "Input")] = _SPLIT
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    checkpoint: shared.Checkpoint = None
    expected: Annotated[Path | None, Option("File of numbers to compare with, if not the published ones.")] = None
    store: Annotated[
        Path | None, Option("Write what came out to this file, for --expected of a later run.", "Output")
    ] = None
    plain: Annotated[bool, Option("Run as eval does by default, without --as-published all.")] = False
    device: Annotated[str | None, Option("Where the network runs: cpu, cuda, cuda:1.", "Planner")] = None
    precision: Annotated[str | None, Option("Of the network: float32 or bfloat16.", "Planner")] = None
    seed: shared.Seed = 0
    workers: shared.Workers = 0
    wide: shared.Wide = False
    json_output: shared.Json = False
    dry_run: shared.DryRun = False


@command(ReproduceOptions, panel="Advanced")
def reproduce_command(options: ReproduceOptions) -> None:
    """Run official weights as in their published run, and compare number by number; exit code 1 if any differs."""
    from benchmark.evaluation import require_whole_split
    from benchmark.machine.path_checks import require_file, require_output_file, require_place

    require_file(options.expected, "--expected", (".json",))
    require_output_file(options.store, "--store", (".json",))
    model = api.PlannerSource.of(options).require()
    runs = _find_planner(options.model, options.checkpoint, options.data, options.expected)
    count, published = api.worker_count(options.workers), _list_published_settings(runs, plain=options.plain)
    numbers = _read_expected(runs, options.expected, options.split)
    model = replace(model, as_published=published)
    if model.remembers_across_scenes():
        require_whole_split(runs, None, None, options.workers)
        count = 1
    data = api.DataSource.of(options)
    ahead = data.require_split(options.split)
    require_place(options.out, "--out")
    if options.dry_run:
        how = f"with --as-published {' '.join(published)}" if published else "as eval does by default"
        then = f"run {runs} on {ahead.counted()} of {options.split} {how}, and compare with {numbers.of}"
        sentences = ahead.plan(then) if ahead.builds else (f"would {then}",)
        print_plan(sentences, json_output=options.json_output)
        return
    from benchmark.extensions.reproduce.reproducing import reproduce, store_expected
    from leaderboard.extensions.reproduction.tables import reproduction_table

    (factory,) = model.load()
    dataset, runs_root = data.open_split(options.split), api.workspace(options.out).run_root()
    record, reproduction = reproduce(
        dataset, options.split, factory, runs_root, numbers, workers=count, seed=options.seed
    )
    if options.store is not None:
        store_expected(options.store, record, numbers.protocol)
    rows = [{**number.model_dump(mode="json"), "ok": number.ok} for number in reproduction.numbers]
    result = {"directory": str(record.directory), "reproduced": reproduction.reproduced, "numbers": rows}
    print_result(result, reproduction_table(reproduction).plain(wide=options.wide), json_output=options.json_output)
    if not reproduction.reproduced:
        raise typer.Exit(1)
    same = ("model", "checkpoint", "device", "precision")
    given = format_options(**{name: getattr(options, name) for name in same}, as_published=published, split="adv")
    try:
        data.require_split("adv")
    except InputError:
        step = None
    else:
        why = "marks runs of the same weights, code and options as reproduced in tables"
        step = (f"eval{given}{repeat_data_options(options)}", why)
    print_next_steps(f"record: {record.directory}", step, json_output=options.json_output)


def _find_planner(model: str, checkpoint: Path | None, data: str, expected: Path | None) -> str:
    """Name of the planner that runs; raises `InputError` where a miniature would run for a published model."""
    from adapters.checkpoints.stand_in import missing_weights_error
    from adapters.models import MODELS

    runs = api.find_runnable_model(model, checkpoint, data=data)
    if runs != model and expected is None:
        raise missing_weights_error(MODELS[model].name)
    return MODELS[runs].name if runs in MODELS else runs


def _list_published_settings(name: str, *, plain: bool) -> tuple[str, ...]:
    """Everything that the model does as in its published run, unless that is not wanted or there is nothing."""
    from adapters.as_published import ALL, select_options
    from adapters.models import MODELS

    network = MODELS[name].network if name in MODELS else None
    if plain or network is None or not network.as_published:
        return ()
    return select_options(name, network.as_published, [ALL])


def _read_expected(name: str, file: Path | None, split: str) -> "ExpectedNumbers":
    """The numbers to compare with; raises `InputError` if there are none."""
    from adapters.models import MODELS
    from benchmark.extensions.reproduce.reproducing import expected_file, published_numbers

    if file is not None:
        return expected_file(file, name, split)
    own = MODELS[name].native_protocol if name in MODELS else None
    if split != _SPLIT:
        raise InputError(f"published numbers exist for split {_SPLIT}, not for {split}; leave --split out")
    return published_numbers(name, own or "")
