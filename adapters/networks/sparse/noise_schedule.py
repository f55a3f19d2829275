"""How much noise a plan has at each step of the diffusion, and in which numbers it has it."""

import math
from typing import Final

import torch
from torch import Tensor

STEPS: Final = 1000
NOISED_AT: Final = 8
"""Plans start with the noise of this step, although the first step of the way back is a later one."""
TIMESTEPS: Final = (20, 0)
"""Of the way back."""
LATERAL_M: Final = 3.0
"""Steps to the side lie between minus this and this."""
BACKWARD_M: Final = 0.5
"""Steps go back by this at most, ..."""
FORWARD_SPAN_M: Final = 8.1
"""... and forward by what is left of this."""


def signal_shares() -> list[float]:
    """Share of the variance that is signal, for every step (Ho et al., 2020, with betas linear in their roots)."""
    betas = torch.linspace(math.sqrt(1e-4), math.sqrt(2e-2), STEPS, dtype=torch.float32) ** 2
    shares: list[float] = (1 - betas).cumprod(0).tolist()
    return shares


SIGNAL_SHARES: Final = tuple(signal_shares())


def normalised(offsets: Tensor) -> Tensor:
    """(..., 2) metres from step to step, x right and y forward, to -1 ... 1; what is longer is cut."""
    x, y = offsets.unbind(-1)
    across = (x / LATERAL_M).clamp(-1, 1)
    along = ((y + BACKWARD_M) / FORWARD_SPAN_M).clamp(0, 1) * 2 - 1
    return torch.stack([across, along], -1)


def metres(numbers: Tensor) -> Tensor:
    """The inverse of `normalised`, of what was not cut."""
    x, y = numbers.unbind(-1)
    return torch.stack([x * LATERAL_M, (y + 1) / 2 * FORWARD_SPAN_M - BACKWARD_M], -1)


def noised(clean: Tensor, noise: Tensor) -> Tensor:
    """A plan with the noise that all plans start with; both of one shape."""
    share = SIGNAL_SHARES[NOISED_AT]
    return math.sqrt(share) * clean + math.sqrt(1 - share) * noise


def previous_sample(sample: Tensor, clean: Tensor, timestep: int) -> Tensor:
    """Sample one step before, without new noise (DDIM, Song et al., 2021).

    `clean` is what the network takes to be the plan without noise; it is cut to -1 ... 1.
    """
    share = SIGNAL_SHARES[timestep]
    before = SIGNAL_SHARES[timestep - 1] if timestep > 0 else 1.0
    clean = clean.clamp(-1, 1)
    noise = (sample - math.sqrt(share) * clean) / math.sqrt(1 - share)
    return math.sqrt(before) * clean + math.sqrt(1 - before) * noise
