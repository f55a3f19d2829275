"""Command that measures the quality of videos: ``quality``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from benchmark import api
from benchmark.cli.options import (
    DataOption,
    DryRunOption,
    Frames,
    FramesOption,
    JsonOption,
    LimitOption,
    OutOption,
    ScenesOption,
    ShardOption,
    SplitOption,
    TablesOption,
    WeightsFolderOption,
    WideOption,
    WorkersOption,
    name_list,
    print_json,
    say_plan,
)
from benchmark.cli.shards import say_shard
from benchmark.cli.what_next import same_place, say_next

if TYPE_CHECKING:
    from benchmark.extensions.quality.definition import Definition


def quality_command(
    split: SplitOption = "val",
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    masks: Annotated[
        str, typer.Option(help="Source of masks: grounded-sam2 (the paper's), sam2-boxes, boxes (no network).")
    ] = "grounded-sam2",
    frames: FramesOption = Frames.KEYFRAMES,
    lossless: Annotated[bool, typer.Option("--lossless", help="Score the PNG frames beside the split's own.")] = False,
    weights_folder: WeightsFolderOption = None,
    device: Annotated[
        str,
        typer.Option(help="Where networks run: cpu, cuda, cuda:1, or several for a process on each; GPUs if any."),
    ] = "auto",
    batch: Annotated[int, typer.Option(min=1, help="Pictures that go through a network together.")] = 16,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    shard: ShardOption = None,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Measure subject consistency and imaging quality of a split's videos; the same command goes on."""
    from benchmark.cli.preflight_data_sets import require_data
    from benchmark.cli.preflight_names import require_devices
    from benchmark.cli.preflight_places import require_folder, require_place
    from benchmark.extensions.quality.definition import Definition, mask_source
    from benchmark.machine.several_devices import workers_for
    from benchmark.runs.units import Shard

    files: Literal["own", "lossless"] = "lossless" if lossless else "own"
    definition = Definition(mask_source(masks), frames.value, files, batch=batch)
    require_devices(device)
    api.worker_count(workers_for(workers, device))
    mine = None if shard is None else Shard.named(shard)
    require_folder(weights_folder, "--weights-folder")
    ahead = require_data(data, tables, split, out, scenes=name_list(scenes), limit=limit)
    require_place(out, "--out")
    if dry_run and ahead.builds:
        then = f"score {ahead.counted()} of {split}; masks from {masks}"
        say_plan(ahead.plan(then), json_output=json_output)
        return
    if not dry_run:
        _require_weights(definition, weights_folder)
    from benchmark.extensions.quality.measure import QualitySettings, measure_quality, measure_shard, plan_of
    from leaderboard.extensions.quality.tables import quality_tables

    settings = QualitySettings(definition, weights_folder, device, name_list(scenes), limit, workers)
    between = frames is Frames.ALL and split == "val" and not dry_run
    source = api.open_data(data, tables=tables, workers=workers, out=out, sweeps=between)
    dataset = api.open_split(source, split, out, workers=workers)
    if dry_run:
        say_plan([plan_of(dataset, split, settings)], json_output=json_output)
        return
    root = api.workspace(out).quality_root()
    if mine is not None:
        done = measure_shard(dataset, split, root, settings, mine)
        say_shard(
            mine,
            [done],
            "scored",
            (f"quality{same_place(data, out, tables)}", "with the same options and no --shard, when all shards are"),
            json_output=json_output,
        )
        return
    record = measure_quality(dataset, split, root, settings)
    for caveat in record.caveats:
        api.tell(f"warning: {caveat.sentence}")
    if json_output:
        facts = record.facts.model_dump(mode="json", by_alias=True, include={"definition", "weights", "summary"})
        print_json({"directory": str(record.directory), **facts})
    else:
        typer.echo(quality_tables([record])[0].plain(wide=wide))
    say_next(
        f"record: {record.directory}",
        (f"leaderboard{same_place('mini', out)}", "all records in tables beside the paper's"),
        json_output=json_output,
    )


def _require_weights(definition: "Definition", given: Path | None) -> None:
    """Refuse networks that are not here, before a split is built for them."""
    from benchmark.cli.preflight_names import require_package
    from benchmark.extensions.quality.definition import needed_for
    from benchmark.weights.folders import folder_of

    for weights in needed_for(definition.masks):
        folder_of(weights, given)
    require_package(
        "transformers",
        "video quality needs the package transformers; install it with: pip install 'challenger-bench[quality]'",
    )
