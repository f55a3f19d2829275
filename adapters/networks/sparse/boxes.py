"""Boxes as the sparse networks keep them, poses of key frames and the motion between two of them.

A box has 11 numbers: centre x, y, z, logarithms of the extents along and across its heading and upwards, sine and
cosine of the heading (not of one circle in general), velocity x, y, z. Metres, lidar frame.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from adapters.networks.sparse.aggregation import (
    CameraFeatures,
    CameraSampling,
    camera_encoder,
    class_branch,
    correction_branch,
    encoder,
)
from adapters.networks.sparse.config import SparseConfig

USUAL_INTERVAL_S = 0.5
"""Between key frames; it stands in where there is no past."""
LONGEST_INTERVAL_S = 2.0
"""Age beyond which memory is stale."""


@dataclass(frozen=True, slots=True)
class KeyframePose:
    """Time and pose, (4, 4) float64 on the processor, lidar frame to world."""

    timestamp_s: float
    global_T_lidar: Tensor
    scene_token: str


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """Motion, (..., 4, 4) float32, from lidar frames of the past to present ones, of one or several clips."""

    now_T_then: Tensor
    seconds: Tensor | float

    @property
    def fresh(self) -> bool:
        """Whether memory is recent enough to be used."""
        return True

    @property
    def interval_s(self) -> Tensor | float:
        """By which predicted changes of speed are divided."""
        return self.seconds

    def move(self, points: Tensor) -> Tensor:
        """(..., D) points with D = 2 or 3 coordinates, seen from the present lidar frame."""
        axes = points.shape[-1]
        return self.turn(points) + self.now_T_then[..., :axes, 3]

    def turn(self, vectors: Tensor) -> Tensor:
        """(..., D) vectors with D = 2 or 3 coordinates, in the present lidar frame."""
        axes = vectors.shape[-1]
        # Written out, because matrix products may run in reduced precision.
        return (vectors[..., None, :] * self.now_T_then[..., :axes, :axes]).sum(-1)


@dataclass(frozen=True, slots=True)
class KeyframeMotion(RigidMotion):
    """Motion between two frames; `seconds` is rounded to single precision, negative if frames are out of order."""

    seconds: float

    @classmethod
    def between(cls, then: KeyframePose, now: KeyframePose, device: torch.device) -> "KeyframeMotion":
        """Motion between two poses; the matrix is put on the device."""
        # World coordinates are large, so the product is in double precision.
        matrix = torch.linalg.inv(now.global_T_lidar) @ then.global_T_lidar
        return cls(matrix.float().to(device), float(np.float32(now.timestamp_s - then.timestamp_s)))

    @property
    def fresh(self) -> bool:
        """Whether memory is recent enough to be used."""
        return abs(self.seconds) <= LONGEST_INTERVAL_S

    @property
    def interval_s(self) -> float:
        """By which predicted changes of speed are divided."""
        return self.seconds if self.fresh and self.seconds != 0 else USUAL_INTERVAL_S

    @property
    def ego_velocity(self) -> Tensor:
        """(2,) m/s, how the origin of the lidar frame has moved, seen from the present frame."""
        return -self.now_T_then[:2, 3] / self.interval_s


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


class BoxEmbedding(nn.Module):
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
        """Points of (..., N, 11) boxes, (..., N, P, 3) metres: the centre, six near the faces, then learned ones."""
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
