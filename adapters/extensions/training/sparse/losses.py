"""Losses of the sparse networks (Sun et al., 2024; Lin et al., 2023; Liao et al., 2025), over several key frames."""

from collections.abc import Sequence
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.losses import (
    Matches,
    assign,
    box_loss,
    class_cost,
    direction_loss,
    equivalent_lines,
    find_winning_modes,
    focal_loss,
    lateral_loss,
    line_loss,
    query_class_loss,
)
from adapters.extensions.training.plan_room import missing_room
from adapters.extensions.training.sparse.targets import Targets
from adapters.networks.sparse.decoder import DecodedInstances, DecoderStage
from adapters.networks.sparse.queue import FORWARD_SPEED

BOX_WEIGHTS: Final = (2.0, 2.0, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 0.5, 0.5, 0.0)
"""Of the numbers of a box."""
CLASS: Final = 2.0
BOX: Final = 0.25
LINE: Final = 0.25
"""Of metres, summed over x and y."""
DIRECTION: Final = 0.1
QUALITY: Final = 0.5
CENTRE_M: Final = 4.0
"""A centre that is missed by this much has the quality 1 / e."""
FORECAST: Final = 0.3
FORECAST_CLASS: Final = 0.5
FORECAST_CHOSEN: Final = 0.15
PLAN: Final = 0.5
CHOSEN: Final = 1.0
PLAN_CLASS: Final = 0.5
ASIDE: Final = 3.0
ROOM: Final = 3.0
"""Of the squared offset to the side: half a metre is little beside the metres ahead, and leads off the road."""
NEIGHBOURS: Final = 3
"""Predictions around a box that learn where it is; one of them learns that it is the box."""
NEIGHBOUR: Final = 0.5
"""Weight of their boxes."""
STATUS: Final = 0.1
SPEED: Final = 0.3


def match_stage_boxes(stage: DecoderStage, targets: Targets) -> Matches:
    """Pairs of predictions of a stage and boxes; arguments as in `box_stage_losses`."""
    boxes, logits = stage.anchors.flatten(0, 1), stage.logits.flatten(0, 1)
    weights = boxes.new_tensor(BOX_WEIGHTS)
    distance = torch.cdist(boxes.detach() * weights, targets.boxes * weights, p=1)
    cost = CLASS * class_cost(logits, targets.box_labels) + BOX * distance
    return assign(cost, stage.anchors.shape[1], targets.box_counts)


def box_stage_losses(stage: DecoderStage, targets: Targets) -> tuple[dict[str, Tensor], Matches]:
    """Losses of one box stage over F key frames in the order of the targets; matches are of flattened rows."""
    boxes, logits = stage.anchors.flatten(0, 1), stage.logits.flatten(0, 1)
    assert stage.qualities is not None
    weights = boxes.new_tensor(BOX_WEIGHTS)
    matches = match_stage_boxes(stage, targets)
    predicted, annotated = boxes[matches.queries], targets.boxes[matches.wanted]
    missed = (predicted - annotated)[:, :3].detach().norm(dim=-1)
    alike = ((predicted[:, 6:8] * annotated[:, 6:8]).sum(-1) > 0).float()
    quality = torch.stack([(-missed / CENTRE_M).exp(), alike], -1)
    quality_loss = F.binary_cross_entropy_with_logits(
        stage.qualities.flatten(0, 1)[matches.queries], quality, reduction="sum"
    ) / max(len(predicted), 1)
    around = nearest_predictions(boxes, targets, stage.anchors.shape[1])
    return {
        "box class": CLASS * query_class_loss(logits, targets.box_labels, matches),
        "box": BOX * box_loss(boxes, targets.boxes, matches, weights),
        "box around": NEIGHBOUR * BOX * box_loss(boxes, targets.boxes, around, weights),
        "box quality": QUALITY * quality_loss,
    }, matches


def nearest_predictions(boxes: Tensor, targets: Targets, queries: int) -> Matches:
    """Pairs of each annotated box and several nearest predictions, (F * queries, 11) boxes, of its key frame."""
    owner = torch.repeat_interleave(torch.tensor(targets.box_counts))
    rows = (owner.to(boxes.device) * queries)[:, None] + torch.arange(queries, device=boxes.device)
    apart = (boxes.detach()[rows, :2] - targets.boxes[:, None, :2]).norm(dim=-1)
    nearest = apart.topk(min(NEIGHBOURS, queries), dim=1, largest=False).indices
    box_rows = torch.arange(len(rows), device=boxes.device)[:, None].expand_as(nearest)
    return Matches(rows.gather(1, nearest).flatten(), box_rows.flatten())


def line_stage_losses(stage: DecoderStage, targets: Targets) -> dict[str, Tensor]:
    """Losses of one stage of the decoder of lines; arguments as in `box_stage_losses`."""
    logits = stage.logits.flatten(0, 1)
    points = stage.anchors.flatten(0, 1).view(len(logits), -1, 2)
    orders = equivalent_lines(targets.lines)
    distance = torch.cdist(points.detach().flatten(1), orders.flatten(2).flatten(0, 1), p=1)
    nearest, order = distance.view(len(points), *orders.shape[:2]).min(-1)
    cost = CLASS * class_cost(logits, targets.line_labels) + LINE * nearest / points.shape[1]
    matches = assign(cost, stage.anchors.shape[1], targets.line_counts)
    matched = orders[matches.wanted, order[matches.queries, matches.wanted]]
    return {
        "line class": CLASS * query_class_loss(logits, targets.line_labels, matches),
        "line": LINE * line_loss(points, matched, matches),
        "line direction": DIRECTION * direction_loss(points, matched, matches),
    }


def average_losses(parts: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Means of losses of one name."""
    return {name: torch.stack([part[name] for part in parts]).mean() for name in parts[0]}


def decoder_losses(
    agents: Sequence[DecodedInstances], lines: Sequence[DecodedInstances], targets: Targets
) -> tuple[dict[str, Tensor], Matches]:
    """Losses of both decoders, means over stages, and the last box matches; key frames in the order of the targets."""
    boxes = [box_stage_losses(stage, targets) for stage in _join_stages(agents)]
    means = average_losses([losses for losses, _ in boxes]) | average_losses(
        [line_stage_losses(stage, targets) for stage in _join_stages(lines)]
    )
    return means, boxes[-1][1]


def _join_stages(decoded: Sequence[DecodedInstances]) -> list[DecoderStage]:
    stages = zip(*(instances.stages for instances in decoded), strict=True)
    return [
        DecoderStage(
            torch.cat([stage.anchors for stage in same]),
            torch.cat([stage.logits for stage in same]),
            torch.cat([stage.qualities for stage in same if stage.qualities is not None])
            if same[0].qualities is not None
            else None,
        )
        for same in stages
    ]


def forecast_losses(
    logits: Tensor, offsets: Tensor, anchors: Tensor, wanted: Tensor, valid: Tensor
) -> dict[str, Tensor]:
    """Losses of forecasts: of an agent's modes the one whose anchor is nearest learns the way, and all which it was.

    Logits (K, M), offsets (K, M, T, 2) metres from step to step; anchors and wanted (K, T, 2) from where the agent is.
    """
    counted = valid.any(-1)
    logits, paths, wanted, valid = logits[counted], offsets[counted].cumsum(2), wanted[counted], valid[counted]
    best = find_winning_modes(anchors[counted], wanted, valid)
    error = ((paths - wanted[:, None]).abs().sum(-1) * valid[:, None]).sum(-1)
    steps = max(int(valid.sum()), 1)
    best_error = error[torch.arange(len(best), device=best.device), best].sum() / steps
    nearest = F.one_hot(best, logits.shape[1]).to(logits.dtype)
    return {
        "forecast": FORECAST * best_error,
        # As with plans, a wrong choice should do little harm.
        "forecast chosen": FORECAST_CHOSEN * (logits.softmax(-1) * error).sum() / steps,
        "forecast class": FORECAST_CLASS * focal_loss(logits, nearest),
    }


def plan_losses(logits: Tensor, offsets: Tensor, anchors: Tensor, targets: Targets) -> dict[str, Tensor]:
    """Losses of plans for the given command: the one of the nearest anchor learns the way, and all which it was.

    `logits` are (F, M), `offsets` (F, M, S, 2) metres from step to step, `anchors` (F, M, S, 2) positions.
    """
    paths, valid = offsets.cumsum(2), targets.plans_valid
    best = find_winning_modes(anchors, targets.plans, valid)
    error = ((paths - targets.plans[:, None]).abs().sum(-1) * valid[:, None]).sum(-1)
    steps = max(int(valid.sum()), 1)
    rows = torch.arange(len(best), device=best.device)
    best_error = error[rows, best].sum() / steps
    # A wrong choice should do little harm: modes learn in proportion to their probability of being chosen.
    expected = (logits.softmax(-1) * error).sum() / steps
    counted = valid.any(-1)
    entropy = F.cross_entropy(logits, best, reduction="none")
    return {
        "plan": PLAN * best_error,
        "plan aside": ASIDE * lateral_loss(paths[rows, best, :, 0], targets.plans[..., 0], valid),
        "plan chosen": CHOSEN * expected,
        "plan room": ROOM * (logits.softmax(-1) * missing_room(paths, targets.around)).sum(-1).mean(),
        "plan class": PLAN_CLASS * (entropy * counted).sum() / max(int(counted.sum()), 1),
    }


def status_loss(status: Tensor, targets: Targets) -> Tensor:
    """L1 of what is recorded of the status of the ego, (F, 10); plans depend most on how fast it drives."""
    error = (status - targets.status)[:, :-1].abs()
    return STATUS * error.sum(-1).mean() + SPEED * error[:, FORWARD_SPEED].mean()
