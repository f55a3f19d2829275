"""Memory queue of the planner: agents and ego over the last frames."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.sparse.boxes import BOX_CODE, KeyframeMotion, carry_boxes
from adapters.networks.sparse.config import STRIDE, SparseConfig
from adapters.networks.sparse.decoder import GROUND_Z_M, DecodedInstances
from benchmark.constants import EGO_HEIGHT_M

EGO_SIZE_M = (4.08, 1.73, EGO_HEIGHT_M)
"""Along, across, upwards."""
CERTAIN_SCORE = 0.2
"""Agents that were less certain than this are not followed."""
STATUS = 10
"""Acceleration, rotation rate and velocity, three numbers each with x forward, and the steering angle."""
FORWARD_SPEED = 6
"""Where in the status."""
VELOCITY = slice(8, 10)
VELOCITY_Y = 9
"""Where in a box."""


@dataclass(frozen=True, slots=True)
class QueueMemory:
    """Memory of the queue for the next frame; L frames, the oldest first, in the lidar frame of the newest.

    `features` (L, N, C) and `boxes` (L, N, 11) of agents; `periods` (N,) int64, how many of the newest frames an agent
    has been seen in; `ids` (N,) int64; `confidence` (N,) 0 to 1, in the newest frame; `ego_features` (L, 1, C), the
    newest after the planner has looked around; `ego_boxes` (L, 1, 11); `status` (10,) of the ego, as predicted; `front`
    (1, numbers) left by plans (`FrontReader.left`), if they look there.
    """

    features: Tensor
    boxes: Tensor
    periods: Tensor
    ids: Tensor
    confidence: Tensor
    ego_features: Tensor
    ego_boxes: Tensor
    ego_period: int
    status: Tensor
    front: Tensor | None = None


@dataclass(frozen=True, slots=True)
class Queue:
    """Agents and the ego over L frames, the present one last; rows without an agent are zero and not allowed.

    `features` (L, N, C); `boxes` (L, N, 11) in the present lidar frame; `periods` (N,) int64; `ego_features` (L, 1, C);
    `ego_boxes` (L, 1, 11); `ego_period` is how many of the frames count.
    """

    features: Tensor
    boxes: Tensor
    periods: Tensor
    ego_features: Tensor
    ego_boxes: Tensor
    ego_period: int

    def allowed(self) -> Tensor:
        """(N + 1, L) which frames agents, and in the last row the ego, may look at."""
        periods = torch.cat([self.periods, self.periods.new_full((1,), self.ego_period)])
        frames = len(self.features)
        age = torch.arange(frames, 0, -1, device=periods.device)
        return age <= periods[:, None]


class InstanceQueue(nn.Module):
    """Follows agents and the ego from frame to frame."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__()
        self.frames = config.queue_frames
        self.speed_from_poses = config.speed_from_poses
        channels = config.channels
        box = [0.0, 0.5, GROUND_Z_M + EGO_SIZE_M[2] / 2, *map(math.log, EGO_SIZE_M), 1.0, 0.0, 0.0, 0.0, 0.0]
        assert len(box) == BOX_CODE
        self.ego_anchor = nn.Parameter(torch.tensor([box]), requires_grad=False)
        cells = config.image_height_px // STRIDE, config.image_width_px // STRIDE
        self.ego_feature_encoder = nn.Sequential(
            nn.Conv2d(channels, channels, 3, 1, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.Conv2d(channels, channels, 3, 2, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(),
            nn.AvgPool2d((cells[0] // 2, cells[1] // 2)),
        )

    def forward(
        self,
        past: QueueMemory | None,
        motion: KeyframeMotion | None,
        agents: DecodedInstances,
        ids: Tensor,
        front: Tensor,
    ) -> Queue:
        """Agents and the ego over the last frames and this one; `ids` (N,), `front` the (1, C, h, w) coarsest map."""
        feature = self.ego_feature_encoder(front).flatten(1)[None]
        box = self.ego_anchor.float()[None]
        features, boxes = agents.features[None], agents.anchors[None]
        if past is None or motion is None:
            return Queue(features, boxes, torch.ones_like(ids), feature, box, 1)
        box = box.clone()
        if self.speed_from_poses and motion.fresh:
            box[..., VELOCITY] = motion.ego_velocity
        elif motion.fresh:
            box[..., VELOCITY_Y] = past.status[FORWARD_SPEED]
        else:
            box[..., VELOCITY_Y] = 0.0
        # Boxes without an agent are carried along as well, unused.
        old_features, old_boxes, periods = self._followed(past, carry_boxes(past.boxes, motion, 0.0), ids)
        oldest = max(0, len(old_features) + 1 - self.frames)
        return Queue(
            torch.cat([old_features, features])[oldest:],
            torch.cat([old_boxes, boxes])[oldest:],
            (periods + 1).clamp(max=self.frames),
            torch.cat([past.ego_features, feature])[oldest:],
            torch.cat([carry_boxes(past.ego_boxes, motion, 0.0), box])[oldest:],
            min((past.ego_period if motion.fresh else 0) + 1, self.frames),
        )

    def _followed(self, past: QueueMemory, boxes: Tensor, ids: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of the past in the order of this frame's agents, zero for those that were not there or not certain."""
        same = (ids[:, None] == past.ids) & (past.confidence > CERTAIN_SCORE)
        known, row = same.any(1), same.to(torch.uint8).argmax(1)
        nobody = ~known[:, None]
        return (
            past.features[:, row].masked_fill(nobody, 0),
            boxes[:, row].masked_fill(nobody, 0),
            past.periods[row].masked_fill(~known, 0),
        )
