"""A full reverse process in a few network calls: a second-order solver of the diffusion's differential equation.

Without fresh noise the reverse process is an ordinary differential equation whose linear part is known. In the
logarithm of signal over noise only the predicted clean sample is left to integrate, which changes slowly (Lu et al.
2022, DPM-Solver++, data prediction, two-step variant), so few steps are enough.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.schedule import ALPHA_BARS, CLAMP, STEPS, Denoise, signal_and_noise


def log_ratios() -> Floats:
    """(100,) logarithm of signal over noise (of standard deviations) at each timestep, falling."""
    return np.asarray(0.5 * np.log(ALPHA_BARS / (1.0 - ALPHA_BARS)))


def solver_timesteps(calls: int) -> tuple[int, ...]:
    """Timesteps at which the network is asked, evenly spaced in the logarithm of signal over noise.

    Strictly falling from 99 to 0 for 2 to 100 calls. The network knows whole timesteps only, so where the even
    spacing is finer than the schedule, at small noise, it follows the schedule.
    """
    if not 2 <= calls <= STEPS:
        raise InputError(f"a fast reverse process asks the network 2 to {STEPS} times, got {calls}")
    ratios = log_ratios()
    wanted = np.linspace(ratios[-1], ratios[0], calls)
    rising = np.rint(np.interp(wanted[::-1], ratios[::-1], np.arange(STEPS)[::-1].astype(np.float64)))
    index = np.arange(calls)
    apart = np.maximum.accumulate(rising - index) + index
    within = np.minimum(apart, STEPS - calls + index)
    return tuple(int(timestep) for timestep in within[::-1])


def solve(denoise: Denoise, noisy: Tensor, timesteps: Sequence[int]) -> Tensor:
    """Integrate from the first timestep to the clean sample.

    Each step moves towards the clean sample extrapolated from the last two predictions; the first step has one
    prediction only. The last prediction is the answer: the noise left at timestep 0 is a hundredth of an action.
    Actions are (B, 16, 3); ``timesteps`` are strictly falling (`solver_timesteps`).
    """
    ratios = log_ratios()
    before: Tensor | None = None
    stepped = 0.0
    for timestep, target in zip(timesteps, [*timesteps[1:], None]):
        signal, spread = signal_and_noise(timestep)
        predicted = denoise(noisy, torch.tensor([timestep], dtype=torch.float32, device=noisy.device))
        clean = ((noisy - spread * predicted) / signal).clamp(-CLAMP, CLAMP)
        if target is None:
            return clean
        step = float(ratios[target] - ratios[timestep])
        between = clean if before is None else clean + (0.5 * step / stepped) * (clean - before)
        there, noise_there = signal_and_noise(target)
        noisy = (noise_there / spread) * noisy - there * math.expm1(-step) * between
        before, stepped = clean, step
    return noisy
