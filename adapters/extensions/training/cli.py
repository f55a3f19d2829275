"""Commands that train the small models of this package: ``train denoiser|planner|judge|ego-status``."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    Architecture,
    DeviceOption,
    SeedOption,
    SplitOption,
    WorkersOption,
    name_list,
    print_json,
)
from benchmark.cli.whole_help import WholeSummaries

app = typer.Typer(cls=WholeSummaries, help="Train the small models that this package carries.", no_args_is_help=True)


@app.command("denoiser")
def train_denoiser_command(
    tracks: Annotated[
        Path, typer.Option(help="Folder of track files (.npz), nuPlan databases (.db) or nuScenes roots.")
    ],
    out: Annotated[Path, typer.Option(help="Weights file to write; log and progress lie beside it.")],
    steps: Annotated[int | None, typer.Option(min=1, help="Optimisation steps.")] = None,
    held_out: Annotated[str | None, typer.Option(help="Sources that only check, separated by commas.")] = None,
    architecture: Annotated[
        Architecture, typer.Option(help="The package's small network, or the published one, which wants a GPU.")
    ] = Architecture.PACKAGED,
    seed: SeedOption = 0,
    device: DeviceOption = "cpu",
) -> None:
    """Train the trajectory model and describe it; the same command resumes."""
    from benchmark.cli.preflight_names import require_device
    from benchmark.cli.preflight_places import require_folder, require_output_file

    require_device(device)
    require_folder(tracks, "--tracks")
    require_output_file(out, "--out")
    from generation.diffusion.bank import write_bank
    from generation.extensions.denoiser_training.card import write_model_card
    from generation.extensions.denoiser_training.loop import TrainingConfig, train_denoiser

    default = TrainingConfig(tracks=tracks, out=out, seed=seed, device=device).of_architecture(architecture.value)
    checking = default.held_out if held_out is None else name_list(held_out) or ()
    weights = train_denoiser(replace(default, steps=steps or default.steps, held_out=checking))
    write_bank(weights, device=device)
    typer.echo(f"{weights}, {write_model_card(weights, tracks)}")


@app.command("planner")
def train_planner_command(
    model: Annotated[str, typer.Option("--model", help="A miniature (uniad-mini, ...) or image-encoder.")],
    data: Annotated[Path, typer.Option(help="Root of a data set in nuScenes format.")],
    out: Annotated[Path, typer.Option(help="Weights file to write; log, progress and card lie beside it.")],
    split: SplitOption = "train",
    steps: Annotated[int | None, typer.Option(help="Steps of all parts together, instead of the usual.")] = None,
    learning_rate: Annotated[float | None, typer.Option(help="Instead of the usual.")] = None,
    image_encoder: Annotated[Path | None, typer.Option(help="Weights of train planner --model image-encoder.")] = None,
    start_from: Annotated[
        list[Path] | None,
        typer.Option(help="Weights to start from, where names and shapes agree; of several files the last counts."),
    ] = None,
    judged_on: Annotated[Path | None, typer.Option(help="Data set whose split val gives the scores.")] = None,
    adversarial: Annotated[
        list[Path] | None,
        typer.Option(help="Root of adversarial scenes made from the split, learned from as well; repeatable."),
    ] = None,
    also: Annotated[
        list[Path] | None,
        typer.Option(help="Root of another data set with that split, learned from as well; repeatable."),
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="A part of the training, instead of all; repeatable.")] = None,
    kept_of_start: Annotated[
        float, typer.Option(help="Share of the weights of --start-from in what is written, a weighted mean of both.")
    ] = 0.0,
    seed: SeedOption = 0,
    device: DeviceOption = "auto",
    workers: WorkersOption = 0,
) -> None:
    """Train a miniature of a native model on a data set; the same command resumes."""
    from benchmark.cli.preflight_names import require_device, require_trainable
    from benchmark.cli.preflight_places import require_file, require_output_file
    from benchmark.datasets.listing import listed_scenes

    require_trainable(model)
    require_device(device)
    require_output_file(out, "--out", (".safetensors",))
    require_file(image_encoder, "--image-encoder")
    for path in start_from or ():
        require_file(path, "--start-from")
    listed_scenes(data, split)
    if judged_on is not None:
        listed_scenes(judged_on, "val")
    for root in adversarial or ():
        listed_scenes(root, "adv")
    for root in also or ():
        listed_scenes(root, split)
    from adapters.extensions.training.planners import PlannerTraining, train_planner

    training = PlannerTraining(
        model,
        data,
        split,
        out,
        steps,
        seed,
        learning_rate,
        image_encoder,
        tuple(start_from or ()),
        judged_on,
        device,
        api.worker_count(workers),
        tuple(adversarial or ()),
        tuple(also or ()),
        tuple(only or ()),
        kept_of_start,
    )
    print_json(train_planner(training))


@app.command("judge")
def train_judge_command(
    weights: Annotated[Path, typer.Argument(help="Weights file of train planner, with its .json beside it.")],
    data: Annotated[Path, typer.Option(help="Data set whose split val gives the scores.")],
) -> None:
    """Measure a trained miniature again, and write its facts and its card anew."""
    from benchmark.cli.preflight_places import require_file
    from benchmark.datasets.listing import listed_scenes

    require_file(weights, "the weights")
    listed_scenes(data, "val")
    from adapters.extensions.training.planners import judge_again

    print_json(judge_again(weights, data))


@app.command("ego-status")
def train_ego_status_command(
    tracks: Annotated[Path, typer.Option(help="Folder of track files (npz).")],
    out: Annotated[Path, typer.Option(help="Weights file to write (safetensors).")],
    seed: SeedOption = 0,
) -> None:
    """Train the planner that sees its own motion and the command only."""
    from benchmark.cli.preflight_places import require_folder, require_output_file

    require_folder(tracks, "--tracks")
    require_output_file(out, "--out")
    from adapters.extensions.training.ego_status import train_ego_status

    print_json(train_ego_status(tracks, out, seed=seed))
