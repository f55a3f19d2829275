"""Losses of UniAD's heads for one key frame."""

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.losses import (
    FOCAL_GAMMA,
    Matches,
    assigned,
    box_loss,
    class_cost,
    dice_loss,
    focal_loss,
    match_boxes,
    query_class_loss,
    trajectory_losses,
)
from adapters.extensions.training.uniad.targets import EGO_LABEL, Agents, Road
from adapters.networks.uniad.bev import Detections
from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.motion import Forecasts
from adapters.networks.uniad.occupancy import Occupancy

CODE_WEIGHTS = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.2, 0.2)
CLASS_WEIGHT, BOX_WEIGHT = 2.0, 0.25
POSITIVES = 0.35
"""Weight of agents in the loss of classes, the rest is that of nothing: what is as likely as not is born as a track,
about. 0.25 as published leaves a short training unsure of everything, with 0.65 half of the tracks follow nothing."""
SPEED_WEIGHT = 1.0
"""Of the ego's own speed, which is the best start for a plan; m/s."""
RECTANGLE_WEIGHT, MASK_WEIGHT = 2.0, 1.0
FORECAST_WEIGHT, MODE_WEIGHT, DEVIATION_WEIGHT = 0.5, 0.5, 0.05
OCCUPANCY_WEIGHT = 1.0
SMALLEST_DEVIATION_M, LARGEST_CORRELATION = 0.1, 0.9


def matched_agents(detections: Detections, agents: Agents, carried: Tensor, queries: int) -> Matches:
    """Pairs of queries and agents: a track for its own, and fresh queries for all others.

    Tracks whose agent has gone have no pair. `carried` are (T,) instances of the tracks, `queries` counts the fresh
    ones without the ego.
    """
    same = carried[:, None] == agents.instances
    track, owned = same.nonzero().unbind(-1)
    free = (~same.any(0)).nonzero()[:, 0]
    weights = agents.codes.new_tensor(CODE_WEIGHTS)
    found = match_boxes(
        detections.class_logits[-1, :queries],
        detections.box_codes[-1, :queries],
        agents.labels[free],
        agents.codes[free],
        weights,
        class_weight=CLASS_WEIGHT,
        box_weight=BOX_WEIGHT,
    )
    return Matches(torch.cat([found.queries, queries + 1 + track]), torch.cat([free[found.wanted], owned]))


def detection_losses(
    detections: Detections, agents: Agents, matches: Matches, ego_codes: Tensor, ego_query: int
) -> dict[str, Tensor]:
    """Losses of all layers of the decoder of agents, by name; `ego_codes` are (1, 10)."""
    own = agents.labels.new_tensor([ego_query]), agents.labels.new_tensor([len(agents.labels)])
    everyone = Matches(torch.cat([matches.queries, own[0]]), torch.cat([matches.wanted, own[1]]))
    labels = torch.cat([agents.labels, agents.labels.new_tensor([EGO_LABEL])])
    codes, weights = torch.cat([agents.codes, ego_codes]), agents.codes.new_tensor(CODE_WEIGHTS)
    classes = [_agent_class_loss(logits, labels, everyone) for logits in detections.class_logits]
    boxes = [box_loss(predicted, codes, everyone, weights) for predicted in detections.box_codes]
    speed = (detections.box_codes[:, ego_query, 8:] - ego_codes[:, 8:]).abs().sum(-1)
    return {
        "class": CLASS_WEIGHT * torch.stack(classes).mean(),
        "box": BOX_WEIGHT * torch.stack(boxes).mean(),
        "ego speed": SPEED_WEIGHT * speed.mean(),
    }


def _agent_class_loss(logits: Tensor, labels: Tensor, matches: Matches) -> Tensor:
    """`adapters.extensions.training.losses.query_class_loss` with other weights: tracks are born at a score of 0.4."""
    targets = torch.zeros_like(logits)
    targets[matches.queries, labels[matches.wanted]] = 1.0
    entropy = F.binary_cross_entropy_with_logits(logits, targets, reduction="none")
    miss = (logits.sigmoid() - targets).abs()
    share = POSITIVES * targets + (1 - POSITIVES) * (1 - targets)
    return (share * miss**FOCAL_GAMMA * entropy).sum() / max(len(matches.queries), 1)


def matched_elements(elements: MapElements, road: Road) -> Matches:
    """Pairs of queries and map elements, by class and rectangle."""
    distance = torch.cdist(elements.rectangles[-1].detach(), road.rectangles, p=1)
    return assigned(CLASS_WEIGHT * class_cost(elements.class_logits[-1], road.labels) + 5 * distance)


def map_losses(
    elements: MapElements, road: Road, matches: Matches, masks: Tensor, drivable: Tensor
) -> dict[str, Tensor]:
    """Losses of the map head by name; `masks` are (K, cells) values of the queries, `drivable` (1, cells) ones."""
    classes = [query_class_loss(logits, road.labels, matches) for logits in elements.class_logits]
    ones = road.rectangles.new_ones(4)
    rectangles = [box_loss(found, road.rectangles, matches, ones) for found in elements.rectangles]
    return {
        "map class": torch.stack(classes).mean(),
        "map rectangle": RECTANGLE_WEIGHT * torch.stack(rectangles).mean(),
        "map mask": MASK_WEIGHT * mask_loss(masks, road.masks[matches.wanted]),
        "drivable": MASK_WEIGHT * mask_loss(drivable, road.drivable[None]),
    }


def mask_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Loss of masks whose values are no probabilities: squares, in which inside and outside count alike, and overlap.

    `values` are (N, cells), 0 or more, `targets` 0 or 1.
    """
    if len(values) == 0:
        return values.sum()
    square, inside = (values - targets).square(), targets.sum(1).clamp(min=1)
    outside = (1 - targets).sum(1).clamp(min=1)
    balanced = (square * targets).sum(1) / inside + (square * (1 - targets)).sum(1) / outside
    shares = values.clamp(max=1)
    overlap = (2 * (shares * targets).sum(1) + 1) / (shares.sum(1) + targets.sum(1) + 1)
    return (balanced + 1 - overlap).mean()


def forecast_losses(forecasts: Forecasts, wanted: Tensor, valid: Tensor) -> dict[str, Tensor]:
    """Losses of all layers of the forecast; `wanted` are (A, steps, 2) metres from the present places of agents."""
    distances, modes, deviations = [], [], []
    for trajectories, log_probabilities in zip(forecasts.trajectories, forecasts.log_probabilities, strict=True):
        distance, mode = trajectory_losses(trajectories[..., :2], log_probabilities, wanted, valid)
        distances.append(distance)
        modes.append(mode)
        deviations.append(_deviation_loss(trajectories, wanted, valid))
    return {
        "forecast": FORECAST_WEIGHT * torch.stack(distances).mean(),
        "forecast mode": MODE_WEIGHT * torch.stack(modes).mean(),
        "forecast deviation": DEVIATION_WEIGHT * torch.stack(deviations).mean(),
    }


def _deviation_loss(trajectories: Tensor, wanted: Tensor, valid: Tensor) -> Tensor:
    """Negative log likelihood of (A, modes, steps, 5) forecasts as far as deviations and correlations decide it."""
    error = (wanted[:, None] - trajectories[..., :2]).detach()
    deviation = trajectories[..., 2:4].clamp(min=SMALLEST_DEVIATION_M)
    correlation = trajectories[..., 4].clamp(-LARGEST_CORRELATION, LARGEST_CORRELATION)
    x, y = (error / deviation).unbind(-1)
    rest = 1 - correlation.square()
    terms = (x * x + y * y - 2 * correlation * x * y) / (2 * rest) + deviation.log().sum(-1) + rest.log() / 2
    counted = valid[:, None].expand_as(terms)
    return (terms.clamp(max=50.0) * counted).sum() / counted.sum().clamp(min=1)


def occupancy_loss(occupancy: Occupancy, wanted: Tensor, valid: Tensor) -> Tensor:
    """Loss of the occupancy by V vehicles and of the coarse masks that steer attention.

    `wanted` are (V, T, rows, columns), 0 or 1, `valid` (V, T).
    """
    logits, targets = occupancy.logits[valid], wanted[valid]
    coarse = F.adaptive_max_pool2d(targets, occupancy.mask_logits.shape[-2:])
    return OCCUPANCY_WEIGHT * (
        _occupied_loss(logits, targets) + 0.5 * _occupied_loss(occupancy.mask_logits[valid], coarse)
    )


def _occupied_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """(N, rows, columns) logits."""
    return dice_loss(logits, targets) + focal_loss(logits, targets)
