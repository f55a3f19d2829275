"""Layers that transformer and condition encoders share (section 3), embeddings of numbers, and latent layout."""

import math
from dataclasses import dataclass
from typing import Final, Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

EPSILON: Final = 1e-6


def modulate(x: Tensor, shift: Tensor, scale: Tensor) -> Tensor:
    """Normalise (..., C) over channels, scale and shift; ``shift`` and ``scale``, added to one, broadcast with it."""
    return torch.addcmul(shift, F.layer_norm(x, x.shape[-1:], eps=EPSILON), 1 + scale)


def split_axis(x: Tensor, axis: int, *sizes: int) -> Tensor:
    """One axis as several of the given sizes; -1 for what is left."""
    out: Tensor = x.unflatten(axis, sizes)  # type: ignore[no-untyped-call]
    return out


def round_to_bfloat16(x: Tensor) -> Tensor:
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
class RotaryRotation:
    """Rotary embedding of a sequence of frames: cosine and sine, (frames, channels of a head / 2) each."""

    cosine: Tensor
    sine: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """Turn each pair of adjacent channels by its angle; x is (..., frames, channels of a head)."""
        first, second = split_axis(x, -1, -1, 2).unbind(-1)
        turned = (first * self.cosine - second * self.sine, second * self.cosine + first * self.sine)
        return torch.stack(turned, -1).flatten(-2)


class RotaryFrequencies(nn.Module):
    """Angles by which one frame turns each pair of channels; the numbers come with the weights."""

    def __init__(self, head_channels: int) -> None:
        super().__init__()
        exponents = torch.arange(0, head_channels, 2) / head_channels
        self.freqs = nn.Parameter(10000.0**-exponents, requires_grad=False)

    def rotation(self, frames: int, dtype: torch.dtype, *, rounded: bool) -> RotaryRotation:
        """Embedding of frames 0, 1, ...; ``rounded`` takes frequencies, positions, products to bfloat16 first."""
        inner = torch.bfloat16 if rounded else torch.float32
        positions = torch.arange(frames, device=self.freqs.device, dtype=inner)
        angles = (positions[:, None] * self.freqs.to(inner)).float()
        return RotaryRotation(angles.cos().to(dtype), angles.sin().to(dtype))


class SequenceSelfAttention(nn.Module):
    """Attention within sequences, with normalised queries and keys."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.q_norm = RootMeanSquareNorm(channels // heads)
        self.k_norm = RootMeanSquareNorm(channels // heads)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor, rotation: RotaryRotation | None = None) -> Tensor:
        """Self-attention in (sequences, length, C); ``rotation`` is of the positions, if they have an order."""
        q, k, v = split_axis(self.qkv(x), -1, 3, self.heads, -1).permute(2, 0, 3, 1, 4).unbind(0)
        q, k = self.q_norm(q), self.k_norm(k)
        if rotation is not None:
            q, k = rotation(q), rotation(k)
        out: Tensor = self.proj(F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2))
        return out


OCTAVES: Final = 4
FOURIER_CHANNELS: Final = 3 * (1 + 2 * OCTAVES)
"""Numbers that `compute_fourier_features` makes of a point."""
SINUSOID_CHANNELS: Final = 256
_LONGEST_PERIOD: Final = 10000.0
_TRAINED_SIDE_PIXELS: Final = 512


def compute_fourier_features(points: Tensor) -> Tensor:
    """(..., 27) of (..., 3): points and the sines and cosines of 1, 2, 4 and 8 times their coordinates (section 3)."""
    octaves = [wave(points * 2**octave) for octave in range(OCTAVES) for wave in (torch.sin, torch.cos)]
    return torch.cat([points, *octaves], -1)


def compute_grid_embedding(
    rows: int, columns: int, pixels: tuple[int, int], channels: int, *, rounded: bool, device: torch.device
) -> Tensor:
    """Position of each token in a frame (section 6), stretched so that images of all sizes span alike.

    (rows * columns, channels): sines and cosines of the column, then of the row. ``rows`` include padding; ``pixels``
    are height and width; ``rounded`` takes frequencies to bfloat16.
    """
    scale = math.sqrt(pixels[0] * pixels[1]) / _TRAINED_SIDE_PIXELS
    side = round(math.sqrt(rows * columns))
    frequencies = _LONGEST_PERIOD ** -(2 * torch.arange(channels // 4, device=device) / (channels // 2))
    frequencies = round_to_bfloat16(frequencies) if rounded else frequencies

    def waves(count: int) -> Tensor:
        places = torch.arange(count, device=device) / scale * side / count
        angles = places[:, None] * frequencies
        return torch.cat([angles.sin(), angles.cos()], -1)

    across = waves(columns)[None].expand(rows, columns, -1)
    down = waves(rows)[:, None].expand(rows, columns, -1)
    return torch.cat([across, down], -1).flatten(0, 1)


class ScalarEmbedding(nn.Module):
    """A timestep or frame rate as a token: sinusoids, then two linear layers (section 4.5)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(SINUSOID_CHANNELS, channels), nn.SiLU(), nn.Linear(channels, channels))

    def forward(self, values: Tensor) -> Tensor:
        """Embedding, (..., C) in the precision of the weights, of (...) values in single precision."""
        half = SINUSOID_CHANNELS // 2
        frequencies = torch.exp(-math.log(_LONGEST_PERIOD) / half * torch.arange(half, device=values.device))
        angles = values[..., None] * frequencies
        out: Tensor = self.mlp(torch.cat([angles.cos(), angles.sin()], -1).to(next(self.parameters()).dtype))
        return out


class PatchEmbedding(nn.Module):
    """One token for 1 x 2 x 2 latent cells; odd sizes are filled up with zeros at the bottom and on the right."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.proj = nn.Conv3d(channels, out, (1, 2, 2), (1, 2, 2))

    def forward(self, cells: Tensor) -> Tensor:
        """Embedding, (b, V, t, S, C), of (b, V, channels, t, h, w) cells."""
        cells = F.pad(cells, (0, cells.shape[-1] % 2, 0, cells.shape[-2] % 2))
        patches = split_axis(split_axis(cells, -1, -1, 2), -3, -1, 2).permute(0, 1, 3, 4, 6, 2, 5, 7)
        # The convolution as a matrix product, which is the same in all precisions and fast in all.
        return F.linear(patches.flatten(5).flatten(3, 4), self.proj.weight.flatten(1), self.proj.bias)


PIXELS_PER_CELL = 8
"""Of an image, along a side of a latent cell."""


@dataclass(frozen=True, slots=True)
class LatentSize:
    """Size of a clip's latent in frames and cells; the rows added in ``padded_rows`` are cropped in the end."""

    frames: int
    rows: int
    columns: int
    padded_rows: int

    @classmethod
    def of(cls, frames: int, height: int, width: int, rows_multiple: int = 1) -> Self:
        """Latent of a clip in pixels; frames are a quarter, rounded up twice, rows padded to ``rows_multiple``."""
        rows, columns = height // PIXELS_PER_CELL, width // PIXELS_PER_CELL
        token_rows, token_columns = -(-rows // 2), -(-columns // 2)
        missing = -token_rows % rows_multiple if token_rows * token_columns % rows_multiple else 0
        padded = 2 * (token_rows + missing) if missing else rows
        return cls((frames + 3) // 4, rows, columns, padded)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tokens."""
        return -(-self.padded_rows // 2), -(-self.columns // 2)

    @property
    def tokens(self) -> int:
        """Tokens of a view's latent frame."""
        return self.grid[0] * self.grid[1]


def unpack_views(latent: Tensor, views: int) -> Tensor:
    """(b, views, channels, t, h, w) from (b, channels * views, t, h, w), channel-major and view-minor."""
    return split_axis(latent, 1, -1, views).transpose(1, 2)


def pack_views(latent: Tensor) -> Tensor:
    """The inverse of `unpack_views`."""
    return latent.transpose(1, 2).flatten(1, 2)


def unpatch(patches: Tensor, size: LatentSize) -> Tensor:
    """(b, V, t, S, 2 * 2 * channels), row, column and channel in this order, to (b, V, channels, t, h, w)."""
    cells = split_axis(split_axis(patches, -1, 2, 2, -1), 3, *size.grid)
    joined = cells.permute(0, 1, 7, 2, 3, 5, 4, 6).flatten(6, 7).flatten(4, 5)
    return joined[..., : size.rows, : size.columns]
