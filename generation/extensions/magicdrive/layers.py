"""Layers that the transformer and the condition encoders share (section 3 of the specification)."""

from dataclasses import dataclass
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor, nn

EPSILON: Final = 1e-6


def modulated(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    """Normalise (..., C) over channels, scale and shift; ``shift`` and ``scale``, added to one, broadcast with it."""
    return torch.addcmul(shift, F.layer_norm(x, x.shape[-1:], eps=EPSILON), 1 + scale)


def parted(x: Tensor, axis: int, *sizes: int) -> Tensor:
    """One axis as several of the given sizes; -1 for what is left."""
    out: Tensor = x.unflatten(axis, sizes)  # type: ignore[no-untyped-call]
    return out


def rounded_to_bfloat16(x: Tensor) -> Tensor:
    """The nearest numbers that bfloat16 has, in single precision."""
    return x.to(torch.bfloat16).float()


class RootMeanSquareNorm(nn.Module):
    """Queries and keys are scaled to unit mean square; in single precision, whichever the network computes in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))

    def forward(self, x: Tensor) -> Tensor:
        """(..., channels) to the same shape and precision."""
        exact = x.float()
        scaled = exact * torch.rsqrt(exact.square().mean(-1, keepdim=True) + EPSILON)
        return scaled.to(x.dtype) * self.weight


class Mlp(nn.Module):
    """Two linear layers about a GELU in its tanh form."""

    def __init__(self, channels: int, hidden: int, out: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, hidden)
        self.fc2 = nn.Linear(hidden, out)

    def forward(self, x: Tensor) -> Tensor:
        """(..., channels) to (..., out)."""
        out: Tensor = self.fc2(F.gelu(self.fc1(x), approximate="tanh"))
        return out


@dataclass(frozen=True, slots=True)
class Rotation:
    """Rotary embedding of a sequence of frames: cosine and sine, (frames, channels of a head / 2) each."""

    cosine: Tensor
    sine: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """Turn each pair of adjacent channels by its angle; x is (..., frames, channels of a head)."""
        first, second = parted(x, -1, -1, 2).unbind(-1)
        turned = (first * self.cosine - second * self.sine, second * self.cosine + first * self.sine)
        return torch.stack(turned, -1).flatten(-2)


class RotaryFrequencies(nn.Module):
    """Angles by which one frame turns each pair of channels; the numbers come with the weights."""

    def __init__(self, head_channels: int) -> None:
        super().__init__()
        exponents = torch.arange(0, head_channels, 2) / head_channels
        self.freqs = nn.Parameter(10000.0**-exponents, requires_grad=False)

    def rotation(self, frames: int, dtype: torch.dtype, *, rounded: bool) -> Rotation:
        """The embedding of frames 0, 1, ... for queries and keys of a precision.

        ``rounded`` takes frequencies, positions and their products to bfloat16 first.
        """
        inner = torch.bfloat16 if rounded else torch.float32
        positions = torch.arange(frames, device=self.freqs.device, dtype=inner)
        angles = (positions[:, None] * self.freqs.to(inner)).float()
        return Rotation(angles.cos().to(dtype), angles.sin().to(dtype))


class SelfAttention(nn.Module):
    """Attention within sequences, with normalised queries and keys."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.q_norm = RootMeanSquareNorm(channels // heads)
        self.k_norm = RootMeanSquareNorm(channels // heads)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor, rotation: Rotation | None = None) -> Tensor:
        """Self-attention in (sequences, length, C); ``rotation`` is of the positions, if they have an order."""
        q, k, v = parted(self.qkv(x), -1, 3, self.heads, -1).permute(2, 0, 3, 1, 4).unbind(0)
        q, k = self.q_norm(q), self.k_norm(k)
        if rotation is not None:
            q, k = rotation(q), rotation(k)
        out: Tensor = self.proj(F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2))
        return out
