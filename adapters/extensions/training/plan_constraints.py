"""Three constraints on plans (section 3.4 of the paper of VAD): away from agents, inside the road, along the lanes.

The published ones look at what the network itself predicts; these at what is annotated, which is right from the start.
"""

from typing import Final

import torch
from torch import Tensor

from adapters.extensions.training.dense_targets import BOUNDARY, DIVIDER, offsets_to_pieces
from adapters.extensions.training.frames import TrainingFrame

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
    """One minus the cosine between steps of the plan and the nearest divider, whichever way it runs.

    0 to 1, mean over steps.
    """
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
