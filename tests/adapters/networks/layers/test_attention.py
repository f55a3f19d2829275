"""Attention blocks against PyTorch's own and against sums written out."""

import math
from typing import Any

import pytest
import torch
from torch import nn

from adapters.networks.layers.attention import Attention, CrossAttentionLayer, MultiheadAttention


def perturb(module: nn.Module, seed: int = 0) -> None:
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, generator=generator))


def slow_attention(
    module: MultiheadAttention,
    query: torch.Tensor,
    key: torch.Tensor,
    value: torch.Tensor,
    allowed: torch.Tensor | None,
) -> torch.Tensor:
    """One query, one head, one key at a time."""
    channels = query.shape[1]
    width = channels // module.heads
    q, k, v = (
        tokens.double() @ module.in_proj_weight[part * channels : (part + 1) * channels].double().T
        + module.in_proj_bias[part * channels : (part + 1) * channels].double()
        for part, tokens in enumerate((query, key, value))
    )
    result = torch.zeros(len(query), channels, dtype=torch.float64)
    for head in range(module.heads):
        own = slice(head * width, (head + 1) * width)
        for row in range(len(query)):
            keys = [j for j in range(len(key)) if allowed is None or bool(allowed[row, j])]
            shares = [math.exp(float(q[row, own] @ k[j, own]) / math.sqrt(width)) for j in keys]
            for share, j in zip(shares, keys, strict=True):
                result[row, own] += share / sum(shares) * v[j, own]
    return result @ module.out_proj.weight.double().T + module.out_proj.bias.double()


@pytest.mark.parametrize("masked", [False, True])
def test_attention_is_the_sum_over_keys(masked: bool) -> None:
    module = MultiheadAttention(8, 2)
    perturb(module)
    query, key, value = torch.randn(3, 8), torch.randn(5, 8), torch.randn(5, 8)
    allowed = torch.tensor([[True, False, True, False, True]] * 2 + [[False] * 4 + [True]]) if masked else None
    with torch.no_grad():
        found = module(query, key, value, allowed)
        torch.testing.assert_close(
            found.double(), slow_attention(module, query, key, value, allowed), rtol=1e-5, atol=1e-5
        )


def test_parameters_are_those_of_pytorch() -> None:
    module, official = MultiheadAttention(12, 3), nn.MultiheadAttention(12, 3)
    assert list(module.state_dict()) == list(official.state_dict())
    perturb(module)
    official.load_state_dict(module.state_dict())
    query, key = torch.randn(4, 12), torch.randn(6, 12)
    with torch.no_grad():
        expected = official.eval()(query, key, key, need_weights=False)[0]
        torch.testing.assert_close(module(query, key, key), expected, rtol=1e-5, atol=1e-6)


def test_values_may_be_shared_by_a_batch() -> None:
    module = MultiheadAttention(8, 2)
    perturb(module)
    query, key, value = torch.randn(3, 2, 8), torch.randn(3, 5, 8), torch.randn(5, 8)
    allowed = torch.rand(3, 1, 5) > 0.3
    allowed[..., -1] = True
    with torch.no_grad():
        found = module(query, key, value, allowed)
        for batch in range(3):
            own = slow_attention(module, query[batch], key[batch], value, allowed[batch].expand(2, -1))
            torch.testing.assert_close(found[batch].double(), own, rtol=1e-5, atol=1e-5)


def test_a_layer_normalises_after_each_addition_and_positions_enter_queries_and_keys_only() -> None:
    block, layer = Attention(8, 2), CrossAttentionLayer(8, 2, 16)
    perturb(block)
    perturb(layer)
    tokens, positions, keys, values = torch.randn(2, 8), torch.randn(2, 8), torch.randn(5, 8), torch.randn(5, 8)
    parts: Any = layer
    with torch.no_grad():
        own = slow_attention(block.attn, tokens + positions, tokens + positions, tokens, None)
        torch.testing.assert_close(block(tokens, positions).double(), tokens + own, rtol=1e-5, atol=1e-5)
        found = layer(tokens, torch.zeros(8), keys, values)
        attended = tokens + slow_attention(parts.attentions[0].attn, tokens, keys, values, None).float()
        middle = parts.norms[0](attended)
        first, second = parts.ffns[0].layers[0][0], parts.ffns[0].layers[1]
        hidden = (middle @ first.weight.T + first.bias).clamp(min=0)
        expected = parts.norms[1](middle + hidden @ second.weight.T + second.bias)
    torch.testing.assert_close(found, expected, rtol=1e-5, atol=1e-5)
