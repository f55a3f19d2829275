"""The noise schedule and DDIM reverse process of the reference model, and a second-order solver of few network calls.

100 steps, scaled-linear betas, noise prediction, predicted clean sample clamped to [-1, 1] without recomputing the
noise. The forward process keeps 48 % of the signal's variance at its last step: it never reaches pure noise.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats

STEPS: Final = 100
"""Steps of the forward process."""
BETA_START: Final = 1e-4
BETA_END: Final = 0.02
CLAMP: Final = 1.0
"""Largest action that a predicted clean sample may hold: 4 m of second difference per half second."""

Denoise = Callable[[Tensor, Tensor], Tensor]
"""Noisy actions (B, 16, 3) and timesteps (1,) to predicted noise (B, 16, 3)."""


def _compute_alpha_bars() -> tuple[Floats, Floats]:
    betas = np.linspace(BETA_START**0.5, BETA_END**0.5, STEPS) ** 2
    return betas, np.cumprod(1.0 - betas)


BETAS, ALPHA_BARS = _compute_alpha_bars()
"""(100,) noise added per step; (100,) share of the signal's variance left after it."""


def get_signal_and_noise(timestep: int) -> tuple[float, float]:
    """Factors of clean sample and noise at a timestep, 0..99: square roots of alpha-bar and of its complement."""
    return float(ALPHA_BARS[timestep] ** 0.5), float((1.0 - ALPHA_BARS[timestep]) ** 0.5)


def get_reference_eta(timestep: int) -> float:
    """Stochasticity of a reverse step in the reference: sqrt(beta / (1 - beta)) of the step before.

    At timestep 0 the reference's index wraps around; nothing is added there, so the value is harmless.
    """
    beta = BETAS[timestep - 1]
    return float((beta / (1.0 - beta)) ** 0.5)


def add_noise(actions: Tensor, noise: Tensor, timestep: int) -> Tensor:
    """Forward process of (B, 16, 3) actions to a timestep, 0..99, in one go, with standard normal noise."""
    signal, spread = get_signal_and_noise(timestep)
    return signal * actions + spread * noise


def compute_reverse_step(
    noisy: Tensor, predicted_noise: Tensor, timestep: int, target: int, *, eta: float = 0.0, fresh: Tensor | None = None
) -> Tensor:
    """One DDIM step (Song, Meng, Ermon 2020, equation 12) of (B, 16, 3) actions from ``timestep`` to ``target``.

    ``target`` is smaller; -1 is the clean sample. ``eta`` of 0 is deterministic, 1 is ancestral sampling; ``fresh`` is
    standard normal noise, used where it is not zero.
    """
    alpha_bar = float(ALPHA_BARS[timestep])
    target_alpha_bar = 1.0 if target < 0 else float(ALPHA_BARS[target])
    clean = ((noisy - (1.0 - alpha_bar) ** 0.5 * predicted_noise) / alpha_bar**0.5).clamp(-CLAMP, CLAMP)
    spread: float = eta * ((1.0 - target_alpha_bar) / (1.0 - alpha_bar) * (1.0 - alpha_bar / target_alpha_bar)) ** 0.5
    moved: Tensor = target_alpha_bar**0.5 * clean + (1.0 - target_alpha_bar - spread**2) ** 0.5 * predicted_noise
    return moved if fresh is None or spread == 0.0 else moved + spread * fresh


def run_reverse_process(
    denoise: Denoise,
    noisy: Tensor,
    timesteps: Sequence[int],
    *,
    draw: Callable[[], Tensor] | None = None,
) -> Tensor:
    """The reverse process of (B, 16, 3) actions from the first of strictly falling ``timesteps`` to the clean sample.

    ``draw`` gives standard normal noise for the reference's stochastic steps; ``None`` is deterministic.
    """
    for timestep, target in zip(timesteps, [*timesteps[1:], -1]):
        predicted = denoise(noisy, torch.tensor([timestep], dtype=torch.float32, device=noisy.device))
        stochastic = draw is not None and target >= 0
        noisy = compute_reverse_step(
            noisy,
            predicted,
            timestep,
            target,
            eta=get_reference_eta(timestep) if stochastic else 0.0,
            fresh=draw() if draw is not None and stochastic else None,
        )
    return noisy


def choose_strided_timesteps(first: int, calls: int | None) -> tuple[int, ...]:
    """Timesteps of calls, strictly falling and evenly spread, from ``first``, 0..99; all of them with ``None``."""
    if not 0 <= first < STEPS:
        raise InputError(f"a noise level must be between 1 and {STEPS}, got {first + 1}")
    if calls is not None and calls < 1:
        raise InputError(f"at least one denoising step is needed, got {calls}")
    if calls is None or calls > first:
        return tuple(range(first, -1, -1))
    spread = np.linspace(first, 0, calls + 1)[:-1] if calls > 1 else np.array([first])
    return tuple(int(timestep) for timestep in np.round(spread))


def compute_log_ratios() -> Floats:
    """(100,) logarithm of signal over noise (of standard deviations) at each timestep, falling."""
    return np.asarray(0.5 * np.log(ALPHA_BARS / (1.0 - ALPHA_BARS)))


def choose_solver_timesteps(calls: int) -> tuple[int, ...]:
    """Timesteps at which the network is asked, evenly spaced in the logarithm of signal over noise.

    Strictly falling from 99 to 0 for 2 to 100 calls. The network knows whole timesteps only, so where the even spacing
    is finer than the schedule, at small noise, it follows the schedule.
    """
    if not 2 <= calls <= STEPS:
        raise InputError(f"a fast reverse process takes 2 to {STEPS} network calls, got {calls}")
    ratios = compute_log_ratios()
    wanted = np.linspace(ratios[-1], ratios[0], calls)
    rising = np.rint(np.interp(wanted[::-1], ratios[::-1], np.arange(STEPS)[::-1].astype(np.float64)))
    index = np.arange(calls)
    apart = np.maximum.accumulate(rising - index) + index
    within = np.minimum(apart, STEPS - calls + index)
    return tuple(int(timestep) for timestep in within[::-1])


def solve(denoise: Denoise, noisy: Tensor, timesteps: Sequence[int]) -> Tensor:
    """Integrate (B, 16, 3) actions from the first timestep to the clean sample (`choose_solver_timesteps`).

    Each step moves towards the clean sample extrapolated from the last two predictions; the first step has one
    prediction only. The last prediction is the answer: the noise left at timestep 0 is a hundredth of an action.
    """
    ratios = compute_log_ratios()
    before: Tensor | None = None
    stepped = 0.0
    for timestep, target in zip(timesteps, [*timesteps[1:], None]):
        signal, spread = get_signal_and_noise(timestep)
        predicted = denoise(noisy, torch.tensor([timestep], dtype=torch.float32, device=noisy.device))
        clean = ((noisy - spread * predicted) / signal).clamp(-CLAMP, CLAMP)
        if target is None:
            return clean
        step = float(ratios[target] - ratios[timestep])
        between = clean if before is None else clean + (0.5 * step / stepped) * (clean - before)
        target_signal, target_noise = get_signal_and_noise(target)
        noisy = (target_noise / spread) * noisy - target_signal * math.expm1(-step) * between
        before, stepped = clean, step
    return noisy
