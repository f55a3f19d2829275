"""Weighted bilinear sampling at a few points per query: the kernel of every deformable attention."""

from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

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
    """Sum of weighted bilinear samples of feature maps; what lies outside a map is zero.

    Args:
        values: (B, S, heads, c) maps of B sources, each flattened row by row, level after level: S cells.
        references: (Q, ..., 2) x, y where 0 to 1 spans a map; broadcast against `offsets`.
        offsets: (Q, heads, L, P, 2) x, y in cells of the level.
        weights: (Q, heads, L, P).
        source: (Q,) which source each query samples; the first by default.
        kernel: ``bags`` reads the four neighbours of a point as weighted rows of a table, ``grid`` is built on
            ``grid_sample``. By default bags where PyTorch has them: on one processor core they take a third of
            the time of grids, and nothing per point and channel is stored. Where gradients are wanted on a
            processor, grids: theirs take half the time.

    Returns:
        (Q, heads * c), in the type of `values`.
    """
    if kernel is None:
        learns = torch.is_grad_enabled() and values.device.type == "cpu"
        kernel = "bags" if values.device.type in ("cpu", "cuda") and not learns else "grid"
    level_sum = _by_bags if kernel == "bags" else _by_grid
    references = references.float().expand(offsets.shape)
    result, start = None, 0
    for level, (rows, columns) in enumerate(shapes):
        # Coordinates stay in single precision whatever the type of the features: half a cell matters.
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
    # Points far outside would overflow the integers; one cell outside they are as good as anywhere.
    x, y = x.clamp(-1, columns)[..., None], y.clamp(-1, rows)[..., None]
    pair = torch.arange(2, device=x.device)
    near_columns, near_rows = x.floor() + pair, y.floor() + pair
    across = (1 - (x - near_columns).abs()) * ((near_columns >= 0) & (near_columns < columns))
    along = (1 - (y - near_rows).abs()) * ((near_rows >= 0) & (near_rows < rows)) * weights[..., None]
    # Neighbours outside have no share, so any row of the table may stand for them.
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
