"""Map elements as the sparse networks keep them, and the parts of the map decoder that depend on it.

A line has its points one after the other: x, y of the first, x, y of the second, ... Metres, lidar frame.
"""

import torch
from torch import Tensor, nn

from adapters.networks.sparse.aggregation import CameraFeatures, CameraSampling, camera_encoder
from adapters.networks.sparse.branches import class_branch, correction_branch, encoder
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.keyframe_pose import RigidMotion

GROUND_Z_M = -1.84023
"""In the lidar frame."""
HEIGHTS_M = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Above the ground, at which images are sampled over points on it."""


def carry_lines(lines: Tensor, motion: RigidMotion) -> Tensor:
    """(..., N, 2 P) lines of a remembered frame, seen from the present one."""
    return motion.move(lines.reshape(*lines.shape[:-2], -1, 2)).view_as(lines)


def at_heights(ground: Tensor) -> Tensor:
    """Points on the ground, (..., H, S, 2) x, y in metres, with each of `HEIGHTS_M`: (..., H, S, 3)."""
    heights = GROUND_Z_M + ground.new_tensor(HEIGHTS_M)[:, None, None]
    return torch.cat([ground, heights.expand(*ground.shape[:-1], 1)], -1)


class LineEncoder(nn.Module):
    """Embedding of lines."""

    def __init__(self, channels: int, points: int) -> None:
        super().__init__()
        self.pos_fc = encoder(2 * points, channels, 2)

    def forward(self, lines: Tensor) -> Tensor:
        """(..., 2 P) to (..., C)."""
        result: Tensor = self.pos_fc(lines)
        return result


class LinePoints(nn.Module):
    """Points around those of a line at which images are sampled."""

    def __init__(self, channels: int, points: int, samples: int) -> None:
        super().__init__()
        self.shape = (points, len(HEIGHTS_M), samples, 2)
        self.learnable_fc = nn.Linear(channels, points * len(HEIGHTS_M) * samples * 2)

    def forward(self, features: Tensor, lines: Tensor) -> Tensor:
        """Points of map elements, (..., N, P * heights * samples, 3) metres.

        From features of (..., N, C) and lines of (..., N, 2 P).
        """
        offsets = self.learnable_fc(features).float().view(*features.shape[:-1], *self.shape)
        ground = lines.view(*lines.shape[:-1], self.shape[0], 1, 1, 2) + offsets
        return at_heights(ground).flatten(-4, -2)


class LineSampling(CameraSampling):
    """Features of images around the points of lines."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.heads)
        channels, points = config.channels, config.points_per_line
        self.kps_generator = LinePoints(channels, points, config.samples_per_height)
        self.output_proj = nn.Linear(channels, channels)
        self.camera_encoder = camera_encoder(channels)
        samples = points * len(HEIGHTS_M) * config.samples_per_height
        self.weights_fc = nn.Linear(channels, levels * samples * config.heads)

    def forward(self, features: Tensor, lines: Tensor, embeddings: Tensor, cameras: CameraFeatures) -> Tensor:
        """(..., N, C), (..., N, 2 P) lines, (..., N, C) embeddings to (..., N, 2 C): what was sampled, and features."""
        sampled = self.sample(features + embeddings, self.kps_generator(features, lines), cameras)
        return torch.cat([sampled, features], -1)


class LineRefinement(nn.Module):
    """Corrected lines and their classes."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__()
        self.layers = correction_branch(config.channels, 2 * config.points_per_line)
        self.cls_layers = class_branch(config.channels, config.map_classes)

    def forward(
        self, features: Tensor, lines: Tensor, embeddings: Tensor, interval_s: Tensor | float
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Refined (..., N, 2 P) lines, (..., N, classes) logits and no quality; time does not matter to lines.

        Features and embeddings are (..., N, C).
        """
        refined = self.layers(features + embeddings).float() + lines
        return refined, self.cls_layers(features).float(), None
