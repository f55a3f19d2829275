"""Attention, positional encodings, and prediction networks under the indices of the published checkpoints."""

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def normalised_branch(channels: int, outputs: int) -> nn.Sequential:
    """Two hidden layers with normalisation and one of `outputs` numbers."""
    return nn.Sequential(
        nn.Linear(channels, channels),
        nn.LayerNorm(channels),
        nn.ReLU(),
        nn.Linear(channels, channels),
        nn.LayerNorm(channels),
        nn.ReLU(),
        nn.Linear(channels, outputs),
    )


def plain_branch(channels: int, outputs: int) -> nn.Sequential:
    """Two hidden layers and one of `outputs` numbers."""
    return nn.Sequential(
        nn.Linear(channels, channels),
        nn.ReLU(),
        nn.Linear(channels, channels),
        nn.ReLU(),
        nn.Linear(channels, outputs),
    )


class PointMixer(nn.Module):
    """A linear layer for each point, beside the maximum over the points of its line."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2
        self.mlp = nn.Sequential(nn.Linear(channels, half), nn.LayerNorm(half), nn.ReLU())

    def forward(self, points: Tensor) -> Tensor:
        """(M, P, C) to (M, P, C)."""
        features = self.mlp(points)
        return torch.cat([features, features.amax(1, keepdim=True).expand_as(features)], -1)


class LaneEncoder(nn.Module):
    """One vector for each line from those of its points (VectorNet, Gao et al., CVPR 2020)."""

    def __init__(self, channels: int, layers: int = 3) -> None:
        super().__init__()
        self.layer_seq = nn.Sequential()
        for layer in range(layers):
            self.layer_seq.add_module(f"lmlp_{layer}", PointMixer(channels))

    def forward(self, points: Tensor) -> Tensor:
        """(M, P, C) to (M, C)."""
        mixed: Tensor = self.layer_seq(points)
        return mixed.amax(1)


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
    """Sines (even places) and cosines (odd) of falling frequency, (..., features) of (...) radians at the highest.

    Two neighbours share a frequency; `temperature` is the ratio of the highest to the one that would follow the lowest.
    """
    exponents = torch.arange(0, features, 2, device=numbers.device, dtype=numbers.dtype) / features
    angles = numbers[..., None] / temperature**exponents
    return torch.stack([angles.sin(), angles.cos()], -1).flatten(-2)


def sine_grid_encoding(rows: int, columns: int, features: int, offset: float = -0.5) -> Tensor:
    """Sines of the row, then of the column, one turn over the grid; (rows * columns, 2 * features) float32.

    Cells come row by row. Rows and columns count from one; an `offset` of -0.5 puts them at the centres of cells.
    """
    # Guard against division by zero in the published code, so it affects the published numbers.
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


class MultiheadAttention(nn.Module):
    """Scaled dot-product attention with the parameters of `torch.nn.MultiheadAttention`.

    Keys or values without the batch axis of the others are projected once for all.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * channels, channels))
        self.in_proj_bias = nn.Parameter(torch.zeros(3 * channels))
        self.out_proj = nn.Linear(channels, channels)
        nn.init.xavier_uniform_(self.in_proj_weight)
        nn.init.zeros_(self.out_proj.bias)

    def forward(self, query: Tensor, key: Tensor, value: Tensor, allowed: Tensor | None = None) -> Tensor:
        """Attention, (..., Q, C), of (..., Q, C) queries to (..., K, C) keys and values.

        `allowed` are (..., Q or 1, K) booleans, ``False`` where a query may not look; a query needs one key at least.
        """
        weights, biases = self.in_proj_weight.chunk(3), self.in_proj_bias.chunk(3)
        q, k, v = (
            F.linear(tokens, weight, bias)
            .view(*tokens.shape[:-1], self.heads, len(bias) // self.heads)
            .transpose(-3, -2)
            for tokens, weight, bias in zip((query, key, value), weights, biases, strict=True)
        )
        axes = max(q.dim(), k.dim(), v.dim())
        leading = next(tokens.shape[:-2] for tokens in (q, k, v) if tokens.dim() == axes)
        q, k, v = (tokens.expand(*leading, *tokens.shape[-2:]) for tokens in (q, k, v))
        mask = None if allowed is None else allowed.unsqueeze(-3)
        attended = F.scaled_dot_product_attention(q, k, v, attn_mask=mask)
        result: Tensor = self.out_proj(attended.transpose(-3, -2).flatten(-2))
        return result


class Attention(nn.Module):
    """Attention, added to what it came from; positions enter queries and keys only."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.attn = MultiheadAttention(channels, heads)

    def forward(
        self,
        tokens: Tensor,
        positions: Tensor,
        keys: Tensor | None = None,
        values: Tensor | None = None,
        allowed: Tensor | None = None,
    ) -> Tensor:
        """Tokens, (..., Q, C), after attention to (..., K, C) others (`keys` include positions) or to each other."""
        query = tokens + positions
        attended: Tensor = self.attn(
            query, query if keys is None else keys, tokens if values is None else values, allowed
        )
        return tokens + attended


class ResidualAttention(nn.Module):
    """Attention, added to what is given for it."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.attn = MultiheadAttention(channels, heads)

    def forward(
        self, tokens: Tensor, query: Tensor, key: Tensor, value: Tensor, allowed: Tensor | None = None
    ) -> Tensor:
        """Tokens, (..., Q, C), plus the attention of (..., Q, C) queries to (..., K, C) keys and values."""
        attended: Tensor = self.attn(query, key, value, allowed)
        return tokens + attended


class ResidualFeedForward(nn.Module):
    """Two linear layers, added to what they came from."""

    def __init__(self, channels: int, hidden: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Sequential(nn.Linear(channels, hidden), nn.ReLU()),
            nn.Linear(hidden, channels),
        )

    def forward(self, tokens: Tensor) -> Tensor:
        """(..., C) to (..., C)."""
        result: Tensor = tokens + self.layers(tokens)
        return result


class CrossAttentionLayer(nn.Module):
    """Attention to other tokens, then a feed-forward block; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([Attention(channels, heads)])
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(2)])

    def forward(self, tokens: Tensor, *seen: Tensor | None) -> Tensor:
        """Arguments and result as in `Attention`."""
        tokens = self.norms[0](self.attentions[0](tokens, *seen))
        result: Tensor = self.norms[1](self.ffns[0](tokens))
        return result


class CrossAttentionDecoder(nn.Module):
    """A stack of `CrossAttentionLayer`; arguments as there, and how many."""

    def __init__(self, channels: int, heads: int, hidden: int, layers: int = 1) -> None:
        super().__init__()
        self.layers = nn.ModuleList([CrossAttentionLayer(channels, heads, hidden) for _ in range(layers)])

    def forward(self, tokens: Tensor, *seen: Tensor | None) -> Tensor:
        """Arguments and result as in `Attention`."""
        for layer in self.layers:
            tokens = layer(tokens, *seen)
        return tokens
