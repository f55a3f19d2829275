"""Deformable attention and its decoder against sums over single points."""

from typing import Any

import torch
from torch import nn

from adapters.networks.layers.deformable_attention import DeformableAttention, ring_of_offsets
from adapters.networks.layers.deformable_decoder import DeformableDecoder, logit
from tests.adapters.networks.layers.slow_sampling import slow_sampling
from tests.adapters.networks.layers.test_attention import perturb

SHAPES = ((3, 4), (2, 2))


def slow_deformable_attention(
    module: DeformableAttention,
    tokens: torch.Tensor,
    positions: torch.Tensor,
    references: torch.Tensor,
    features: torch.Tensor,
    shapes: tuple[tuple[int, int], ...],
) -> torch.Tensor:
    """With the parameters by name and softmax written out."""
    queries, heads, levels, points = len(tokens), module.heads, module.levels, module.points
    query = (tokens + positions).double()
    offsets = query @ module.sampling_offsets.weight.double().T + module.sampling_offsets.bias.double()
    logits = query @ module.attention_weights.weight.double().T + module.attention_weights.bias.double()
    shares = logits.view(queries, heads, levels * points).exp()
    shares = shares / shares.sum(-1, keepdim=True)
    values = features.double() @ module.value_proj.weight.double().T + module.value_proj.bias.double()
    sampled = slow_sampling(
        values.view(1, len(features), heads, -1),
        shapes,
        references[:, None, None, None].double(),
        offsets.view(queries, heads, levels, points, 2),
        shares.view(queries, heads, levels, points),
    )
    return tokens + sampled @ module.output_proj.weight.double().T + module.output_proj.bias.double()


def test_attention_is_the_sum_over_points() -> None:
    torch.manual_seed(0)
    module = DeformableAttention(8, 2, len(SHAPES), 3)
    perturb(module)
    tokens, positions, features = torch.randn(5, 8), torch.randn(5, 8), torch.randn(16, 8)
    references = torch.rand(5, 2)
    with torch.no_grad():
        found = module(tokens, positions, references, features, SHAPES)
        expected = slow_deformable_attention(module, tokens, positions, references, features, SHAPES)
    torch.testing.assert_close(found.double(), expected, rtol=1e-5, atol=1e-5)


def test_untrained_heads_look_in_all_directions() -> None:
    ring = ring_of_offsets(8, 2, 3).view(8, 2, 3, 2)
    torch.testing.assert_close(ring[0, 0, 0], torch.tensor([1.0, 0.0]))
    torch.testing.assert_close(ring[2, 1, 2], torch.tensor([0.0, 3.0]), rtol=0, atol=1e-6)
    torch.testing.assert_close(ring.abs().amax(-1), torch.tensor([1.0, 2.0, 3.0]).expand(8, 2, 3))
    torch.testing.assert_close(ring.sum(0), torch.zeros(2, 3, 2), rtol=0, atol=1e-5)


def test_a_decoder_looks_where_the_layer_before_moved_its_points() -> None:
    torch.manual_seed(1)
    decoder = DeformableDecoder(8, 2, 16, 1, 2, layers=3)
    branches = nn.ModuleList([nn.Linear(8, 5) for _ in range(3)])
    perturb(decoder)
    tokens, positions, features = torch.randn(4, 8), torch.randn(4, 8), torch.randn(12, 8)
    references = torch.rand(4, 3)
    with torch.no_grad():
        decoded = decoder(tokens, positions, references, features, ((3, 4),), branches, (0, 1, 4))
        places, states = references.clone(), tokens
        layer: Any
        for number, layer in enumerate(decoder.layers):
            query = states + positions
            attended = layer.norms[0](states + layer.attentions[0].attn(query, query, states))
            sampled = slow_deformable_attention(
                layer.attentions[1], attended, positions, places[:, :2], features, ((3, 4),)
            ).float()
            states = layer.norms[2](layer.ffns[0](layer.norms[1](sampled)))
            correction = branches[number](states)
            for axis, column in enumerate((0, 1, 4)):
                places[:, axis] = torch.sigmoid(correction[:, column] + logit(places[:, axis]))
            torch.testing.assert_close(decoded.states[number], states, rtol=1e-4, atol=1e-4)
            torch.testing.assert_close(decoded.references[number], places, rtol=1e-4, atol=1e-5)
            torch.testing.assert_close(decoded.corrections[number], correction, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(decoded.first_references, references)
