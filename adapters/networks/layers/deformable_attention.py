"""Deformable attention (Zhu et al., ICLR 2021): weighted bilinear sampling of feature maps at learned points."""

import math
from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

Shapes = Sequence[tuple[int, int]]
"""Rows and columns of feature maps, fine to coarse."""
Kernel = Literal["bags", "grid"]


def deformable_sampling(
    values: Tensor,
    shapes: Shapes,
    references: Tensor,
    offsets: Tensor,
    weights: Tensor,
    source: Tensor | None = None,
    kernel: Kernel | None = None,
) -> Tensor:
    """Sum of weighted bilinear samples of feature maps, (Q, heads * c); what lies outside a map is zero.

    `values` are (B, S, heads, c) maps of B sources, each flattened row by row, level after level: S cells. `references`
    (Q, ..., 2) are x, y where 0 to 1 spans a map, `offsets` (Q, heads, L, P, 2) x, y in cells of the level, `weights`
    (Q, heads, L, P), `source` (Q,). `kernel` ``bags`` reads the four neighbours of a point as weighted rows of a table,
    ``grid`` is built on ``grid_sample``. By default bags where PyTorch has them: on one processor core they take a
    third of the time of grids, and nothing per point and channel is stored. Where gradients are wanted on a processor,
    grids: theirs take half the time.
    """
    if kernel is None:
        learns = torch.is_grad_enabled() and values.device.type == "cpu"
        kernel = "bags" if values.device.type in ("cpu", "cuda") and not learns else "grid"
    level_sum = _by_bags if kernel == "bags" else _by_grid
    references = references.float().expand(offsets.shape)
    result, start = None, 0
    for level, (rows, columns) in enumerate(shapes):
        # Coordinates stay in single precision for every feature type: half a cell matters.
        x = references[:, :, level, :, 0] * columns + offsets[:, :, level, :, 0].float() - 0.5
        y = references[:, :, level, :, 1] * rows + offsets[:, :, level, :, 1].float() - 0.5
        part = level_sum(values, start, rows, columns, x, y, weights[:, :, level].float(), source)
        result = part if result is None else result + part
        start += rows * columns
    if result is None:
        raise ValueError("deformable sampling needs at least one level")
    return result.flatten(1)


def _by_bags(
    values: Tensor,
    start: int,
    rows: int,
    columns: int,
    x: Tensor,
    y: Tensor,
    weights: Tensor,
    source: Tensor | None,
) -> Tensor:
    """One level: x, y, weights (Q, heads, P) in cells to (Q, heads, c)."""
    _, cells, heads, width = values.shape
    queries, _, points = x.shape
    # Points far outside would overflow the integers; one cell outside, their exact place does not matter.
    x, y = x.clamp(-1, columns)[..., None], y.clamp(-1, rows)[..., None]
    pair = torch.arange(2, device=x.device)
    near_columns, near_rows = x.floor() + pair, y.floor() + pair
    across = (1 - (x - near_columns).abs()) * ((near_columns >= 0) & (near_columns < columns))
    along = (1 - (y - near_rows).abs()) * ((near_rows >= 0) & (near_rows < rows)) * weights[..., None]
    # Neighbours outside have weight zero, so any row of the table may be used for them.
    column = near_columns.to(torch.int32).clamp(0, columns - 1) * heads
    row = near_rows.to(torch.int32).clamp(0, rows - 1) * columns
    first = start if source is None else (source.to(torch.int32) * cells + start)[:, None, None, None]
    row = (row + first) * heads + torch.arange(heads, device=x.device, dtype=torch.int32)[:, None, None]
    summed = F.embedding_bag(
        (row[..., :, None] + column[..., None, :]).view(queries * heads, points * 4),
        values.reshape(-1, width),
        per_sample_weights=(along[..., :, None] * across[..., None, :])
        .view(queries * heads, points * 4)
        .to(values.dtype),
        mode="sum",
    )
    return summed.view(queries, heads, width)


def _by_grid(
    values: Tensor,
    start: int,
    rows: int,
    columns: int,
    x: Tensor,
    y: Tensor,
    weights: Tensor,
    source: Tensor | None,
) -> Tensor:
    """As `_by_bags`: the maps of all sources stacked into one tall image with an empty row between them."""
    sources, _, heads, width = values.shape
    level = values[:, start : start + rows * columns].reshape(sources, rows, columns, heads, width)
    stacked = F.pad(level.permute(3, 4, 0, 1, 2), (0, 0, 1, 0)).flatten(2, 3)
    image = F.pad(stacked, (0, 0, 0, 1)).float()
    first = 1 if source is None else (source * (rows + 1) + 1)[:, None, None]
    height = image.shape[2]
    column = (2 * x.clamp(-1, columns) + 1) / columns - 1
    row = (2 * (y.clamp(-1, rows) + first) + 1) / height - 1
    grid = torch.stack([column, row], -1).transpose(0, 1)
    sampled = F.grid_sample(image, grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    return torch.einsum("hcqp,qhp->qhc", sampled, weights).to(values.dtype)


def ring_of_offsets(heads: int, levels: int, points: int) -> Tensor:
    """Offsets of an untrained network, (heads * levels * points * 2,) x, y in cells.

    Each head looks in its own direction, evenly spread, one to `points` cells away.
    """
    angles = torch.arange(heads, dtype=torch.float32) * (2 * math.pi / heads)
    direction = torch.stack([angles.cos(), angles.sin()], -1)
    direction = direction / direction.abs().amax(-1, keepdim=True)
    distance = torch.arange(1, points + 1, dtype=torch.float32)
    ring = direction[:, None, None, :] * distance[None, None, :, None]
    return ring.expand(heads, levels, points, 2).reshape(-1)


class SamplingPattern(nn.Module):
    """Offsets and weights that deformable attention predicts from its queries; `points` are per head and level."""

    def __init__(self, query_channels: int, channels: int, heads: int, levels: int, points: int) -> None:
        super().__init__()
        self.heads, self.levels, self.points = heads, levels, points
        self.sampling_offsets = nn.Linear(query_channels, heads * levels * points * 2)
        self.attention_weights = nn.Linear(query_channels, heads * levels * points)
        self.value_proj = nn.Linear(channels, channels)
        nn.init.zeros_(self.sampling_offsets.weight)
        nn.init.zeros_(self.attention_weights.weight)
        nn.init.zeros_(self.attention_weights.bias)
        nn.init.xavier_uniform_(self.value_proj.weight)
        nn.init.zeros_(self.value_proj.bias)
        with torch.no_grad():
            self.sampling_offsets.bias.copy_(ring_of_offsets(heads, levels, points))

    def offsets(self, query: Tensor) -> Tensor:
        """(Q, query channels) to (Q, heads, L, P, 2), cells."""
        predicted: Tensor = self.sampling_offsets(query)
        return predicted.view(-1, self.heads, self.levels, self.points, 2)

    def weights(self, query: Tensor) -> Tensor:
        """(Q, query channels) to (Q, heads, L, P); the weights of a head sum to one."""
        logits: Tensor = self.attention_weights(query)
        shares = logits.view(-1, self.heads, self.levels * self.points).float().softmax(-1)
        return shares.view(-1, self.heads, self.levels, self.points)

    def values(self, features: Tensor) -> Tensor:
        """(..., S, C) to (..., S, heads, c)."""
        projected: Tensor = self.value_proj(features)
        return projected.view(*features.shape[:-1], self.heads, -1)


class DeformableAttention(SamplingPattern):
    """Multi-scale deformable attention, added to what it came from. `points` are looks per head and level."""

    def __init__(self, channels: int, heads: int, levels: int, points: int) -> None:
        super().__init__(channels, channels, heads, levels, points)
        self.output_proj = nn.Linear(channels, channels)
        nn.init.xavier_uniform_(self.output_proj.weight)
        nn.init.zeros_(self.output_proj.bias)

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, features: Tensor, shapes: Shapes
    ) -> Tensor:
        """Attention of (Q, C) tokens to (S, C) cells around (Q, 2) x, y, 0 to 1; `positions` steer the pattern only."""
        query = tokens + positions
        sampled = deformable_sampling(
            self.values(features)[None],
            shapes,
            references[:, None, None, None],
            self.offsets(query),
            self.weights(query),
        )
        attended: Tensor = self.output_proj(sampled)
        return tokens + attended
