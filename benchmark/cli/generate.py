"""Command that makes scenes: ``generate``."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import typer

from benchmark import api
from benchmark.cli.built_splits import (
    build_one,
    build_shards,
    frozen_scenes,
    is_edited,
    require_cluster,
    require_shardable,
    require_trajectory_model,
    say_built,
    splits_to_build,
)
from benchmark.cli.generate_options import GenerateOptions
from benchmark.cli.options import executor_of, image_size, name_list
from benchmark.cli.output import print_json, same_place, say_plan
from benchmark.cli.settings import command
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.api import PlannerSource
    from generation.labels.manoeuvres import Manoeuvre


@command(GenerateOptions)
def generate_command(options: GenerateOptions) -> None:
    """Build a split, adv or val-r, from recorded scenes; the same command resumes."""
    from benchmark.machine.places import require_place
    from benchmark.machine.several_devices import require_one_device, workers_for
    from benchmark.runs.units import Shard
    from generation.search.departures import told
    from generation.search.presets import hyper_parameters, trajectory_model

    _require_generated(options.split)
    data = api.DataSource.of(options)
    if options.from_file is not None and is_edited(options.from_file):
        first = data.require()
        require_place(options.out, "--out")
        if options.dry_run and first.builds:
            then = f"build split {options.split} from the edited scenes of {options.from_file}"
            say_plan(first.plan(then), json_output=options.json_output)
            return
    wanted = splits_to_build(options, data)
    frozen = wanted[0].frozen
    shortcuts = {
        "candidate_limit": options.vehicles,
        "candidates": options.candidates,
        "rounds": options.rounds,
        "parked": options.parked or None,
        "solvable": False if options.keep_unsolvable else None,
    }
    hyper = hyper_parameters(options.preset, shortcuts, options.changes or ())
    asked = _asked(options)
    if options.variants is not None and options.per_scene is not None:
        raise InputError("--variants keeps scenes that differ, --per-scene the most challenging ones; give one of them")
    surrogate = _surrogate(options)
    require_trajectory_model(options.device, options.denoiser)
    photorealistic = _photorealistic(options)
    pixels, named = image_size(options.size), name_list(options.scenes)
    if options.executor != "local":
        require_one_device(options.device, "a Ray cluster gives its tasks GPUs itself")
    place = executor_of(options.executor, options.address, workers_for(options.workers, options.device))
    mine = None if options.shard is None else Shard.named(options.shard)
    require_shardable(mine, options.surrogate, place)
    if frozen is None:
        ahead = data.require_source(options.source_split, named, options.limit)
    else:
        ahead = replace(data.require(), scenes=frozen_scenes(wanted, named, options.limit))
    require_place(options.out, "--out")
    if options.renderer == "schematic" and not options.dry_run:
        # How many a search finds is not known.
        least = 1 if options.split == "adv" and frozen is None else len(ahead.scenes)
        data.require_room_to_draw(wanted[0].split, scenes=least, size=pixels, frames=options.frames)
    unlike = told(options.preset, hyper) if options.split == "adv" and frozen is None and options.dry_run else []
    if options.dry_run and ahead.builds:
        from_what = ahead.counted() if frozen is None else f"frozen split {frozen.name}, {ahead.counted()}"
        then = f"build split {options.split} from {from_what}; --dry-run says how much work that is once they are there"
        say_plan([*ahead.plan(then), *unlike], json_output=options.json_output)
        return
    require_cluster(place, ahead)
    from generation.pipeline.recordings import source_scenes
    from generation.pipeline.settings import BuildSettings

    under_test = None if surrogate is None else surrogate.under_test(options.workers)
    space = api.workspace(options.out)
    drawing = api.schematic_renderer(pixels) if options.renderer == "schematic" else None
    rendering = None
    if photorealistic is not None:
        drawing = network = photorealistic.renderer(space.rendering_root())
        rendering = photorealistic.executor(place)
    # Last: the embedded data set takes minutes to build the first time, and a mistyped option should not.
    source = data.open()
    root = space.split_root(source.name, wanted[0].split)
    others: dict[str, Any] = {
        "out": root,
        "timings": space.timings_of(root),
        "hyper": hyper,
        "prior": trajectory_model(
            options.preset,
            options.denoiser,
            options.device,
            calls=options.calls,
            dropout=options.dropout,
            samples=options.samples,
        ),
        "scenes": named,
        "surrogate": under_test,
        "asked": asked,
        "total": options.top,
        "renderer": drawing,
        "executor": place,
        "rendering": rendering,
    }
    settings = BuildSettings(**{**api.named_alike(BuildSettings, options), **others})
    if photorealistic is not None:
        typer.echo(network.estimate(source.scene(source_scenes(source, settings)[0])).plain(), err=True)
    own = []
    for one in wanted:
        root = space.split_root(source.name, one.split)
        own.append(replace(settings, out=root, timings=space.timings_of(root), seed=one.seed, freeze=one.freeze))
    again = same_place(options)
    if mine is not None and not options.dry_run:
        build_shards(source, wanted, own, mine, again, json_output=options.json_output)
        return
    built = []
    for one, of_split in zip(wanted, own, strict=True):
        built.append(build_one(source, one, of_split, unlike, profile=options.profile))
        if not options.json_output:
            typer.echo(built[-1].text if options.seeds is None else f"{one.split}: {built[-1].text}")
    if options.json_output:
        print_json(built[0].said if options.seeds is None else [each.said for each in built])
    if not options.dry_run:
        say_built(wanted, own, again, json_output=options.json_output)


def _asked(options: GenerateOptions) -> "tuple[Manoeuvre, ...]":
    """The kinds of manoeuvre that are asked for; `InputError` for one that cannot be."""
    if not options.manoeuvres:
        return ()
    from generation.search.asked_manoeuvres import askable

    if options.split != "adv" or options.from_file is not None:
        raise InputError("--manoeuvre steers the search for split adv, and nothing is searched here; leave it out")
    kinds = tuple(map(askable, options.manoeuvres))
    if len(set(kinds)) < len(kinds):
        raise InputError("--manoeuvre names one kind twice; name each once")
    return kinds


def _surrogate(options: GenerateOptions) -> "PlannerSource | None":
    """The planner that scenes have to be hard for, checked; `InputError` for options of it where there is none."""
    if options.surrogate is None and options.surrogate_checkpoint is not None:
        raise InputError("--surrogate-checkpoint belongs to --surrogate; name the planner that it is for")
    names = () if options.surrogate is None else (options.surrogate,)
    others = {"checkpoint": options.surrogate_checkpoint, "device": None}
    found = api.PlannerSource.of(options, names=names, **others).require()
    return found if names else None


def _photorealistic(options: GenerateOptions) -> "Any | None":
    """The renderer of an extension, if one is named, checked; it is made later."""
    from benchmark.machine.extension import OFFERS, from_extension

    if options.renderer not in OFFERS["renderer"]:
        return None
    found = from_extension("renderer", options.renderer)(
        options.weights_folder,
        drawn_size=options.render_size,
        written_size=options.written_size,
        look=options.prompt_look,
        device=options.render_device,
        seed=options.seed,
        tera_operations=options.tflops,
        estimates_only=options.dry_run,
    )
    found.require()
    return found


def _require_generated(split: str) -> None:
    """Raise `InputError` for a split that cannot be generated."""
    from benchmark.machine.workspace import GENERATED_SPLITS

    if split not in GENERATED_SPLITS:
        close = did_you_mean(split, GENERATED_SPLITS)
        raise InputError(f"cannot generate split {split!r}; {close}those that can be generated are val-r and adv")
