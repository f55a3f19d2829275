"""Several key frames side by side, one of each clip: what their cameras saw, and how the ego moved between them.

A network plans one key frame at a time. In training most of the time would go by between its small operations, so
here the same layers see B key frames at once: all tensors have a leading axis that those of the network do not have.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.networks.sparse.aggregation import NEAREST_DEPTH_M, CameraSampling, deformable_aggregation
from adapters.networks.sparse.keyframe_pose import KeyframeMotion, KeyframePose


@dataclass(frozen=True, slots=True)
class Views:
    """What the cameras of B key frames saw; see `adapters.networks.sparse.aggregation.CameraFeatures`.

    Attributes:
        values: (B * cameras, S, C).
        shapes: Rows and columns of the levels, fine to coarse.
        projections: (B, cameras, 4, 4) float32.
        height_px: Of the input images.
        width_px: Of the input images.
    """

    values: Tensor
    shapes: tuple[tuple[int, int], ...]
    projections: Tensor
    height_px: int
    width_px: int

    @classmethod
    def of(cls, maps: Sequence[Tensor], projections: Tensor, height_px: int, width_px: int) -> Self:
        """From feature maps.

        Args:
            maps: (B * cameras, C, h, w) for each level, fine to coarse.
            projections: (B, cameras, 4, 4).
            height_px: Of the images.
            width_px: Of the images.

        Returns:
            The same, ready to be sampled.
        """
        values = torch.cat([features.flatten(2) for features in maps], -1).transpose(1, 2).contiguous()
        shapes = tuple((int(features.shape[-2]), int(features.shape[-1])) for features in maps)
        return cls(values, shapes, projections, height_px, width_px)

    def locate(self, points: Tensor) -> Tensor:
        """(B, N, P, 3) points in the lidar frame to (B, N, cameras, P, 2) places in the images, 0 to 1 inside."""
        x, y, z = points[:, :, None].unbind(-1)
        rows = self.projections[:, None, :, :3].unbind(3)
        u, v, depth = (row[..., :1] * x + row[..., 1:2] * y + row[..., 2:3] * z + row[..., 3:] for row in rows)
        depth = depth.clamp(min=NEAREST_DEPTH_M)
        return torch.stack([u / depth / self.width_px, v / depth / self.height_px], -1)

    def sample(self, layer: CameraSampling, queries: Tensor, points: Tensor) -> Tensor:
        """What `CameraSampling.sample` gives for each key frame.

        Args:
            layer: Whose weights are used.
            queries: (B, N, C).
            points: (B, N, P, 3) metres, lidar frame.

        Returns:
            (B, N, C).
        """
        batch, count, per_query = points.shape[:3]
        cameras, levels = self.projections.shape[1], len(self.shapes)
        seen_from = layer.camera_encoder(self.projections[:, :, :3].flatten(2))
        logits = layer.weights_fc(queries)[:, :, None] + F.linear(seen_from, layer.weights_fc.weight)[:, None]
        weights = logits.view(batch * count, -1, layer.groups).softmax(1)
        weights = weights.view(batch * count, cameras, levels, per_query, layer.groups)
        first = torch.arange(batch, device=queries.device).repeat_interleave(count) * cameras
        sampled = deformable_aggregation(
            self.values, self.shapes, self.locate(points).flatten(0, 1), weights, first_camera=first
        )
        result: Tensor = layer.output_proj(sampled.view(batch, count, -1))
        return result


@dataclass(frozen=True, slots=True)
class KeyframeMotions:
    """From the key frames before to the present ones; see `adapters.networks.sparse.keyframe_pose.KeyframeMotion`.

    Attributes:
        seconds: (B, 1, 1).
        now_T_then: (B, 1, 4, 4) float32.
    """

    seconds: Tensor
    now_T_then: Tensor

    @classmethod
    def between(cls, then: Sequence[KeyframePose], now: Sequence[KeyframePose], device: torch.device) -> Self:
        """What lies between pairs of poses."""
        found = [KeyframeMotion.between(*pair, device) for pair in zip(then, now, strict=True)]
        seconds = torch.tensor([each.interval_s for each in found], device=device)
        return cls(seconds[:, None, None], torch.stack([each.now_T_then for each in found])[:, None])

    @property
    def ego_velocity(self) -> Tensor:
        """(B, 1, 2) m/s, how the origins of the lidar frames have moved, seen from the present ones."""
        return -self.now_T_then[..., :2, 3] / self.seconds

    def move(self, points: Tensor) -> Tensor:
        """(B, N, D) points with D = 2 or 3 coordinates, seen from the present lidar frames."""
        axes = points.shape[-1]
        return self.turn(points) + self.now_T_then[..., :axes, 3]

    def turn(self, vectors: Tensor) -> Tensor:
        """(B, N, D) vectors with D = 2 or 3 coordinates, in the present lidar frames."""
        axes = vectors.shape[-1]
        return (vectors[..., None, :] * self.now_T_then[..., :axes, :axes]).sum(-1)

    def carry_boxes(self, boxes: Tensor, moving: bool) -> Tensor:
        """(B, N, 11) boxes of the key frames before, seen from the present ones.

        Args:
            boxes: Undecoded.
            moving: Whether they move on with their velocities.

        Returns:
            (B, N, 11).
        """
        centre = boxes[..., :3] + boxes[..., 8:] * self.seconds if moving else boxes[..., :3]
        heading = self.turn(boxes[..., 6:8].flip(-1)).flip(-1)
        return torch.cat([self.move(centre), boxes[..., 3:6], heading, self.turn(boxes[..., 8:])], -1)

    def carry_lines(self, lines: Tensor) -> Tensor:
        """(B, N, 2 P) lines of the key frames before, seen from the present ones."""
        return self.move(lines.reshape(len(lines), -1, 2)).view_as(lines)


def rows_of(tokens: Tensor, rows: Tensor) -> Tensor:
    """(B, N, D) tokens and (B, K) rows to (B, K, D)."""
    return tokens.gather(1, rows[..., None].expand(-1, -1, tokens.shape[-1]))
