"""Attention and feed-forward blocks with residual connections."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class MultiheadAttention(nn.Module):
    """Scaled dot-product attention with the parameters of `torch.nn.MultiheadAttention`.

    Keys or values may lack the batch axis of the others, as when a batch of keys shares its values: they are projected
    once for all.
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
        """Tokens, (..., Q, C), that have looked at other ones, (..., K, C), or, without `keys`, at each other.

        `positions` are those of the tokens, and broadcast; they are already added to `keys`. `allowed` as in
        `MultiheadAttention`.
        """
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
        """Tokens, (..., Q, C), with the attention of (..., Q, C) queries to (..., K, C) keys and values added.

        `allowed` as in `MultiheadAttention`.
        """
        attended: Tensor = self.attn(query, key, value, allowed)
        return tokens + attended


class FeedForward(nn.Module):
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
        self.ffns = nn.ModuleList([FeedForward(channels, hidden)])
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
