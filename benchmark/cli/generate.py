"""Commands that make scenes: ``generate`` and ``ablate``."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.built_splits import (
    build_one,
    build_shards,
    frozen_scenes,
    is_edited,
    require_shardable,
    say_built,
    splits_to_build,
)
from benchmark.cli.options import (
    AddressOption,
    AskedLook,
    AskedLookOption,
    CallsOption,
    CategoriesOption,
    DataOption,
    DenoiserOption,
    DevicesOption,
    DrawnSize,
    DrawnSizeOption,
    DropoutOption,
    DryRunOption,
    ExecutorName,
    ExecutorOption,
    Frames,
    FramesOption,
    JsonOption,
    Layout,
    LimitOption,
    LosslessOption,
    MemoryLimitOption,
    OutOption,
    Preset,
    PresetOption,
    RenderDeviceOption,
    RendererName,
    SampleLimitOption,
    SamplesOption,
    ScenesOption,
    SeedOption,
    SetOption,
    ShardOption,
    SizeOption,
    SpeedOption,
    SplitOption,
    TablesOption,
    TogetherOption,
    WeightsFolderOption,
    WideOption,
    WorkersOption,
    WrittenSize,
    WrittenSizeOption,
    executor_of,
    image_size,
    name_list,
    print_json,
    say_plan,
)
from benchmark.cli.what_next import same_place, say_next
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.cli.preflight_data_sets import Ahead
    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workers import Executor
    from generation.labels.manoeuvres import Manoeuvre
    from generation.render.contract import Renderer


def generate_command(
    context: typer.Context,
    split: SplitOption = "adv",
    from_file: Annotated[
        str | None,
        typer.Option(
            "--from",
            help="Rebuild a frozen split, a file or mini-adv-3, or build edited ScenarioNet files; no search.",
        ),
    ] = None,
    freeze: Annotated[
        Path | None, typer.Option(help="Also write the result as a frozen split, a few kB a scene, to this file.")
    ] = None,
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    source_split: Annotated[str, typer.Option(help="Split of the data set to start from.")] = "val",
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    adversaries: Annotated[int, typer.Option(min=1, help="Adversaries in each scene.")] = 1,
    surrogate: Annotated[str | None, typer.Option(help="Keep only scenes in which this planner collides.")] = None,
    surrogate_checkpoint: Annotated[Path | None, typer.Option(help="Weights of the surrogate.")] = None,
    sample_limit: SampleLimitOption = None,
    memory_limit: MemoryLimitOption = None,
    vehicles: Annotated[int | None, typer.Option(min=1, help="Vehicles to try per scene, at most.")] = None,
    per_scene: Annotated[int | None, typer.Option(min=1, help="Keep at most so many variants of a scene.")] = None,
    variants: Annotated[
        int | None, typer.Option(min=1, help="Keep at most so many variants of a scene, those that differ most.")
    ] = None,
    manoeuvres: Annotated[
        list[str] | None,
        typer.Option("--manoeuvre", help="Steer the search to this kind, e.g. cut-in-left; may be repeated."),
    ] = None,
    top: Annotated[int | None, typer.Option(min=1, help="Keep only the so many most challenging scenes.")] = None,
    candidates: Annotated[int | None, typer.Option(min=4, max=65536, help="Candidates per planning step.")] = None,
    rounds: Annotated[int | None, typer.Option(min=0, help="Refinement rounds per planning step.")] = None,
    parked: Annotated[bool, typer.Option(help="Also try vehicles that never move.")] = False,
    preset: PresetOption = Preset.DEFAULT,
    keep_unsolvable: Annotated[
        bool,
        typer.Option(
            "--keep-unsolvable",
            help="Keep scenes that nobody could have avoided: they test luck, not driving (docs/severity.md).",
        ),
    ] = False,
    changes: SetOption = None,
    denoiser: DenoiserOption = None,
    calls: CallsOption = None,
    dropout: DropoutOption = False,
    samples: SamplesOption = None,
    device: DevicesOption = "cpu",
    together: TogetherOption = 1,
    layout: Annotated[Layout, typer.Option(help="One root with suffixed names, or one root per variant.")] = (
        Layout.SUFFIXED
    ),
    renderer: Annotated[RendererName, typer.Option(help="Who draws the images.")] = RendererName.SCHEMATIC,
    size: SizeOption = "448x256",
    render_size: DrawnSizeOption = DrawnSize.SMALL,
    written_size: WrittenSizeOption = WrittenSize.CAMERA,
    prompt_look: AskedLookOption = AskedLook.RECORDED,
    lossless: LosslessOption = False,
    weights_folder: WeightsFolderOption = None,
    render_device: RenderDeviceOption = "auto",
    tflops: SpeedOption = None,
    frames: FramesOption = Frames.ALL,
    seed: SeedOption = 0,
    seeds: Annotated[
        str | None, typer.Option(help="Build one split for each seed, adv-seed-0, adv-seed-1, ...: 0,1,2.")
    ] = None,
    shard: ShardOption = None,
    workers: WorkersOption = 0,
    executor: ExecutorOption = ExecutorName.LOCAL,
    address: AddressOption = None,
    keep_rounds: Annotated[
        bool, typer.Option("--keep-rounds", help="Keep what sheets --rounds shows, less than a megabyte a scene.")
    ] = False,
    profile: Annotated[bool, typer.Option(help="Say where the time went, beside the paper's table.")] = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Build a split, adv or val-r, from recorded scenes; the same command resumes."""
    from benchmark.cli.preflight_data_sets import require_room_to_draw, require_root, require_source
    from benchmark.cli.preflight_names import require_categories, supervision_of
    from benchmark.cli.preflight_places import require_place
    from benchmark.machine.extension import OFFERS, from_extension
    from benchmark.machine.several_devices import require_one_device, workers_for
    from benchmark.runs.units import Shard
    from generation.search.departures import told
    from generation.search.presets import hyper_parameters, trajectory_model

    _require_generated(split)
    require_categories(categories)
    if from_file is not None and is_edited(from_file):
        first = require_root(data, tables, out)
        require_place(out, "--out")
        if dry_run and first.builds:
            say_plan(first.plan(f"build split {split} from the edited scenes of {from_file}"), json_output=json_output)
            return

    def recordings() -> "DataSet":
        return api.open_data(data, tables=tables, workers=workers, out=out, categories=categories)

    wanted = splits_to_build(split, seed, seeds, from_file, freeze, context, recordings)
    frozen = wanted[0].frozen
    shortcuts = {"candidate_limit": vehicles, "candidates": candidates, "rounds": rounds, "parked": parked or None}
    shortcuts["solvable"] = False if keep_unsolvable else None
    hyper = hyper_parameters(preset.value, shortcuts, changes or ())
    asked = _asked(manoeuvres or [], split, from_file)
    if variants is not None and per_scene is not None:
        raise InputError("--variants keeps scenes that differ, --per-scene the most challenging ones; give one of them")
    if surrogate is None and surrogate_checkpoint is not None:
        raise InputError("--surrogate-checkpoint belongs to --surrogate; name the planner that it is for")
    _require_tools(surrogate, surrogate_checkpoint, data, device, denoiser)
    supervision = supervision_of([] if surrogate is None else [surrogate], sample_limit, memory_limit)
    photorealistic = None
    if renderer.value in OFFERS["renderer"]:
        photorealistic = from_extension("renderer", renderer.value)(
            weights_folder,
            drawn_size=render_size.value,
            written_size=written_size.value,
            look=prompt_look.value,
            device=render_device,
            seed=seed,
            tera_operations=tflops,
            estimates_only=dry_run,
        )
        photorealistic.require()
    pixels, named = image_size(size), name_list(scenes)
    if executor is not ExecutorName.LOCAL:
        require_one_device(device, "a Ray cluster gives its tasks GPUs itself")
    place = executor_of(executor, address, workers_for(workers, device))
    mine = None if shard is None else Shard.named(shard)
    require_shardable(mine, surrogate, place)
    if frozen is None:
        ahead = require_source(data, tables, source_split, out, scenes=named, limit=limit)
    else:
        ahead = replace(require_root(data, tables, out), scenes=frozen_scenes(wanted, named, limit))
    require_place(out, "--out")
    if renderer is RendererName.SCHEMATIC and not dry_run:
        # How many a search finds is not known.
        least = 1 if split == "adv" and frozen is None else len(ahead.scenes)
        require_room_to_draw(api.workspace(out), data, wanted[0].split, scenes=least, size=pixels, frames=frames.value)
    unlike = told(preset.value, hyper) if split == "adv" and frozen is None and dry_run else []
    if dry_run and ahead.builds:
        from_what = ahead.counted() if frozen is None else f"frozen split {frozen.name}, {ahead.counted()}"
        then = f"build split {split} from {from_what}; --dry-run says how much work that is once they are there"
        say_plan([*ahead.plan(then), *unlike], json_output=json_output)
        return
    _require_cluster(place, ahead)
    from generation.pipeline.settings import BuildSettings
    from generation.pipeline.split import source_scenes

    under_test = None
    if surrogate is not None:
        under_test = api.planner_under_test(
            surrogate, surrogate_checkpoint, data=data, seed=seed, workers=workers, supervision=supervision
        )
    drawing: Renderer | None = None
    if renderer is RendererName.SCHEMATIC:
        drawing = api.schematic_renderer(pixels)
    rendering = None
    if photorealistic is not None:
        drawing = network = photorealistic.renderer(api.workspace(out).rendering_root())
        rendering = photorealistic.executor(place)
    # Last: the embedded data set takes minutes to build the first time, and a mistyped option should not.
    source = recordings()
    root = api.workspace(out).split_root(source.name, wanted[0].split)
    settings = BuildSettings(
        out=root,
        timings=api.workspace(out).timings_of(root),
        hyper=hyper,
        prior=trajectory_model(
            preset.value,
            denoiser,
            device,
            calls=calls,
            dropout=dropout,
            samples=None if samples is None else samples.value,
        ),
        source_split=source_split,
        scenes=named,
        limit=limit,
        adversaries=adversaries,
        surrogate=under_test,
        per_scene=per_scene,
        variants=variants,
        asked=asked,
        total=top,
        layout=layout.value,
        renderer=drawing,
        frames=frames.value,
        lossless=lossless,
        seed=wanted[0].seed,
        executor=place,
        rendering=rendering,
        together=together,
        keep_rounds=keep_rounds,
        freeze=wanted[0].freeze,
    )
    if photorealistic is not None:
        typer.echo(network.estimate(source.scene(source_scenes(source, settings)[0])).plain(), err=True)
    space, own = api.workspace(out), []
    for one in wanted:
        root = space.split_root(source.name, one.split)
        own.append(replace(settings, out=root, timings=space.timings_of(root), seed=one.seed, freeze=one.freeze))
    if mine is not None and not dry_run:
        build_shards(source, wanted, own, mine, same_place(data, out, tables, categories), json_output=json_output)
        return
    built = []
    for one, of_split in zip(wanted, own, strict=True):
        built.append(build_one(source, one, of_split, unlike, profile=profile, dry_run=dry_run))
        if not json_output:
            typer.echo(built[-1].text if seeds is None else f"{one.split}: {built[-1].text}")
    if json_output:
        print_json(built[0].said if seeds is None else [each.said for each in built])
    if not dry_run:
        say_built(wanted, own, same_place(data, out, tables, categories), json_output=json_output)


def _asked(names: list[str], split: str, from_file: str | None) -> "tuple[Manoeuvre, ...]":
    """The kinds of manoeuvre that are asked for; `InputError` for one that cannot be."""
    if not names:
        return ()
    from generation.search.asked_manoeuvres import askable

    if split != "adv" or from_file is not None:
        raise InputError("--manoeuvre steers the search for split adv, and nothing is searched here; leave it out")
    kinds = tuple(map(askable, names))
    if len(set(kinds)) < len(kinds):
        raise InputError("--manoeuvre names one kind twice; name each once")
    return kinds


def _require_generated(split: str) -> None:
    """Raise `InputError` for a split that cannot be generated."""
    from benchmark.machine.workspace import GENERATED_SPLITS

    if split not in GENERATED_SPLITS:
        close = did_you_mean(split, GENERATED_SPLITS)
        raise InputError(f"cannot generate split {split!r}; {close}those that can be generated are val-r and adv")


def _require_tools(planner: str | None, checkpoint: Path | None, data: str, device: str, denoiser: Path | None) -> None:
    """Refuse a planner under test or a trajectory model that could not run."""
    from benchmark.cli.preflight_names import require_devices, require_models
    from benchmark.cli.preflight_places import require_file

    if planner is not None:
        require_models([planner], checkpoint, data=data)
    require_devices(device)
    require_file(denoiser, "--denoiser")


def _require_cluster(place: "Executor", ahead: "Ahead") -> None:
    """Refuse a cluster that does not answer before minutes go into what is built for it here."""
    from benchmark.machine.ray_cluster import RayCluster, require_answer

    if ahead.builds and isinstance(place, RayCluster) and place.address is not None:
        require_answer(place.address)


def ablate_command(
    model: Annotated[str, typer.Option("--model", help="Planner that has to drive.")] = "constant-velocity",
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    sample_limit: SampleLimitOption = None,
    memory_limit: MemoryLimitOption = None,
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    source_split: Annotated[str, typer.Option(help="Split of the data set to start from.")] = "val",
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    vehicles: Annotated[int | None, typer.Option(min=1, help="Vehicles to try per scene, at most.")] = None,
    candidates: Annotated[int | None, typer.Option(min=4, max=65536, help="Candidates per planning step.")] = None,
    preset: PresetOption = Preset.DEFAULT,
    changes: SetOption = None,
    denoiser: DenoiserOption = None,
    device: DevicesOption = "cpu",
    together: TogetherOption = 1,
    size: SizeOption = "448x256",
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
    executor: ExecutorOption = ExecutorName.LOCAL,
    address: AddressOption = None,
    wide: WideOption = False,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Run the paper's ablation: full search, without refinement (MTR), without scoring (TS), without both."""
    from benchmark.cli.preflight_data_sets import require_source
    from benchmark.cli.preflight_names import supervision_of
    from benchmark.cli.preflight_places import require_place
    from benchmark.machine.several_devices import require_one_device, workers_for
    from benchmark.machine.storage import file_name
    from generation.search.departures import told
    from generation.search.presets import hyper_parameters, trajectory_model

    hyper = hyper_parameters(preset.value, {"candidate_limit": vehicles, "candidates": candidates}, changes or ())
    _require_tools(model, checkpoint, data, device, denoiser)
    supervision = supervision_of([model], sample_limit, memory_limit)
    if executor is not ExecutorName.LOCAL:
        require_one_device(device, "a Ray cluster gives its tasks GPUs itself")
    drawing, place = (
        api.schematic_renderer(image_size(size)),
        executor_of(executor, address, workers_for(workers, device)),
    )
    ahead = require_source(data, tables, source_split, out, scenes=name_list(scenes), limit=limit)
    require_place(out, "--out")
    if dry_run and ahead.builds:
        then = f"search {ahead.counted()} four times, with {model} driving; --dry-run says how long once they are there"
        say_plan([*ahead.plan(then), *told(preset.value, hyper)], json_output=json_output)
        return
    _require_cluster(place, ahead)
    from generation.pipeline.ablation import ablate, ablation_estimate
    from generation.pipeline.settings import BuildSettings

    planner = api.planner_under_test(model, checkpoint, data=data, seed=seed, workers=workers, supervision=supervision)
    source = api.open_data(data, tables=tables, workers=workers, out=out)
    study = api.workspace(out).ablation_root() / source.name / file_name(planner.factory.facts.name)
    settings = BuildSettings(
        out=study,
        timings=api.workspace(out).timings_of(study),
        hyper=hyper,
        prior=trajectory_model(preset.value, denoiser, device),
        source_split=source_split,
        scenes=name_list(scenes),
        limit=limit,
        renderer=drawing,
        frames="keyframes",
        seed=seed,
        executor=place,
        together=together,
    )
    if dry_run:
        estimate = ablation_estimate(source, planner, settings)
        say_plan([estimate, *told(preset.value, hyper)], json_output=json_output)
        return
    report = ablate(source, planner, settings)
    if json_output:
        print_json(report.model_dump(mode="json", by_alias=True))
    else:
        typer.echo(report.table().plain(wide=wide), nl=False)
    say_next(
        f"study: {settings.out}",
        (f"leaderboard{same_place('mini', out)}", "all records in tables beside the paper's"),
        json_output=json_output,
    )
