"""Small networks of the sparse models; indices in their names are those of the published checkpoints."""

import math

import torch
from torch import Tensor, nn

from adapters.networks.layers.positional import sine_features


def normalised_layers(inputs: int, channels: int, linears: int, norms: int) -> list[nn.Module]:
    """Groups of linear layers, each followed by a ReLU, with a normalisation after every group."""
    layers: list[nn.Module] = []
    for _ in range(norms):
        for _ in range(linears):
            layers += [nn.Linear(inputs, channels), nn.ReLU()]
            inputs = channels
        layers.append(nn.LayerNorm(channels))
    return layers


def encoder(inputs: int, channels: int, norms: int) -> nn.Sequential:
    """`norms` linear layers, each with ReLU and normalisation."""
    return nn.Sequential(*normalised_layers(inputs, channels, 1, norms))


def point_encoder(inputs: int, channels: int) -> nn.Sequential:
    """A hidden layer with normalisation, and a linear one."""
    return nn.Sequential(*normalised_layers(inputs, channels, 1, 1), nn.Linear(channels, channels))


def class_branch(channels: int, outputs: int) -> nn.Sequential:
    """Two hidden layers with normalisation, and a linear one."""
    return nn.Sequential(*normalised_layers(channels, channels, 1, 2), nn.Linear(channels, outputs))


class Scale(nn.Module):
    """A learned factor for each channel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(channels))

    def forward(self, numbers: Tensor) -> Tensor:
        """(..., channels) to the same."""
        return numbers * self.scale


def correction_branch(channels: int, outputs: int) -> nn.Sequential:
    """Four hidden layers with two normalisations, a linear one and a factor for each number."""
    return nn.Sequential(*normalised_layers(channels, channels, 2, 2), nn.Linear(channels, outputs), Scale(outputs))


class FeedForward(nn.Module):
    """Two linear layers beside a third, all of them on the normalised input."""

    def __init__(self, inputs: int, channels: int, hidden: int) -> None:
        super().__init__()
        self.pre_norm = nn.LayerNorm(inputs)
        self.layers = nn.Sequential(
            nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU()),
            nn.Linear(hidden, channels),
        )
        self.identity_fc = nn.Linear(inputs, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """(..., inputs) to (..., channels)."""
        tokens = self.pre_norm(tokens)
        result: Tensor = self.identity_fc(tokens) + self.layers(tokens)
        return result


def decoupled_attention(
    layer: nn.Module,
    widen: nn.Linear,
    narrow: nn.Linear,
    query: tuple[Tensor, Tensor],
    key: tuple[Tensor, Tensor] | None,
    allowed: Tensor | None = None,
) -> Tensor:
    """Attention in which features and the embeddings of anchors stand side by side instead of being added.

    Args:
        layer: A `ResidualAttention` of twice the width of the features.
        query: Features and embeddings, (..., Q, C) each.
        key: The same of what is looked at, (..., K, C); without it queries look at each other, and then their values
            are not features that `widen` made wide but the queries as they are.
        allowed: As in `ResidualAttention`.

    Returns:
        (..., Q, C) features; there is no way round `narrow`.
    """
    tokens = torch.cat(query, -1)
    keys = tokens if key is None else torch.cat(key, -1)
    values = tokens if key is None else widen(key[0])
    result: Tensor = narrow(layer(tokens, tokens, keys, values, allowed))
    return result


def sine_of_points(points: Tensor, features: int) -> Tensor:
    """Sines and cosines, (..., features) with those of y first, of (..., 2) x, y in metres, which count as turns."""
    return sine_features(2 * math.pi * points.flip(-1), features // 2).flatten(-2)
