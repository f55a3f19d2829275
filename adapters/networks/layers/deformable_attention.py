"""Deformable attention (Zhu et al., ICLR 2021): every query looks at a few learned points of feature maps."""

import math

import torch
from torch import Tensor, nn

from adapters.networks.layers.sampling import Shapes, deformable_sampling


def ring_of_offsets(heads: int, levels: int, points: int) -> Tensor:
    """Offsets of an untrained network: each head in its own direction, its points one to `points` cells away.

    (heads * levels * points * 2,) x, y in cells; directions are spread evenly over the circle.
    """
    angles = torch.arange(heads, dtype=torch.float32) * (2 * math.pi / heads)
    direction = torch.stack([angles.cos(), angles.sin()], -1)
    direction = direction / direction.abs().amax(-1, keepdim=True)
    distance = torch.arange(1, points + 1, dtype=torch.float32)
    ring = direction[:, None, None, :] * distance[None, None, :, None]
    return ring.expand(heads, levels, points, 2).reshape(-1)


class SamplingPattern(nn.Module):
    """Pattern that deformable attention predicts from its queries: where to look, and how much each look counts.

    `query_channels` is the width of the queries, `channels` that of the values; `points` are looks per head and level.
    """

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
        """Tokens, (Q, C), that have looked at (S, C) cells of all maps around (Q, 2) x, y, 0 to 1 over every map.

        `positions` are added for the prediction of the pattern only.
        """
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
