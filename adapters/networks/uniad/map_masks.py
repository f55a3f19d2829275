"""Masks on the bird's-eye view from queries of map elements, and how masks share the ground."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

INSIDE = 0.5
"""Mask values above it are inside."""
LEAST_SCORE = 0.1
LARGEST_OVERLAP = 0.4
"""Share of a mask that may be taken by others before it."""
NORM_EPSILON = 1e-6


class MaskSelfAttention(nn.Module):
    """Attention of queries to each other, without residual connection."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels)
        self.proj = nn.Linear(channels, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """(M, C) to (M, C)."""
        q, k, v = self.qkv(tokens).view(len(tokens), 3, self.heads, -1).permute(1, 2, 0, 3).unbind(0)
        attended = F.scaled_dot_product_attention(q[None], k[None], v[None])[0]
        result: Tensor = self.proj(attended.transpose(0, 1).flatten(1))
        return result


class MaskLogits(nn.Module):
    """Share of each query in each cell: a mixture of attention logits over the heads."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q = nn.Linear(channels, channels)
        self.k = nn.Linear(channels, channels)
        self.linear_l1 = nn.Sequential(nn.Linear(heads, heads), nn.ReLU())
        self.linear = nn.Sequential(nn.Linear(heads, 1), nn.ReLU())

    def forward(self, tokens: Tensor, cells: Tensor) -> Tensor:
        """(M, C) and (cells, C) to (M, cells)."""
        q = self.q(tokens).view(len(tokens), self.heads, -1)
        k = self.k(cells).view(len(cells), self.heads, -1)
        logits = torch.einsum("mhc,nhc->mnh", q * q.shape[-1] ** -0.5, k)
        values: Tensor = self.linear(self.linear_l1(logits))
        return values[..., 0]


class MaskAttention(nn.Module):
    """Attention of queries to cells, without residual connection; its mixture of heads in checkpoints is not used."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q = nn.Linear(channels, channels)
        self.k = nn.Linear(channels, channels)
        self.v = nn.Linear(channels, channels)
        self.proj = nn.Linear(channels, channels)
        self.linear_l1 = nn.Sequential(nn.Linear(heads, heads), nn.ReLU())
        self.linear = nn.Sequential(nn.Linear(heads, 1), nn.ReLU())

    def forward(self, tokens: Tensor, cells: Tensor) -> Tensor:
        """(M, C) and (cells, C) to (M, C)."""
        q, k, v = (
            layer(rows).view(len(rows), self.heads, -1).transpose(0, 1)[None]
            for layer, rows in ((self.q, tokens), (self.k, cells), (self.v, cells))
        )
        attended = F.scaled_dot_product_attention(q, k, v)[0]
        result: Tensor = self.proj(attended.transpose(0, 1).flatten(1))
        return result


class MaskMLP(nn.Module):
    """Two linear layers with a Gaussian error unit between."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(channels, 4 * channels)
        self.fc2 = nn.Linear(4 * channels, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """(M, C) to (M, C)."""
        result: Tensor = self.fc2(F.gelu(self.fc1(tokens)))
        return result


class MaskBlock(nn.Module):
    """Attention to the cells and, if wanted, to each other before."""

    def __init__(self, channels: int, heads: int, attend_each_other: bool) -> None:
        super().__init__()
        self.head_norm1 = nn.LayerNorm(channels, NORM_EPSILON)
        self.attn = MaskAttention(channels, heads)
        self.head_norm2 = nn.LayerNorm(channels, NORM_EPSILON)
        self.mlp = MaskMLP(channels)
        if attend_each_other:
            self.self_attention = MaskSelfAttention(channels, heads)
            self.norm3 = nn.LayerNorm(channels, NORM_EPSILON)
        self.attend_each_other = attend_each_other

    def forward(self, tokens: Tensor, cells: Tensor) -> Tensor:
        """(M, C) and (cells, C) to (M, C)."""
        if self.attend_each_other:
            tokens = self.norm3(tokens + self.self_attention(tokens))
        tokens = self.head_norm1(tokens + self.attn(tokens, cells))
        result: Tensor = self.head_norm2(tokens + self.mlp(tokens))
        return result


class MaskDecoder(nn.Module):
    """A stack of `MaskBlock` and mask values after it."""

    def __init__(self, channels: int, heads: int, layers: int, *, attend_each_other: bool) -> None:
        super().__init__()
        self.blocks = nn.ModuleList([MaskBlock(channels, heads, attend_each_other) for _ in range(layers)])
        self.attnen = MaskLogits(channels, heads)

    def forward(self, tokens: Tensor, positions: Tensor | None, cells: Tensor) -> Tensor:
        """Masks, (M, cells) at least 0, of (M, C) tokens over (cells, C); `positions` join every block and the end."""
        for block in self.blocks:
            tokens = block(tokens if positions is None else tokens + positions, cells)
        result: Tensor = self.attnen(tokens if positions is None else tokens + positions, cells)
        return result


@dataclass(frozen=True, slots=True)
class PastedMasks:
    """Masks that share the ground, booleans and values (map classes, rows, columns), and the drivable area.

    `order` are (N,) map elements by falling `scores`: the certainty of the class times the square of the mean value
    inside the mask.
    """

    order: Tensor
    scores: Tensor
    lanes: Tensor
    lane_values: Tensor
    drivable: Tensor


def rank_masks(values: Tensor, scores: Tensor) -> tuple[Tensor, Tensor]:
    """Falling (N,) scores of (N, rows, columns) masks, with the mean value inside, and (N,) their masks."""
    inside = values > INSIDE
    quality = (values * inside).flatten(1).sum(1) / (inside.flatten(1).sum(1).float() + 1)
    best: tuple[Tensor, Tensor] = (scores * quality**2).sort(descending=True)
    return best[0], best[1]


def paste_masks(
    values: Tensor, scores: Tensor, order: Tensor, labels: Tensor, drivable_values: Tensor, classes: int
) -> PastedMasks:
    """Map of masks pasted one after the other, by falling scores as `rank_masks` gives them.

    Elements with low scores are not in it, nor are those whose place is taken. As in the published code, elements of
    class 0 take no place: others are pasted over them. `values` are (N, rows, columns).
    """
    inside = values > INSIDE
    lanes = torch.zeros(classes, *values.shape[1:], dtype=torch.bool, device=values.device)
    lane_values = torch.zeros(classes, *values.shape[1:], device=values.device)
    taken = torch.zeros(values.shape[1:], dtype=torch.bool, device=values.device)
    for element, score in zip(order.tolist(), scores.tolist(), strict=True):
        mask = inside[element]
        area = int(mask.sum())
        if score < LEAST_SCORE or area == 0 or int((mask & taken).sum()) / area > LARGEST_OVERLAP:
            continue
        label = int(labels[element])
        free = mask & ~taken
        lanes[label] |= free
        lane_values[label] = torch.where(free, values[element], lane_values[label])
        taken |= free & (label > 0)
    return PastedMasks(order, scores, lanes, lane_values, drivable_values > INSIDE)
