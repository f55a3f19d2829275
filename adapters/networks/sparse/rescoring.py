"""Which plans run into agents as they are forecast; SparseDrive chooses among the others."""

import math
from typing import Final

import torch
from torch import Tensor

from adapters.networks.sparse.boxes import heading_of
from adapters.networks.sparse.queue import EGO_SIZE_M

EGO_MARGIN: Final = 1.1
"""The ego is taken to be larger by this factor."""
STANDING_M: Final = 0.5
"""What moves less than this over the planned time keeps its heading."""
SURE: Final = 0.5
"""Agents that are less certain are not avoided."""
FAR_M: Final = 1e6
SHIFT: Final = 0.5
BOX: Final = 7
"""Numbers: centre x, y, z, extents along, across and upwards, heading."""


def colliding(plans: Tensor, boxes: Tensor, scores: Tensor, forecasts: Tensor) -> Tensor:
    """Collisions of plans, (M,) booleans.

    `plans` are (M, S, 2) positions and `forecasts` of agents (N, S, 2), metres, lidar frame; `boxes` are (N, 11) and
    `scores` (N,) 0 to 1.
    """
    ego, agents = ego_boxes(plans), agent_boxes(boxes, scores, forecasts)
    ego, agents = ego.expand(len(agents), -1, -1, -1).clone(), agents[:, None].expand(-1, len(plans), -1, -1)
    _shift_as_published(ego)
    hit = corner_inside(ego, agents) | corner_inside(agents, ego)
    return hit.any(-1).any(0)


def ego_boxes(plans: Tensor) -> Tensor:
    """(M, S, 2) positions to (M, S, 7) boxes."""
    heading = _headings(
        torch.cat([torch.zeros_like(plans[:, :1]), plans], 1), plans.new_full((len(plans),), math.pi / 2)
    )
    size = EGO_MARGIN * plans.new_tensor(EGO_SIZE_M)
    height = torch.zeros_like(heading)
    return torch.cat([plans, height[..., None], size.expand(*plans.shape[:2], -1), heading[..., None]], -1)


def agent_boxes(boxes: Tensor, scores: Tensor, forecasts: Tensor) -> Tensor:
    """(N, 11) boxes and (N, S, 2) forecasts to (N, S, 7) boxes; those that are not certain are far away."""
    path = torch.cat([boxes[:, None, :2], forecasts], 1)
    heading = _headings(path, heading_of(boxes))
    rest = torch.cat([boxes[:, 2:3], boxes[:, 3:6].exp()], -1)[:, None].expand(-1, forecasts.shape[1], -1)
    found = torch.cat([forecasts, rest, heading[..., None]], -1)
    return torch.where((scores < SURE)[:, None, None], torch.full_like(found, FAR_M), found)


def _headings(path: Tensor, at_rest: Tensor) -> Tensor:
    """(K, S + 1, 2) positions and (K,) headings of what stands still to (K, S) headings after the first position."""
    central = path[:, 2:] - path[:, :-2]
    along = torch.cat([central, path[:, -1:] - path[:, -2:-1]], 1)
    moving = (path[:, -1] - path[:, 0]).norm(dim=-1) >= STANDING_M
    return torch.where(moving[:, None], torch.atan2(along[..., 1], along[..., 0]), at_rest[:, None])


def _shift_as_published(ego: Tensor) -> None:
    """Change two boxes the way the published code does.

    It means to move every ego box forward, but counts along the wrong axis: all seven numbers of two boxes, those of
    the first plan at the first two steps for the first agent, are changed by the cosine and the sine of the numbers of
    a third one. Published figures were made like this.
    """
    rows = ego.view(-1, BOX)
    sixth = 6
    if len(rows) > sixth:
        rows[0] += SHIFT * rows[sixth].cos()
        rows[1] += SHIFT * rows[sixth].sin()


def corner_inside(boxes: Tensor, others: Tensor) -> Tensor:
    """Whether, (...), a corner of the other box lies in a box or on its edge, seen from above; boxes are (..., 7)."""
    # The published code has corners in double precision.
    boxes, others = boxes.double(), others.double()
    signs = boxes.new_tensor([(1, 1), (1, -1), (-1, -1), (-1, 1)]) / 2
    along, across = (others[..., None, 3:5] * signs).unbind(-1)
    turn = (others[..., 6] - boxes[..., 6])[..., None]
    middle = others[..., :2] - boxes[..., :2]
    sine, cosine = boxes[..., 6].sin(), boxes[..., 6].cos()
    x = (cosine * middle[..., 0] + sine * middle[..., 1])[..., None] + turn.cos() * along - turn.sin() * across
    y = (cosine * middle[..., 1] - sine * middle[..., 0])[..., None] + turn.sin() * along + turn.cos() * across
    inside = (x.abs() <= boxes[..., 3:4] / 2) & (y.abs() <= boxes[..., 4:5] / 2)
    return inside.any(-1)
