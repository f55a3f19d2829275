"""Training of the trajectory denoiser on real tracks."""

import math
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Final, Literal, Self

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.machine.progress import CountedUnits, track_progress
from benchmark.machine.storage import content_key, content_seed, write_json_lines
from benchmark.weights.tensors import TrainingRun, read_run, write_run
from generation.diffusion.checkpoint import save_denoiser
from generation.diffusion.denoiser import PACKAGED, DenoiserConfig, TrajectoryDenoiser
from generation.diffusion.network_calls import parse_device
from generation.diffusion.preconditioning import compute_present_features
from generation.diffusion.schedule import ALPHA_BARS, STEPS
from generation.extensions.denoiser_training.track_sources import find_track_sources
from generation.extensions.denoiser_training.tracks import TrackWindows
from generation.extensions.denoiser_training.window_pool import (
    TrackData,
    TrainingBatch,
    WindowPool,
    compute_window_actions,
    load_track_data,
)

HELD_OUT_SOURCES: Final = (
    "interaction_sample",
    "levelx_commonroad",
    "womd_gpudrive_nocturne",
    "womd_official_testdata",
    "womd_scenarionet",
)
"""Sources whose terms do not let weights made from them be passed on; they only check what was learnt."""
BETAS_ADAM: Final = (0.9, 0.99)
CHECKED_WINDOWS: Final = 4096
FITTED_WINDOWS: Final = 60_000
LEVELS_OF_ROUNDS: Final = 5
"""Noise levels that refinement uses."""
Architecture = Literal["packaged", "published"]
"""The small network of this package, or the published one of 6.7 million parameters, which wants a GPU."""


@dataclass(frozen=True, slots=True)
class TrainingConfig:
    """Settings of a training run.

    Attributes:
        tracks: Folder of recordings (`generation.extensions.denoiser_training.track_sources`).
        out: Weights to write; progress and log lie beside it.
        held_out: Sources that are never trained on.
        steps: Gradient steps.
        batch: Windows per step.
        learning_rate: Peak, after ``warmup`` steps; falls to zero along a cosine.
        warmup: Steps of linear rise.
        weight_decay: Per step, times the learning rate.
        ema: Share of the averaged weights kept per step.
        level_power: A training noise level is 100 times a uniform number to this power. Above one, small levels come
            more often: the rounds of refinement ask at the smallest five, and there is most to learn.
        size_jitter: Windows are scaled by up to this share, which varies speeds.
        untold: Share of windows of which a network that can be told is not told how the vehicle moves now.
        stride_s: Time between the starts of training windows.
        checkpoint_every: Steps between resumable checkpoints, log rows and measurements on held-out windows.
        device: Where the network is trained.
        seed: Of weights, windows and noise.
        denoiser: The network.
    """

    tracks: Path
    out: Path
    held_out: tuple[str, ...] = HELD_OUT_SOURCES
    steps: int = 15_000
    batch: int = 512
    learning_rate: float = 3e-3
    warmup: int = 300
    weight_decay: float = 1e-2
    ema: float = 0.999
    level_power: float = 2.0
    size_jitter: float = 0.3
    untold: float = 0.15
    stride_s: float = 0.1
    checkpoint_every: int = 1000
    seed: int = 0
    device: str = "cpu"
    denoiser: DenoiserConfig = field(default=PACKAGED)

    def of_architecture(self, architecture: Architecture) -> Self:
        """The same run with a network of another kind, and the learning rate and noise levels that suit it."""
        if architecture == "packaged":
            return replace(self, denoiser=PACKAGED)
        # Post-norm attention without preconditioning diverges at the small network's rate; its loss is even in noise.
        return replace(self, denoiser=DenoiserConfig(), learning_rate=2e-4, warmup=2000, level_power=1.0)

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.checkpoint_every) < 1:
            raise InputError("training needs at least one step, one window a step and one step between checkpoints")
        if not self.level_power > 0:
            raise InputError(f"the power of the noise levels must be positive, got {self.level_power}")


_Run = TrainingRun[TrajectoryDenoiser]


def train_denoiser(config: TrainingConfig) -> Path:
    """Train a trajectory denoiser; the same command resumes.

    Noise prediction (paper, Diffusion Trajectory Generator), averaged weights, stored in half precision. Every step
    draws from a generator of its own, so an interrupted run ends with the same bytes as an undisturbed one. The weights
    file is written whenever a state is the best so far on held-out windows, so a run can be left at any time.

    Args:
        config: Recordings, weights to write, settings.

    Returns:
        The weights file: the best state, or the last where nothing is held out. Beside it:
        ``.progress.safetensors`` while unfinished, ``.log.jsonl``.

    Raises:
        InputError: If tracks or device cannot be used, or the progress file belongs to another run.
    """
    data = load_track_data(config.tracks, config.held_out, config.stride_s)
    pool, checking = WindowPool.of(data.training), TrackWindows.joined(list(data.held_out.values()))
    identity = _compute_identity(config)
    run = _start_run(config, pool)
    unfinished = config.out.with_suffix(".progress.safetensors")
    if unfinished.exists():
        read_run(run, unfinished, identity, "settings or tracks")
    run.network.train()
    losses: list[float] = []
    for step in track_progress(
        range(run.step, config.steps),
        total=config.steps - run.step,
        label="training denoiser",
        count=CountedUnits("step", run.step),
    ):
        losses.append(_take_step(run, config, pool, step))
        run.step = step + 1
        if run.step % config.checkpoint_every == 0 or run.step == config.steps:
            run.log.append(
                {"step": run.step, "loss": float(np.mean(losses)), **_evaluate_held_out(run, checking, config)}
            )
            losses = []
            if _is_best(run, config):
                _save_weights(run, config, data, pool.shares, identity)
            write_run(run, unfinished, identity)
            write_json_lines(config.out.with_suffix(".log.jsonl"), run.log)
    unfinished.unlink(missing_ok=True)
    return config.out


def _is_best(run: _Run, config: TrainingConfig) -> bool:
    """Whether no earlier state was better on held-out windows; without any, whether it is the last."""
    losses = [row["held_out_loss"] for row in run.log]
    return run.step == config.steps if losses[-1] is None else losses[-1] <= min(losses)


def _save_weights(run: _Run, config: TrainingConfig, data: TrackData, shares: dict[str, float], identity: str) -> None:
    """Write the averaged weights as they are now, in half precision."""
    half_precision = TrajectoryDenoiser(run.network.config)
    half_precision.load_state_dict(run.average)
    for parameter in half_precision.parameters():
        parameter.data = parameter.data.half()
    facts = {
        "run": identity,
        **{name: getattr(config, name) for name in ("seed", "steps", "batch", "size_jitter", "level_power")},
        "best_step": run.step,
        "held_out": list(config.held_out),
        "windows": {name: len(windows.previous) for name, windows in data.training.items()},
        "rough": {name: windows.rejected.get("rough throughout", 0) for name, windows in data.training.items()},
        "shares": shares,
        "licences": {name: data.licences[name] for name in data.training},
    }
    save_denoiser(config.out, half_precision, facts)


def _compute_identity(config: TrainingConfig) -> str:
    """Key of everything the weights depend on, without the places of files."""
    settings = asdict(config)
    for place in ("tracks", "out"):
        del settings[place]
    contents = {source.name: source.content() for source in find_track_sources(config.tracks)}
    return content_key(settings, contents)


def _start_run(config: TrainingConfig, pool: WindowPool) -> _Run:
    torch.manual_seed(content_seed("denoiser weights", config.seed) % 2**63)
    denoiser = TrajectoryDenoiser(config.denoiser)
    if denoiser.preconditioner is not None:
        draw = np.random.default_rng(content_seed("denoiser gaussian", config.seed))
        drawn = pool.draw(FITTED_WINDOWS, config.size_jitter, draw)
        denoiser.preconditioner.fit(drawn.actions, compute_present_features(torch.from_numpy(drawn.previous)))
    denoiser.to(parse_device(config.device))
    optimiser = torch.optim.AdamW(
        denoiser.parameters(), lr=config.learning_rate, betas=BETAS_ADAM, weight_decay=config.weight_decay
    )
    average = {name: tensor.clone() for name, tensor in denoiser.state_dict().items()}
    return _Run(denoiser, optimiser, average, [])


def _compute_loss(
    denoiser: TrajectoryDenoiser, drawn: TrainingBatch, noise: Floats, timesteps: Floats, conditioned: Bools
) -> Tensor:
    """Mean square error of the predicted noise.

    A preconditioned network is asked in its own unit scale, where axes without motion would drown the others: they
    count by the standard deviation that is left along them.
    """
    device = next(denoiser.parameters()).device
    signal = ALPHA_BARS[timesteps.astype(np.int64)][:, None, None]
    inputs = (timesteps, noise, signal**0.5 * drawn.actions + (1 - signal) ** 0.5 * noise, drawn.previous, conditioned)
    at, eps, noisy, previous, known = (torch.from_numpy(part).to(device, torch.float32) for part in inputs)
    present = compute_present_features(previous) * known[:, None]
    if denoiser.preconditioner is None:
        return torch.nn.functional.mse_loss(denoiser(noisy, at, present), eps)
    split = denoiser.preconditioner.split(noisy, at, present)
    error = split.compute_residual(eps) - split.along(denoiser.network(split.whitened, at, present))
    weight = split.left / split.left.amax(dim=1, keepdim=True)
    return (weight * error.square()).sum() / weight.sum()


def _take_step(run: _Run, config: TrainingConfig, pool: WindowPool, step: int) -> float:
    rng = np.random.default_rng(content_seed("denoiser step", config.seed, step))
    torch.manual_seed(content_seed("denoiser dropout", config.seed, step) % 2**63)
    drawn = pool.draw(config.batch, config.size_jitter, rng)
    timesteps = np.floor(STEPS * rng.random(config.batch) ** config.level_power)
    conditioned = rng.random(config.batch) >= config.untold
    loss = _compute_loss(run.network, drawn, rng.standard_normal(drawn.actions.shape), timesteps, conditioned)
    rising = min((step + 1) / config.warmup, 1.0)
    rate = config.learning_rate * rising * 0.5 * (1 + math.cos(math.pi * step / config.steps))
    for group in run.optimiser.param_groups:
        group["lr"] = rate
    run.optimiser.zero_grad(set_to_none=True)
    loss.backward()  # type: ignore[no-untyped-call]
    torch.nn.utils.clip_grad_norm_(run.network.parameters(), 1.0)
    run.optimiser.step()
    # An early average would keep the random start, so it follows faster in the beginning.
    keep = min(config.ema, (step + 1) / (step + 10))
    with torch.no_grad():
        for name, tensor in run.network.state_dict().items():
            run.average[name].lerp_(tensor, 1.0 - keep)
    return float(loss.detach())


def _evaluate_held_out(run: _Run, checking: TrackWindows, config: TrainingConfig) -> dict[str, float | None]:
    """Losses of the averaged weights on held-out windows, with the same noise every time; ``None`` without any.

    Over all noise levels, over the smallest five, at which refinement asks, and over all without the present motion.
    """
    names = ("held_out_loss", "held_out_loss_of_rounds", "held_out_loss_untold")
    if not len(checking.previous):
        return dict.fromkeys(names)
    judge = TrajectoryDenoiser(run.network.config).to(config.device).eval()
    judge.load_state_dict(run.average)
    rng = np.random.default_rng(content_seed("denoiser check", config.seed))
    chosen = rng.permutation(len(checking.previous))[:CHECKED_WINDOWS]
    drawn = TrainingBatch(compute_window_actions(checking)[chosen], checking.previous[chosen])
    noise, evenly = rng.standard_normal(drawn.actions.shape), np.arange(len(chosen), dtype=np.float64)
    every = np.ones(len(chosen), dtype=bool)
    with torch.inference_mode():
        losses = (
            _compute_loss(judge, drawn, noise, evenly % levels, conditioned)
            for levels, conditioned in ((STEPS, every), (LEVELS_OF_ROUNDS, every), (STEPS, ~every))
        )
        return dict(zip(names, map(float, losses), strict=True))
