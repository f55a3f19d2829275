"""Pieces about training: the trajectory prior at its published size, timed and to the end, and one miniature, timed."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import torch

from adapters.extensions.training.dataset_mixture import cached_frames_of
from adapters.extensions.training.trainer import fit
from adapters.models import miniature, resolve
from bench.gpu_day.pieces import Piece, Setting
from benchmark.machine.workspace import cache_root
from generation.diffusion.denoiser import DenoiserConfig, TrajectoryDenoiser
from generation.extensions.denoiser_training.loop import TrainingConfig, train_denoiser
from generation.sources.mini import TownSettings, build_town_data_set

FEW, MANY = 50, 350
"""Steps of two runs; what lies between them has no share of reading and writing."""
TINY: Final = (1, 3)
KEPT_EVERY: Final = 250
MINIATURE: Final = "vad-mini"
SPLIT: Final = "val"


def town(setting: Setting) -> Path:
    """Root of the embedded town; of a smaller one in a trial."""
    if setting.tiny:
        return build_town_data_set(setting.kept / "town", TownSettings(1, 0, 0, 64, 36, "keyframes"), workers=1)
    full = TownSettings()
    return build_town_data_set(cache_root() / full.folder_name("mini"), full, workers=1)


def prior_training(setting: Setting, out: Path) -> TrainingConfig:
    """Training of the published network."""
    config = TrainingConfig(setting.tracks or town(setting), out, device=setting.device).of_architecture("published")
    if not setting.tiny:
        return replace(config, checkpoint_every=KEPT_EVERY)
    small = DenoiserConfig(feature_dim=16, heads=2, layers=1, feedforward_dim=16)
    return replace(config, steps=4, batch=8, warmup=2, checkpoint_every=2, stride_s=0.5, denoiser=small)


def prior_speed(setting: Setting) -> dict[str, Any]:
    """Seconds of a step of the trajectory prior, and what the whole training would take."""

    def train(steps: int) -> None:
        out = setting.kept / "timed-prior.safetensors"
        train_denoiser(replace(prior_training(setting, out), steps=steps, checkpoint_every=steps))
        out.unlink()
        out.with_suffix(".log.jsonl").unlink()

    config = prior_training(setting, setting.kept)
    parameters = sum(parameter.numel() for parameter in TrajectoryDenoiser(config.denoiser).parameters())
    whose = {"batch": config.batch, "parameters": parameters, "tracks": "given" if setting.tracks else "embedded town"}
    return _measure_steps(setting, train, (FEW, MANY), config.steps) | whose


def finish_prior(setting: Setting) -> dict[str, Any]:
    """Train the trajectory prior; a call that is ended is gone on with by the next one."""
    train_denoiser(prior_training(setting, _prior(setting)))
    return read_prior_progress(setting)


def read_prior_progress(setting: Setting) -> dict[str, Any]:
    """The last row of the training's log."""
    log = _prior(setting).with_suffix(".log.jsonl")
    rows = log.read_text().splitlines() if log.is_file() else []
    config_steps = prior_training(setting, setting.kept).steps
    last = json.loads(rows[-1]) if rows else {"step": 0}
    return {"step": last["step"], "of": config_steps, "loss": last.get("loss"), "held_out": last.get("held_out_loss")}


def miniature_speed(setting: Setting) -> dict[str, Any]:
    """Seconds of a step of a miniature's first part, and what its whole recipe would take at that rate."""
    root, small = town(setting), miniature(MINIATURE)
    store = cached_frames_of(root, SPLIT, workers=1)
    learned = [number for name in store.scenes for number in store.frames_of(name)]
    frames = [replace(store.frame(number), images=torch.empty(0, dtype=torch.uint8)) for number in learned]
    phases = resolve(small.small.phases)()

    def train(steps: int) -> None:
        network = resolve(small.small.untrained)(small.configuration(), frames, 0)
        out = setting.kept / f"timed-{MINIATURE}.safetensors"
        recipe = replace(phases[0].recipe, steps=steps)
        fit(phases[0].objective(network), store, learned, recipe, out, device=setting.device)
        for left in (out.with_suffix(".progress.safetensors"), out.with_suffix(".log.jsonl")):
            left.unlink(missing_ok=True)

    return _measure_steps(setting, train, (FEW // 5, MANY // 5), sum(phase.recipe.steps for phase in phases))


def _measure_steps(setting: Setting, train: Callable[[int], None], runs: tuple[int, int], steps: int) -> dict[str, Any]:
    """What a step takes, and all steps; nothing in a trial whose few steps are lost in reading and writing."""
    spent, (few, many) = [], TINY if setting.tiny else runs
    # The first run warms up; the second and third are compared.
    for count in (few, few, many):
        begun = setting.now()
        train(count)
        spent.append(setting.now() - begun)
    figures = {"steps": steps, "timed_steps": many - few}
    if spent[2] > spent[1]:
        step_s = (spent[2] - spent[1]) / (many - few)
        return figures | {"step_ms": 1e3 * step_s, "whole_s": step_s * steps}
    if setting.tiny:
        return figures
    raise ValueError("the steps cannot be told from reading and writing; run the piece again")


def _prior(setting: Setting) -> Path:
    return setting.kept / "prior.safetensors"


def describe_timing(figures: dict[str, Any]) -> str:
    """For people."""
    whose = f", {figures['parameters']:,} parameters, batch {figures['batch']}" if "parameters" in figures else ""
    if "step_ms" not in figures:
        return f"too few steps to time{whose}"
    return (
        f"{figures['step_ms']:.1f} ms a step (of {figures['timed_steps']} steps){whose}; "
        f"{figures['steps']:,} steps: {figures['whole_s'] / 60:.1f} min"
    )


def describe_training(figures: dict[str, Any]) -> str:
    """For people."""
    return f"{figures['step']:,} of {figures['of']:,} steps, loss {figures['loss']}, held out {figures['held_out']}"


def training_pieces() -> tuple[Piece, ...]:
    """All of them; the one that may take several calls last."""
    return (
        Piece("prior-speed", "a step of the published trajectory prior", prior_speed, describe_timing),
        Piece(f"{MINIATURE}-speed", "a step of a miniature", miniature_speed, describe_timing),
        Piece(
            "prior-trained",
            "the published trajectory prior, to the end",
            finish_prior,
            describe_training,
            read_prior_progress,
        ),
    )
