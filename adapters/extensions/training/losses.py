"""Matching and mean losses of one key frame, pure; zero, with zero gradients, where nothing is annotated."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
import torch.nn.functional as F
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from benchmark.errors import InputError

FOCAL_ALPHA: Final = 0.25
"""Weight of positives in focal losses; negatives have the rest."""
FOCAL_GAMMA: Final = 2.0
"""How much focal losses forgive what is nearly right."""
_SMALLEST_SIZE_M: Final = 1e-3
_CLOSED_WITHIN_M: Final = 0.05


@dataclass(frozen=True, slots=True)
class Matches:
    """(K,) int64 one-to-one pairs of Q predictions and G annotations; every annotation has one where Q >= G."""

    queries: Tensor
    wanted: Tensor


def assign(cost: Tensor, queries: int | None = None, counts: Sequence[int] | None = None) -> Matches:
    """Pairs with the least sum of (Q, G) costs (Kuhn 1955), within each key frame; min(Q, G) of one key frame.

    `queries` are the predictions and `counts` the annotations of each key frame; by default all are of one.
    """
    matrix = cost.detach().float().cpu().numpy()
    if not np.isfinite(matrix).all():
        raise InputError("the network's predictions are no longer finite numbers; train with a lower learning rate")
    queries_per_frame, pairs, start = len(matrix) if queries is None else queries, [], 0
    for frame, count in enumerate([matrix.shape[1]] if counts is None else counts):
        block = matrix[frame * queries_per_frame : (frame + 1) * queries_per_frame, start : start + count]
        pairs.append(np.array(linear_sum_assignment(block)) + [[frame * queries_per_frame], [start]])
        start += count
    return Matches(*torch.from_numpy(np.concatenate(pairs, 1)).to(cost.device))


def class_cost(logits: Tensor, labels: Tensor) -> Tensor:
    """Change of the focal loss of a query if it becomes a positive (DETR family). (Q, G), from (Q, C) logits."""
    shares = logits.detach().float().sigmoid()
    positive = FOCAL_ALPHA * (1 - shares) ** FOCAL_GAMMA * -(shares + 1e-12).log()
    negative = (1 - FOCAL_ALPHA) * shares**FOCAL_GAMMA * -(1 - shares + 1e-12).log()
    return (positive - negative)[:, labels]


def normalise_boxes(boxes: Tensor) -> Tensor:
    """Boxes in the form in which they are compared, (..., 10), with the yaw as given.

    x, y, log width, log length, z, log height, sin yaw, cos yaw, velocity x, y, as of `deformable_decoder.box_codes`.
    """
    x, y, z, length, width, height, yaw, velocity_x, velocity_y = boxes.unbind(-1)
    sizes = torch.stack([width, length, height]).clamp(min=_SMALLEST_SIZE_M).log()
    return torch.stack([x, y, sizes[0], sizes[1], z, sizes[2], yaw.sin(), yaw.cos(), velocity_x, velocity_y], -1)


def match_boxes(
    logits: Tensor,
    codes: Tensor,
    labels: Tensor,
    wanted: Tensor,
    code_weights: Tensor,
    *,
    class_weight: float = 2.0,
    box_weight: float = 0.25,
) -> Matches:
    """Match predicted and annotated boxes by class and weighted L1 of codes.

    `logits` are (Q, C), `codes` (Q, D) in the same form as the (G, D) `wanted`, for example of `normalise_boxes`;
    `code_weights` (D,) are zero for what matching leaves out. Predictions that are not finite are an `InputError`.
    """
    distance = torch.cdist(codes.detach().float() * code_weights, wanted.float() * code_weights, p=1)
    return assign(class_weight * class_cost(logits, labels) + box_weight * distance)


def focal_loss(logits: Tensor, targets: Tensor, *, count: float | None = None) -> Tensor:
    """Sigmoid focal loss (Lin et al., ICCV 2017) of targets 0 to 1, over `count`, at least 1, or over their sum."""
    entropy = F.binary_cross_entropy_with_logits(logits, targets, reduction="none")
    shares = logits.sigmoid()
    miss = shares + targets - 2 * shares * targets
    alpha = FOCAL_ALPHA * targets + (1 - FOCAL_ALPHA) * (1 - targets)
    return (alpha * miss**FOCAL_GAMMA * entropy).sum() / max(float(targets.sum()) if count is None else count, 1.0)


def query_class_loss(logits: Tensor, labels: Tensor, matches: Matches) -> Tensor:
    """Focal loss per annotation of (Q, C) query logits and (G,) labels: unmatched queries have no class."""
    targets = torch.zeros_like(logits)
    targets[matches.queries, labels[matches.wanted]] = 1.0
    return focal_loss(logits, targets)


def box_loss(codes: Tensor, wanted: Tensor, matches: Matches, code_weights: Tensor) -> Tensor:
    """Weighted L1 of the codes of matched boxes, (Q, D) against (G, D): the sum over codes, per pair."""
    error = (codes[matches.queries] - wanted[matches.wanted]).abs() * code_weights
    return error.sum() / max(len(matches.queries), 1)


def equivalent_lines(lines: Tensor) -> Tensor:
    """The orders of points in which a line is the same line: both directions, and for closed ones all starts.

    (M, K, P, 2), from (M, P, 2); K is 2 where no line is closed, else 2 (P - 1), open lines being repeated.
    """
    both = torch.stack([lines, lines.flip(1)], 1)
    closed = (lines[:, 0] - lines[:, -1]).norm(dim=-1) < _CLOSED_WITHIN_M
    if not closed.any():
        return both
    count = lines.shape[1] - 1
    starts = (torch.arange(count + 1) % count + torch.arange(count)[:, None]) % count
    turned = both[:, :, starts.to(lines.device)].flatten(1, 2)
    repeated = both[:, :, None].expand(-1, -1, count, -1, -1).flatten(1, 2)
    return torch.where(closed[:, None, None, None], turned, repeated)


def match_lines(
    logits: Tensor,
    points: Tensor,
    labels: Tensor,
    wanted: Tensor,
    *,
    scale: Tensor | float = 1.0,
    class_weight: float = 2.0,
    line_weight: float = 0.5,
) -> tuple[Matches, Tensor]:
    """Match predicted and annotated map elements, in whichever order of points is nearest (MapTR, ICLR 2023).

    `points` (Q, P, 2) are in the unit of `wanted`; their L1, over P and divided by `scale` (one for each axis, or one
    number), costs `line_weight`. The second result is (K, P, 2) annotated points of the pairs in the nearest order.
    """
    orders = equivalent_lines(wanted)
    scaled = (orders / scale).flatten(2)
    distance = torch.cdist((points.detach() / scale).flatten(1).float()[None], scaled.flatten(0, 1).float()[None], p=1)
    distance = distance.view(len(points), len(wanted), orders.shape[1]) / points.shape[1]
    nearest, order = distance.min(-1)
    matches = assign(class_weight * class_cost(logits, labels) + line_weight * nearest)
    return matches, orders[matches.wanted, order[matches.queries, matches.wanted]]


def line_loss(points: Tensor, matched: Tensor, matches: Matches, *, scale: Tensor | float = 1.0) -> Tensor:
    """L1 of the points of matched map elements: summed over x and y, mean over points and pairs; see `match_lines`."""
    error = ((points[matches.queries] - matched) / scale).abs()
    return error.sum() / max(matched.shape[0] * matched.shape[1], 1)


def direction_loss(points: Tensor, matched: Tensor, matches: Matches) -> Tensor:
    """Direction loss (MapTR): 1 minus the cosine of pieces of (Q, P, 2) and (K, P, 2) matched lines, metres; 0 to 2."""
    pieces, matched_pieces = points[matches.queries].diff(dim=1), matched.diff(dim=1)
    return (1 - F.cosine_similarity(pieces, matched_pieces, dim=-1)).sum() / max(
        matched_pieces.shape[0] * matched_pieces.shape[1], 1
    )


def find_winning_modes(trajectories: Tensor, wanted: Tensor, valid: Tensor) -> Tensor:
    """(N,) mode of (N, M, T, 2) trajectories that is nearest to (N, T, 2) on average over the valid (N, T) steps."""
    distance = torch.linalg.vector_norm(trajectories.detach() - wanted[:, None], dim=-1)
    best: Tensor = (distance * valid[:, None]).sum(-1).argmin(-1)
    return best


def trajectory_losses(trajectories: Tensor, logits: Tensor, wanted: Tensor, valid: Tensor) -> tuple[Tensor, Tensor]:
    """Winner takes all: L1 of the nearest mode, and cross entropy of the (N, M) logits that asks for it.

    L1 is summed over x and y, mean over valid steps; cross entropy is the mean over rows with any valid step.
    `trajectories` are (N, M, T, 2) and `wanted` (N, T, 2) metres.
    """
    counted = valid.any(-1)
    trajectories, logits, wanted, valid = trajectories[counted], logits[counted], wanted[counted], valid[counted]
    best = find_winning_modes(trajectories, wanted, valid)
    error = (trajectories[torch.arange(len(best), device=best.device), best] - wanted).abs().sum(-1) * valid
    entropy = F.cross_entropy(logits, best, reduction="sum")
    return error.sum() / max(int(valid.sum()), 1), entropy / max(len(best), 1)


def plan_loss(plan: Tensor, wanted: Tensor, valid: Tensor) -> Tensor:
    """L1 of a plan, (T, 2) metres: summed over x and y, mean over valid steps."""
    return ((plan - wanted).abs().sum(-1) * valid).sum() / max(int(valid.sum()), 1)


def lateral_loss(found: Tensor, wanted: Tensor, counted: Tensor) -> Tensor:
    """Mean squared side offset in metres, up to 1 m; L1 would ask for the median, which is to stay where one is."""
    error = F.huber_loss(found, wanted, reduction="none")
    return (error * counted).sum() / max(int(counted.sum()), 1)


def dice_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """One minus the overlap of (N, ...) masks (V-Net, 3DV 2016), mean over N, 0 to 1."""
    shares, targets = logits.sigmoid().flatten(1), targets.flatten(1)
    overlap = 2 * (shares * targets).sum(-1) + 1
    return (1 - overlap / (shares.square().sum(-1) + targets.square().sum(-1) + 1)).sum() / max(len(logits), 1)
