"""Small networks that read predictions from tokens; indices in their names are those of the published checkpoints."""

import torch
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
