"""Where things are, as numbers a network can read: grids, timesteps, metres."""

import math
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from generation.extensions.magicdrive.layers import parted, rounded_to_bfloat16

OCTAVES: Final = 4
FOURIER_CHANNELS: Final = 3 * (1 + 2 * OCTAVES)
"""Numbers that `fourier` makes of a point."""
SINUSOID_CHANNELS: Final = 256
_LONGEST_PERIOD: Final = 10000.0
_TRAINED_SIDE_PIXELS: Final = 512


def fourier(points: Tensor) -> Tensor:
    """Points and the sines and cosines of 1, 2, 4 and 8 times their coordinates (section 3).

    (..., 3) become (..., 27).
    """
    octaves = [wave(points * 2**octave) for octave in range(OCTAVES) for wave in (torch.sin, torch.cos)]
    return torch.cat([points, *octaves], -1)


def grid_embedding(
    rows: int, columns: int, pixels: tuple[int, int], channels: int, *, rounded: bool, device: torch.device
) -> Tensor:
    """Position of each token in a frame (section 6), stretched so that images of all sizes span alike.

    (rows * columns, channels): sines and cosines of the column, then of the row. ``rows`` have padding included;
    ``pixels`` are height and width of the image; ``rounded`` takes frequencies to bfloat16.
    """
    scale = math.sqrt(pixels[0] * pixels[1]) / _TRAINED_SIDE_PIXELS
    side = round(math.sqrt(rows * columns))
    frequencies = _LONGEST_PERIOD ** -(2 * torch.arange(channels // 4, device=device) / (channels // 2))
    frequencies = rounded_to_bfloat16(frequencies) if rounded else frequencies

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
        patches = parted(parted(cells, -1, -1, 2), -3, -1, 2).permute(0, 1, 3, 4, 6, 2, 5, 7)
        # The convolution as a matrix product, which is the same in all precisions and fast in all.
        return F.linear(patches.flatten(5).flatten(3, 4), self.proj.weight.flatten(1), self.proj.bias)
