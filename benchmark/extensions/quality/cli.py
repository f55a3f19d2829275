"""Command that measures the quality of videos: ``quality``."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import (
    print_next_steps,
    print_plan,
    print_result,
    print_shard_progress,
    suggest_leaderboard,
)
from benchmark.cli.settings import Option, command
from benchmark.cli.splits import choose_splits

if TYPE_CHECKING:
    from benchmark.extensions.quality.definition import QualityDefinition


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityOptions:
    """Options of ``quality``."""

    split: shared.Split = "adv"
    data: shared.Data = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    masks: Annotated[str, Option("Source of masks: grounded-sam2 (the paper's), sam2-boxes, boxes (no network).")] = (
        "grounded-sam2"
    )
    frames: shared.Frames = "keyframes"
    lossless: Annotated[bool, Option("Score the PNG frames beside the split's own.", "Output")] = False
    weights_folder: shared.WeightsFolder = None
    device: Annotated[
        str, Option("Where networks run: cpu, cuda, cuda:1, or several for a process on each; GPUs if any.", "Planner")
    ] = "auto"
    batch: Annotated[int, Option("Pictures that go through a network together.", "Execution", min=1)] = 16
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    shard: shared.Shard = None
    workers: shared.Workers = 0
    wide: shared.Wide = False
    json_output: shared.Json = False
    dry_run: shared.DryRun = False


@command(QualityOptions, panel="Data")
def quality_command(options: QualityOptions) -> None:
    """Measure subject consistency and imaging quality of a split's videos; the same command goes on."""
    from benchmark.extensions.quality.definition import QualityDefinition, find_mask_source
    from benchmark.machine.path_checks import require_folder, require_place
    from benchmark.machine.several_devices import count_workers
    from benchmark.runs.units import Shard

    files: Literal["own", "lossless"] = "lossless" if options.lossless else "own"
    definition = QualityDefinition(find_mask_source(options.masks), options.frames, files, batch=options.batch)
    api.require_devices(options.device)
    api.worker_count(count_workers(options.workers, options.device))
    mine = None if options.shard is None else Shard.named(options.shard)
    require_folder(options.weights_folder, "--weights-folder")
    data, scenes = api.DataSource.of(options), parse_name_list(options.scenes)
    taken = choose_splits(data, [options.split], scenes, options.limit)
    ((split, ahead),) = taken.ahead.items()
    options = replace(options, split=split)
    require_place(options.out, "--out")
    taken.say()
    if options.dry_run and ahead.builds:
        then = f"score {ahead.counted()} of {options.split}; masks from {options.masks}"
        print_plan(ahead.plan(then), json_output=options.json_output)
        return
    if not options.dry_run:
        _require_weights(definition, options.weights_folder)
    from benchmark.extensions.quality.measure import QualitySettings, describe_plan, measure_quality, measure_shard
    from leaderboard.extensions.quality.tables import quality_tables

    settings = QualitySettings(
        definition, options.weights_folder, options.device, scenes, options.limit, options.workers
    )
    between = options.frames == "all" and options.split == "val" and not options.dry_run
    dataset = data.open_split(options.split, data.open(sweeps=between))
    if options.dry_run:
        print_plan([describe_plan(dataset, options.split, settings)], json_output=options.json_output)
        return
    root = api.workspace(options.out).quality_root()
    if mine is not None:
        finished = measure_shard(dataset, options.split, root, settings, mine)
        print_shard_progress(mine, [finished], "scored", json_output=options.json_output)
        return
    record = measure_quality(dataset, options.split, root, settings)
    for caveat in record.caveats:
        api.notify(f"warning: {caveat.sentence}")
    facts = record.facts.model_dump(mode="json", by_alias=True, include={"definition", "weights", "summary"})
    table = quality_tables([record])[0].plain(wide=options.wide)
    print_result({"directory": str(record.directory), **facts}, f"{table}\n", json_output=options.json_output)
    print_next_steps(
        f"record: {record.directory}",
        suggest_leaderboard(options.out, *record.directory.glob("*.json")),
        json_output=options.json_output,
    )


def _require_weights(definition: "QualityDefinition", weights_folder: Path | None) -> None:
    """Refuse networks that are not here, before a split is built for them."""
    from benchmark.extensions.quality.definition import list_required_weights
    from benchmark.machine.extension import require_package
    from benchmark.weights.folders import require_folder_of

    for weights in list_required_weights(definition.masks):
        require_folder_of(weights, weights_folder)
    require_package(
        "transformers",
        "video quality needs the package transformers; install it with: pip install 'challenger-bench[quality]'",
    )
