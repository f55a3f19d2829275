"""Losses of plans: clearance to future boxes, which keeps closed-loop plans from creeping in, and VAD's constraints.

VAD's (section 3.4) look at centres, 3 m apart along the way, where cars touch at 4.7 m. Distances to the driven path do
not measure it either: half a metre too far is half a metre, with or without a road user there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from adapters.extensions.training.dense_targets import BOUNDARY, DIVIDER, offsets_to_pieces
from adapters.extensions.training.frames import TrainingFrame
from benchmark.constants import (
    EGO_BODY_WIDTH_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    LIDAR_FROM_REAR_AXLE_M,
)

AGENT_ASIDE_M: Final = 1.5
AGENT_AHEAD_M: Final = 3.0
"""Distances to the nearest agent, in the frame of the start, under which both of them count."""
BOUNDARY_M: Final = 1.0
"""Least distance to the boundary of the road."""
LANE_M: Final = 2.0
"""Distance up to which a divider says where lanes lead."""
MOVES_M: Final = 0.5
"""Steps that are shorter have no direction."""


def agent_constraint(plan: Tensor, frame: TrainingFrame) -> Tensor:
    """Distance by which a plan, (T, 2) metres, comes too near to others; metres, mean over steps."""
    steps = len(plan)
    if not len(frame.boxes):
        return plan.sum() * 0
    apart = (frame.futures[:, :steps, :2] - plan).abs().transpose(0, 1)
    distance = apart.detach().norm(dim=-1).masked_fill(~frame.futures_valid[:, :steps].T, torch.inf)
    nearest = distance.argmin(-1)
    aside, ahead = apart[torch.arange(steps), nearest].unbind(-1)
    known = distance.amin(-1).isfinite()
    close = known & (aside < AGENT_ASIDE_M) & (ahead < AGENT_AHEAD_M)
    too_near: Tensor = (AGENT_ASIDE_M - aside + AGENT_AHEAD_M - ahead) * close
    return too_near.sum() / steps


def boundary_constraint(plan: Tensor, frame: TrainingFrame) -> Tensor:
    """Distance by which a plan comes too near to the boundary; arguments and result as in `agent_constraint`."""
    boundaries = frame.lines[frame.line_labels == BOUNDARY]
    if not len(boundaries):
        return plan.sum() * 0
    distance = _to_pieces(plan, boundaries)[0].amin(-1)
    return (BOUNDARY_M - distance).clamp(min=0).mean()


def direction_constraint(plan: Tensor, frame: TrainingFrame) -> Tensor:
    """1 minus the cosine, 0 to 1, of steps of the plan and the nearest divider, whichever way it runs; their mean."""
    dividers = frame.lines[frame.line_labels == DIVIDER]
    if not len(dividers):
        return plan.sum() * 0
    moves = torch.diff(plan, dim=0, prepend=torch.zeros_like(plan[:1]))
    lengths = moves.norm(dim=-1).clamp(min=1e-6)
    distance, directions = _to_pieces(plan.detach(), dividers)
    nearest, piece = distance.min(-1)
    cosine = ((moves * directions[piece]).sum(-1) / lengths).abs()
    turned: Tensor = (1 - cosine) * ((nearest < LANE_M) & (lengths.detach() > MOVES_M))
    return turned.mean()


def _to_pieces(points: Tensor, lines: Tensor) -> tuple[Tensor, Tensor]:
    """(T, S) distances of points to all S pieces of lines, and (S, 2) unit vectors along the pieces."""
    offsets, vectors = offsets_to_pieces(points, lines)
    squares = vectors.square().sum(-1).clamp(min=1e-9)
    return (offsets.square().sum(-1) + 1e-9).sqrt(), vectors / squares.sqrt()[:, None]


ASIDE_M: Final = 0.2
"""Room around the body."""
AHEAD_M: Final = 1.5
"""Room ahead of it, half a metre narrower than the body is."""
NARROWER_M: Final = 0.25
"""To each side."""
BEHIND_M: Final = 1.0
"""Road users whose centre is further behind the body's than this keep the distance themselves."""
"""Steps that are shorter have no direction."""

_HALF: Final = EGO_BODY_WIDTH_M / 2
_MIDDLE: Final = EGO_CENTER_FROM_REAR_AXLE_M - LIDAR_FROM_REAR_AXLE_M
_REACH: Final = EGO_LENGTH_M / 2 - _HALF
_CIRCLES: Final = (
    (_MIDDLE - _REACH, _HALF + ASIDE_M),
    (_MIDDLE, _HALF + ASIDE_M),
    (_MIDDLE + _REACH, _HALF + ASIDE_M),
    (_MIDDLE + _REACH + AHEAD_M + NARROWER_M, _HALF - NARROWER_M),
)
"""Metres ahead of the lidar and radius: three that cover the body with the room beside it, one for the room ahead."""


@dataclass(frozen=True, slots=True)
class NearbyBodies:
    """(F, N, T, 5) centre x, y, length, width, yaw at a plan's steps, lidar frame, metres; `there` is who is known."""

    boxes: Tensor
    there: Tensor

    @classmethod
    def of(cls, frames: Sequence[TrainingFrame], steps: int) -> "NearbyBodies":
        """All that is annotated in F frames, for T steps."""
        boxes, present = [], []
        for frame in frames:
            future, size = frame.futures[:, :steps], frame.boxes[:, None, 3:5].expand(-1, steps, -1)
            boxes.append(torch.cat([future[..., :2], size, future[..., 2:]], -1))
            present.append(frame.futures_valid[:, :steps])
        return cls(*(pad_sequence(parts, batch_first=True) for parts in (boxes, present)))

    def on(self, device: torch.device) -> "NearbyBodies":
        """Bodies on a device."""
        return NearbyBodies(self.boxes.to(device), self.there.to(device))


def missing_room(plans: Tensor, around: NearbyBodies) -> Tensor:
    """(F, M) metres, mean over steps, that (F, M, T, 2) lidar-frame plans lack to the body they lack most to."""
    if around.boxes.shape[1] == 0:
        return plans.sum((-2, -1)) * 0
    forward = _directions(plans.detach())
    offsets, radii = plans.new_tensor(_CIRCLES).unbind(-1)
    centres = plans[..., None, :] + offsets[:, None] * forward[..., None, :]
    boxes, present = around.boxes[:, None], around.there[:, None]
    apart = centres[:, :, None] - boxes[..., None, :2]
    cosine, sine = boxes[..., None, 4].cos(), boxes[..., None, 4].sin()
    local = torch.stack(
        [apart[..., 0] * cosine + apart[..., 1] * sine, apart[..., 1] * cosine - apart[..., 0] * sine], -1
    )
    beyond = local.abs() - boxes[..., None, 2:4] / 2
    distance = beyond.clamp(min=0).norm(dim=-1) + beyond.amax(-1).clamp(max=0)
    body = plans + _MIDDLE * forward
    along = ((boxes[..., :2] - body[:, :, None]).detach() * forward[:, :, None]).sum(-1)
    counts = present & (along >= -BEHIND_M)
    lacks = (radii - distance).clamp(min=0).amax(-1).masked_fill(~counts, 0.0)
    missing: Tensor = lacks.amax(2).mean(-1)
    return missing


def room_loss(plan: Tensor, frame: TrainingFrame) -> Tensor:
    """Room that one plan, (T, 2), lacks, as a scalar."""
    return missing_room(plan[None, None], NearbyBodies.of([frame], len(plan)))[0, 0]


def _directions(plans: Tensor) -> Tensor:
    """(F, M, T, 2) unit vectors: where each step leads, or the one before where it is short; forward at the start."""
    direction = torch.zeros_like(plans[..., 0, :])
    direction[..., 1] = 1.0
    steps = torch.diff(plans, dim=-2, prepend=torch.zeros_like(plans[..., :1, :]))
    directions = []
    for step in steps.unbind(-2):
        length = step.norm(dim=-1, keepdim=True)
        direction = torch.where(length >= MOVES_M, F.normalize(step, dim=-1), direction)
        directions.append(direction)
    return torch.stack(directions, -2)
