"""Command that makes scenes: ``generate``."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import typer

from benchmark import api
from benchmark.cli.built_splits import (
    build_shards,
    build_split_of_command,
    is_edited,
    list_frozen_scenes,
    list_splits_to_build,
    name_after_ego,
    print_built_splits,
    require_cluster,
    require_shardable,
    require_trajectory_model,
)
from benchmark.cli.generate_options import BUILT_IN_RENDERERS, GenerateOptions
from benchmark.cli.options import make_executor, parse_image_size, parse_name_list
from benchmark.cli.output import print_json, print_plan
from benchmark.cli.settings import command, take_options
from benchmark.cli.splits import say_default_split
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.api import PlannerSource
    from generation.labels.manoeuvres import Manoeuvre
    from generation.render.contract import Renderer, RendererSource


@command(GenerateOptions, panel="Run")
def generate_command(options: GenerateOptions) -> None:
    """Build a split, adv or val-r, from recorded scenes; the same command resumes."""
    from benchmark.machine.path_checks import require_place
    from benchmark.machine.several_devices import count_workers, require_one_device
    from benchmark.runs.units import Shard
    from generation.search.differences_from_paper import format_differences
    from generation.search.presets import build_further_settings, build_hyper_parameters, build_trajectory_model
    from generation.search.threat_settings import EgoDriver

    _require_generated(options.split)
    data = api.DataSource.of(options)
    if options.from_file is not None and is_edited(options.from_file):
        first = data.require()
        require_place(options.out, "--out")
        if options.dry_run and first.builds:
            next_step = f"build split {options.split} from the edited scenes of {options.from_file}"
            print_plan(first.plan(next_step), json_output=options.json_output)
            return
    wanted = list_splits_to_build(options, data)
    shortcuts = {
        "candidate_limit": options.vehicles,
        "candidates": options.candidates,
        "rounds": options.rounds,
        "parked": options.parked or None,
        "solvable": False if options.keep_unsolvable else None,
        "ego": None if options.ego == "recorded" else EgoDriver(options.ego),
    }
    hyper = build_hyper_parameters(options.preset, shortcuts, options.changes or ())
    further = build_further_settings(options.preset, shortcuts, options.changes or ())
    wanted = name_after_ego(wanted, hyper.ego.value)
    frozen = wanted[0].frozen
    manoeuvres = _parse_manoeuvres(options)
    if options.variants is not None and options.per_scene is not None:
        raise InputError("--variants keeps scenes that differ, --per-scene the most challenging ones; give only one")
    surrogate = _surrogate(options)
    require_trajectory_model(options.device, options.denoiser)
    of_extension = _find_renderer(options)
    pixels, named = parse_image_size(options.size), parse_name_list(options.scenes)
    if options.executor != "local":
        require_one_device(options.device, "a Ray cluster assigns GPUs to its tasks")
    place = make_executor(options.executor, options.address, count_workers(options.workers, options.device))
    shard = None if options.shard is None else Shard.named(options.shard)
    require_shardable(shard, options.surrogate, place)
    if frozen is None:
        ahead = data.require_source(options.source_split, named, options.limit)
    else:
        ahead = replace(data.require(), scenes=list_frozen_scenes(wanted, named, options.limit))
    require_place(options.out, "--out")
    if options.from_file is None and options.seeds is None:
        say_default_split(options.split)
    if options.renderer == "schematic" and not options.dry_run:
        # The number of scenes that a search finds is not known in advance.
        least = 1 if options.split == "adv" and frozen is None else len(ahead.scenes)
        data.require_room_to_draw(wanted[0].split, scenes=least, size=pixels, frames=options.frames)
    unlike = (
        format_differences(options.preset, hyper)
        if options.split == "adv" and frozen is None and options.dry_run
        else []
    )
    if options.dry_run and ahead.builds:
        from_what = ahead.counted() if frozen is None else f"frozen split {frozen.name}, {ahead.counted()}"
        next_step = (
            f"build split {options.split} from {from_what}; --dry-run estimates the work once the recordings exist"
        )
        print_plan([*ahead.plan(next_step), *unlike], json_output=options.json_output)
        return
    require_cluster(place, ahead)
    from generation.pipeline.recordings import list_source_scenes
    from generation.pipeline.settings import BuildSettings
    from generation.render.contract import SlowRenderer

    under_test = None if surrogate is None else surrogate.under_test(options.workers)
    space = api.workspace(options.out)
    drawing: Renderer | None = api.schematic_renderer(pixels) if options.renderer == "schematic" else None
    rendering = None
    if of_extension is not None:
        drawing = of_extension.renderer(space.rendering_root())
        rendering = of_extension.executor(place)
    # Last: the embedded data set takes minutes to build the first time, and a mistyped option must fail before that.
    source = data.open()
    root = space.split_root(source.name, wanted[0].split)
    others: dict[str, Any] = {
        "out": root,
        "timings": space.timings_of(root),
        "hyper": hyper,
        "prior": build_trajectory_model(
            options.preset,
            options.denoiser,
            options.device,
            calls=options.calls,
            dropout=options.dropout,
            samples=options.samples,
        ),
        "scenes": named,
        "surrogate": under_test,
        "panel": api.planner_panel(options.per_scene) if further else None,
        "further": () if manoeuvres else further,
        "asked": manoeuvres,
        "total": options.top,
        "renderer": drawing,
        "executor": place,
        "rendering": rendering,
    }
    settings = BuildSettings(**{**api.select_matching_options(BuildSettings, options), **others})
    if isinstance(drawing, SlowRenderer):
        typer.echo(drawing.estimate_sentence(source.scene(list_source_scenes(source, settings)[0])), err=True)
    settings_of_splits = []
    for split_to_build in wanted:
        root = space.split_root(source.name, split_to_build.split)
        settings_of_splits.append(
            replace(
                settings,
                out=root,
                timings=space.timings_of(root),
                seed=split_to_build.seed,
                freeze=split_to_build.freeze,
            )
        )
    if shard is not None and not options.dry_run:
        build_shards(source, wanted, settings_of_splits, shard, json_output=options.json_output)
        return
    built = []
    for split_to_build, of_split in zip(wanted, settings_of_splits, strict=True):
        built.append(build_split_of_command(source, split_to_build, of_split, unlike, options))
        if not options.json_output:
            typer.echo(built[-1].text if options.seeds is None else f"{split_to_build.split}: {built[-1].text}")
    if options.json_output:
        print_json(built[0].said if options.seeds is None else [outcome.said for outcome in built])
    if not options.dry_run:
        print_built_splits(wanted, settings_of_splits, source.name, options)


def _parse_manoeuvres(options: GenerateOptions) -> "tuple[Manoeuvre, ...]":
    if not options.manoeuvres:
        return ()
    from generation.search.manoeuvre_requests import parse_manoeuvre

    if options.split != "adv" or options.from_file is not None:
        raise InputError("--manoeuvre steers a search for split adv, and this command does not search; leave it out")
    kinds = tuple(map(parse_manoeuvre, options.manoeuvres))
    if len(set(kinds)) < len(kinds):
        raise InputError("--manoeuvre repeats a kind; give each kind once")
    return kinds


def _surrogate(options: GenerateOptions) -> "PlannerSource | None":
    """The planner that scenes have to be hard for, checked; `InputError` for options of it where there is none."""
    if options.surrogate is None and options.surrogate_checkpoint is not None:
        raise InputError("--surrogate-checkpoint needs --surrogate; name the planner that the checkpoint is for")
    names = () if options.surrogate is None else (options.surrogate,)
    others = {"checkpoint": options.surrogate_checkpoint, "device": None}
    surrogate = api.PlannerSource.of(options, names=names, **others).require()
    return surrogate if names else None


def _find_renderer(options: GenerateOptions) -> "RendererSource | None":
    """The renderer of an extension, if one is named, checked; it is made later."""
    from benchmark.machine.extension import call_extension, list_offers

    own = take_options("renderer", (options.renderer,)).get(options.renderer, {})
    if options.renderer not in list_offers("renderer", BUILT_IN_RENDERERS):
        return None
    renderer: RendererSource = call_extension("renderer", options.renderer, options, **own)
    renderer.require()
    return renderer


def _require_generated(split: str) -> None:
    from benchmark.machine.workspace import GENERATED_SPLITS

    if split not in GENERATED_SPLITS:
        close = did_you_mean(split, GENERATED_SPLITS)
        raise InputError(f"cannot generate split {split!r}; {close}choose val-r or adv")
