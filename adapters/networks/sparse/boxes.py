"""Boxes as the sparse networks keep them, and the parts of the box decoder that depend on it.

A box has 11 numbers: centre x, y, z, logarithms of the extents along and across its heading and upwards, sine and
cosine of the heading (not of one circle in general), velocity x, y, z. Metres, lidar frame.
"""

import torch
from torch import Tensor, nn

from adapters.networks.sparse.aggregation import CameraFeatures, CameraSampling, camera_encoder
from adapters.networks.sparse.branches import class_branch, correction_branch, encoder
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.keyframe_pose import RigidMotion

BOX_CODE = 11
BOX_QUALITIES = 2
"""Logits of how well the centre and the heading are met."""
FACE = 0.45
"""Points near the faces are this share of an extent away from the centre."""


def carry_boxes(boxes: Tensor, motion: RigidMotion, seconds: Tensor | float) -> Tensor:
    """Boxes of a remembered frame, (..., 11), seen from the present one after `seconds` at their velocities."""
    centre = motion.move(boxes[..., 0:3] + boxes[..., 8:11] * seconds)
    heading = motion.turn(boxes[..., 6:8].flip(-1)).flip(-1)
    return torch.cat([centre, boxes[..., 3:6], heading, motion.turn(boxes[..., 8:11])], -1)


def heading_of(boxes: Tensor) -> Tensor:
    """(..., 11) to (...) radians, counter-clockwise from the x axis."""
    return torch.atan2(boxes[..., 6], boxes[..., 7])


def decode_boxes(boxes: Tensor) -> Tensor:
    """(..., 11) to (..., 10): centre, extents along, across, upwards in metres, heading in radians, velocity."""
    return torch.cat([boxes[..., :3], boxes[..., 3:6].exp(), heading_of(boxes)[..., None], boxes[..., 8:]], -1)


class BoxEncoder(nn.Module):
    """Embedding of boxes: their place, size, heading and velocity, side by side."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.pos_fc = encoder(3, channels // 2, 4)
        self.size_fc = encoder(3, channels // 8, 4)
        self.yaw_fc = encoder(2, channels // 8, 4)
        self.vel_fc = encoder(3, channels // 4, 4)

    def forward(self, boxes: Tensor) -> Tensor:
        """(..., 11) to (..., C)."""
        parts = [
            self.pos_fc(boxes[..., :3]),
            self.size_fc(boxes[..., 3:6]),
            self.yaw_fc(boxes[..., 6:8]),
            self.vel_fc(boxes[..., 8:]),
        ]
        return torch.cat(parts, -1)


class BoxPoints(nn.Module):
    """Points of a box at which images are sampled."""

    def __init__(self, channels: int, learned_points: int) -> None:
        super().__init__()
        faces = torch.eye(3).repeat_interleave(2, 0) * torch.tensor([FACE, -FACE]).repeat(3)[:, None]
        self.fix_scale = nn.Parameter(torch.cat([torch.zeros(1, 3), faces]), requires_grad=False)
        self.learnable_fc = nn.Linear(channels, learned_points * 3)

    def forward(self, features: Tensor, boxes: Tensor) -> Tensor:
        """Points of boxes, (..., N, P, 3) metres: the centre, six near the faces, then those that are learned.

        From features of (..., N, C) and boxes of (..., N, 11).
        """
        learned = self.learnable_fc(features).float().unflatten(-1, (-1, 3)).sigmoid() - 0.5
        shares = torch.cat([self.fix_scale.expand(*boxes.shape[:-1], -1, -1), learned], -2)
        along, across, up = (shares * boxes[..., None, 3:6].exp()).unbind(-1)
        sine, cosine = boxes[..., None, 6], boxes[..., None, 7]
        turned = torch.stack([cosine * along - sine * across, sine * along + cosine * across, up], -1)
        return turned + boxes[..., None, :3]


class BoxSampling(CameraSampling):
    """Features of images at the points of boxes."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.heads)
        channels = config.channels
        self.kps_generator = BoxPoints(channels, config.learned_points)
        self.output_proj = nn.Linear(channels, channels)
        self.camera_encoder = camera_encoder(channels)
        points = len(self.kps_generator.fix_scale) + config.learned_points
        self.weights_fc = nn.Linear(channels, levels * points * config.heads)

    def forward(self, features: Tensor, boxes: Tensor, embeddings: Tensor, cameras: CameraFeatures) -> Tensor:
        """(..., N, C), (..., N, 11) boxes, (..., N, C) embeddings to (..., N, 2 C): what was sampled, and features."""
        sampled = self.sample(features + embeddings, self.kps_generator(features, boxes), cameras)
        return torch.cat([sampled, features], -1)


class BoxRefinement(nn.Module):
    """Corrected boxes, their classes and qualities."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__()
        self.layers = correction_branch(config.channels, BOX_CODE)
        self.cls_layers = class_branch(config.channels, config.agent_classes)
        self.quality_layers = class_branch(config.channels, BOX_QUALITIES)

    def forward(
        self, features: Tensor, boxes: Tensor, embeddings: Tensor, interval_s: Tensor | float
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Refined (..., N, 11) boxes, (..., N, classes) logits and (..., N, 2) qualities.

        Features and embeddings are (..., N, C); changes of velocity are divided by `interval_s`.
        """
        tokens = features + embeddings
        changes = self.layers(tokens).float()
        refined = torch.cat([changes[..., :8] + boxes[..., :8], changes[..., 8:] / interval_s + boxes[..., 8:]], -1)
        return refined, self.cls_layers(features).float(), self.quality_layers(tokens).float()
