"""Commands that train the small models of this package: ``train denoiser|planner|judge|ego-status``."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.help import FullSummaryGroup
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_json
from benchmark.cli.settings import Option, command

app = typer.Typer(
    cls=FullSummaryGroup,
    help="Train the small models that this package carries.",
    no_args_is_help=True,
    rich_help_panel="Advanced",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainDenoiserOptions:
    """Options of ``train denoiser``."""

    tracks: Annotated[Path, Option("Folder of track files (.npz), nuPlan databases (.db) or nuScenes roots.", "Input")]
    out: Annotated[Path, Option("Weights file to write; log and progress lie beside it.", "Output")]
    steps: Annotated[int | None, Option("Optimisation steps.", "Execution", min=1)] = None
    held_out: Annotated[str | None, Option("Sources that only check, separated by commas.")] = None
    architecture: Annotated[
        Literal["packaged", "published"],
        Option("The package's small network, or the published one, which wants a GPU."),
    ] = "packaged"
    seed: shared.Seed = 0
    device: shared.Device = "cpu"


@command(TrainDenoiserOptions, app, "denoiser")
def train_denoiser_command(options: TrainDenoiserOptions) -> None:
    """Train the trajectory model and describe it; the same command resumes."""
    from benchmark.machine.path_checks import require_folder, require_output_file

    api.require_device(options.device)
    require_folder(options.tracks, "--tracks")
    require_output_file(options.out, "--out")
    from generation.diffusion.checkpoint import write_bank
    from generation.extensions.denoiser_training.card import write_model_card
    from generation.extensions.denoiser_training.loop import TrainingConfig, train_denoiser

    default = TrainingConfig(
        tracks=options.tracks, out=options.out, seed=options.seed, device=options.device
    ).of_architecture(options.architecture)
    checking = default.held_out if options.held_out is None else parse_name_list(options.held_out) or ()
    weights = train_denoiser(replace(default, steps=options.steps or default.steps, held_out=checking))
    write_bank(weights, device=options.device)
    typer.echo(f"{weights}, {write_model_card(weights, options.tracks)}")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainPlannerOptions:
    """Options of ``train planner``."""

    model: Annotated[str, Option("A miniature (uniad-mini, ...) or image-encoder.", "Planner")]
    data: Annotated[Path, Option("Root of a data set in nuScenes format.", "Input")]
    out: Annotated[Path, Option("Weights file to write; log, progress and card lie beside it.", "Output")]
    split: shared.Split = "train"
    steps: Annotated[int | None, Option("Steps of all parts together, instead of the usual.", "Execution")] = None
    learning_rate: Annotated[float | None, Option("Instead of the usual.")] = None
    image_encoder: Annotated[Path | None, Option("Weights of train planner --model image-encoder.")] = None
    start_from: Annotated[
        tuple[Path, ...] | None,
        Option("Weights to start from, where names and shapes agree; of several files the last counts.", "Input"),
    ] = None
    judged_on: Annotated[Path | None, Option("Data set whose split val gives the scores.", "Input")] = None
    adversarial: Annotated[
        tuple[Path, ...] | None,
        Option("Root of adversarial scenes made from the split, learned from as well; repeatable.", "Input"),
    ] = None
    also: Annotated[
        tuple[Path, ...] | None,
        Option("Root of another data set with that split, learned from as well; repeatable.", "Input"),
    ] = None
    only: Annotated[tuple[str, ...] | None, Option("A part of the training, instead of all; repeatable.")] = None
    kept_of_start: Annotated[
        float, Option("Share of the weights of --start-from in what is written, a weighted mean of both.")
    ] = 0.0
    seed: shared.Seed = 0
    device: shared.Device = "auto"
    workers: shared.Workers = 0


@command(TrainPlannerOptions, app, "planner")
def train_planner_command(options: TrainPlannerOptions) -> None:
    """Train a miniature of a native model on a data set; the same command resumes."""
    from adapters.models import miniature
    from benchmark.datasets.statistics import list_scenes
    from benchmark.machine.path_checks import require_file, require_output_file

    if options.model != "image-encoder":
        miniature(options.model)
    api.require_device(options.device)
    require_output_file(options.out, "--out", (".safetensors",))
    require_file(options.image_encoder, "--image-encoder")
    for path in options.start_from or ():
        require_file(path, "--start-from")
    list_scenes(options.data, options.split)
    if options.judged_on is not None:
        list_scenes(options.judged_on, "val")
    for root in options.adversarial or ():
        list_scenes(root, "adv")
    for root in options.also or ():
        list_scenes(root, options.split)
    from adapters.extensions.training.planners import PlannerTraining, train_planner

    repeated = {name: getattr(options, name) or () for name in ("start_from", "adversarial", "also", "only")}
    special = {"data_root": options.data, "workers": api.worker_count(options.workers), **repeated}
    print_json(train_planner(PlannerTraining(**{**api.select_matching_options(PlannerTraining, options), **special})))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainJudgeOptions:
    """Options of ``train judge``."""

    weights: Annotated[Path, Option("Weights file of train planner, with its .json beside it.", names="")]
    data: Annotated[Path, Option("Data set whose split val gives the scores.", "Input")]


@command(TrainJudgeOptions, app, "judge")
def train_judge_command(options: TrainJudgeOptions) -> None:
    """Measure a trained miniature again, and write its facts and its card anew."""
    from benchmark.datasets.statistics import list_scenes
    from benchmark.machine.path_checks import require_file

    require_file(options.weights, "the weights file")
    list_scenes(options.data, "val")
    from adapters.extensions.training.planners import judge_again

    print_json(judge_again(options.weights, options.data))


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainEgoStatusOptions:
    """Options of ``train ego-status``."""

    tracks: Annotated[Path, Option("Folder of track files (npz).", "Input")]
    out: Annotated[Path, Option("Weights file to write (safetensors).", "Output")]
    seed: shared.Seed = 0


@command(TrainEgoStatusOptions, app, "ego-status")
def train_ego_status_command(options: TrainEgoStatusOptions) -> None:
    """Train the planner that sees its own motion and the command only."""
    from benchmark.machine.path_checks import require_folder, require_output_file

    require_folder(options.tracks, "--tracks")
    require_output_file(options.out, "--out")
    from adapters.extensions.training.ego_status import train_ego_status

    print_json(train_ego_status(options.tracks, options.out, seed=options.seed))
