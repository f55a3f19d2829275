"""Positional encodings of grids: learned ones, and sines."""

import math

import torch
from torch import Tensor, nn


class LearnedGridEncoding(nn.Module):
    """A vector per row and one per column; a cell has those of its column and its row, one after the other."""

    def __init__(self, rows: int, columns: int, channels: int) -> None:
        super().__init__()
        self.row_embed = nn.Embedding(rows, channels // 2)
        self.col_embed = nn.Embedding(columns, channels // 2)
        nn.init.uniform_(self.row_embed.weight)
        nn.init.uniform_(self.col_embed.weight)

    def forward(self) -> Tensor:
        """(rows * columns, channels), row by row."""
        rows, columns = self.row_embed.weight, self.col_embed.weight
        shape = (len(rows), len(columns), -1)
        return torch.cat([columns[None].expand(shape), rows[:, None].expand(shape)], -1).flatten(0, 1)


def sine_features(numbers: Tensor, features: int, temperature: float = 10000.0) -> Tensor:
    """Sines and cosines of falling frequency.

    (..., features) of (...) radians at the highest frequency, sines at even and cosines at odd places; two neighbours
    share a frequency. `temperature` is the ratio of the highest to the frequency that would follow the lowest.
    """
    exponents = torch.arange(0, features, 2, device=numbers.device, dtype=numbers.dtype) / features
    angles = numbers[..., None] / temperature**exponents
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(-2)


def sine_grid_encoding(rows: int, columns: int, features: int, offset: float = -0.5) -> Tensor:
    """Sines of the row, then of the column, each scaled to one turn over the grid.

    (rows * columns, 2 * features) float32, row by row. `offset` is added to rows and columns, which count from one;
    -0.5 puts them at the centres of cells.
    """
    # Kept from dividing by zero in the published code, so it is in the published numbers.
    guard = 1e-6
    row, column = (
        (torch.arange(1, length + 1, dtype=torch.float32) + offset) / (length + guard) * (2 * math.pi)
        for length in (rows, columns)
    )
    shape = (rows, columns, features)
    parts = [
        sine_features(row, features)[:, None].expand(shape),
        sine_features(column, features)[None].expand(shape),
    ]
    return torch.cat(parts, -1).flatten(0, 1)
