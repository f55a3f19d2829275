"""Losses and training targets of UniAD's heads for one key frame, in the network's conventions."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import DRIVABLE_HALF_M, TrainingFrame
from adapters.extensions.training.image_encoder import miniature_images
from adapters.extensions.training.losses import (
    FOCAL_GAMMA,
    Matches,
    assign,
    box_loss,
    class_cost,
    dice_loss,
    focal_loss,
    match_boxes,
    normalise_boxes,
    query_class_loss,
    trajectory_losses,
)
from adapters.networks.layers.deformable_decoder import line_extent
from adapters.networks.sparse.anchors import find_cluster_centres
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.motion import GROUP_OF_CLASS, MotionForecasts
from adapters.networks.uniad.occupancy import CELL_M, Occupancy
from adapters.networks.uniad.planning import UniADInputs
from adapters.networks.uniad.tracking import Detections
from benchmark.constants import EGO_BODY_WIDTH_M, EGO_HEIGHT_M, EGO_LENGTH_M

LINE_HALF_WIDTH_M = 1.5
"""Cells of the bird's-eye view whose centres are not farther from a map element are in its mask."""
EGO_MIDDLE_Z_M = -1.0
"""Of the middle of the car over the lidar."""
EGO_LABEL = 0
"""The ego counts as a car."""


def network_inputs(frame: TrainingFrame) -> UniADInputs:
    """Network inputs of a training frame, as `UniADPlanner.inputs`, on the device of its network-sized images."""
    return UniADInputs(
        images=miniature_images(frame.images),
        lidar2img=frame.lidar2img,
        can_bus=frame.can_bus,
        l2g_r_mat=frame.global_T_lidar[:3, :3].T.float(),
        l2g_t=frame.global_T_lidar[:3, 3].float(),
        timestamp=frame.timestamp_s,
        command=frame.command,
        scene_token=frame.scene,
    )


@dataclass(frozen=True, slots=True)
class AgentTargets:
    """G annotated agents in the perception range; `codes` (G, 10) as predicted, the rest as in `TrainingFrame`."""

    codes: Tensor
    labels: Tensor
    instances: Tensor
    boxes: Tensor
    futures: Tensor
    futures_valid: Tensor

    @classmethod
    def of(cls, frame: TrainingFrame, config: UniADConfig) -> "AgentTargets":
        """Agents of a frame whose centres are in the perception range."""
        x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
        x, y = frame.boxes[:, 0], frame.boxes[:, 1]
        in_range = (x > x_low) & (x < x_high) & (y > y_low) & (y < y_high)
        return cls(
            box_targets(frame.boxes[in_range], config),
            frame.labels[in_range],
            frame.instances[in_range],
            frame.boxes[in_range],
            frame.futures[in_range],
            frame.futures_valid[in_range],
        )


def box_targets(boxes: Tensor, config: UniADConfig) -> Tensor:
    """(N, 10) codes to predict of (N, 9) `TrainingFrame.boxes`; yaws as of `uniad.tracking.convert_yaws`."""
    yaw = boxes[:, 6:7] + math.pi / 2 if config.counterclockwise_yaw else -boxes[:, 6:7] - math.pi / 2
    return normalise_boxes(torch.cat([boxes[:, :6], yaw, boxes[:, 7:]], 1))


def ego_box(frame: TrainingFrame) -> Tensor:
    """(1, 9) the ego as an agent; it moves as it did to the next key frame, or stands still where that is unknown."""
    known = bool(frame.ego_future_valid[0])
    velocity = frame.ego_future[0] / 0.5 if known else torch.zeros(2)
    size = (EGO_LENGTH_M, EGO_BODY_WIDTH_M, EGO_HEIGHT_M)
    return torch.tensor([[0.0, 0.0, EGO_MIDDLE_Z_M, *size, math.pi / 2, *velocity.tolist()]])


def _inside(points: Tensor, boxes: Tensor) -> Tensor:
    """Whether, (..., P), points are in boxes of (..., 5) centre x, y, length, width, heading."""
    offset = points - boxes[..., None, :2]
    cosine, sine = boxes[..., 4:5].cos(), boxes[..., 4:5].sin()
    along = offset[..., 0] * cosine + offset[..., 1] * sine
    across = offset[..., 1] * cosine - offset[..., 0] * sine
    return (along.abs() <= boxes[..., 2:3] / 2) & (across.abs() <= boxes[..., 3:4] / 2)


def occupancy_targets(agents: AgentTargets, which: Tensor, config: UniADConfig) -> tuple[Tensor, Tensor]:
    """(V, T, rows, columns) float32, 1 for cells whose centre is in the agent's box, and (V, T) where known."""
    side, steps = round(2 * config.occupancy_half_m / CELL_M), config.occupancy_steps
    axis = (torch.arange(side) + 0.5) * CELL_M - config.occupancy_half_m
    points = torch.stack(torch.meshgrid(axis, axis, indexing="xy"), -1).view(-1, 2)
    now = agents.boxes[which][:, None, [0, 1, 6]]
    places = torch.cat([now, agents.futures[which, : steps - 1]], 1)
    sizes = agents.boxes[which][:, None, 3:5].expand(-1, steps, -1)
    inside = _inside(points, torch.cat([places[..., :2], sizes, places[..., 2:]], -1))
    valid = torch.cat([torch.ones(len(which), 1, dtype=torch.bool), agents.futures_valid[which, : steps - 1]], 1)
    return inside.view(len(which), steps, side, side).float(), valid


@dataclass(frozen=True, slots=True)
class MapTargets:
    """M annotated map elements and the drivable area on the bird's-eye view; masks are 0 or 1.

    `rectangles` are (M, 4) centre x, y, width, height, 0 to 1 over the view; `masks` (M, cells), `drivable` (cells,).
    """

    labels: Tensor
    rectangles: Tensor
    masks: Tensor
    drivable: Tensor

    @classmethod
    def of(cls, frame: TrainingFrame, config: UniADConfig) -> "MapTargets":
        """Map elements and drivable area of a frame."""
        x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
        low, size = torch.tensor([x_low, y_low]), torch.tensor([x_high - x_low, y_high - y_low])
        centres = config.grid.centres() * size + low
        cell_m = 2 * DRIVABLE_HALF_M / len(frame.drivable)
        place = ((centres + DRIVABLE_HALF_M) / cell_m).long().clamp(0, len(frame.drivable) - 1)
        return cls(
            frame.line_labels,
            line_extent((frame.lines - low) / size).clamp(0, 1),
            (_distances(centres, frame.lines) <= LINE_HALF_WIDTH_M).float(),
            frame.drivable[place[:, 1], place[:, 0]].float(),
        )


def _distances(points: Tensor, lines: Tensor) -> Tensor:
    """(P, 2) points and (M, N, 2) lines to (M, P) metres between them."""
    start, step = lines[:, None, :-1], lines.diff(dim=1)[:, None]
    offset = points[None, :, None] - start
    share = ((offset * step).sum(-1) / (step * step).sum(-1).clamp(min=1e-9)).clamp(0, 1)
    distance: Tensor = torch.linalg.vector_norm(offset - share[..., None] * step, dim=-1)
    return distance.amin(-1)


def query_places(frames: Iterable[TrainingFrame], config: UniADConfig) -> Tensor:
    """Places for the queries, (queries, 3) metres in the lidar frame: where agents are in the training set."""
    centres = np.concatenate([AgentTargets.of(frame, config).boxes[:, :3].numpy() for frame in frames])
    return torch.from_numpy(find_cluster_centres(centres.astype(np.float64), config.queries, "agents")).float()


def motion_anchors(frames: Iterable[TrainingFrame], config: UniADConfig) -> Tensor:
    """Typical forecasts, (groups, modes, steps, 2) metres, agent frames, y forward; rare groups have vehicles'."""
    groups: list[list[Tensor]] = [[] for _ in range(config.motion_groups)]
    for frame in frames:
        agents = AgentTargets.of(frame, config)
        offsets = agents.futures[..., :2] - agents.boxes[:, None, :2]
        turn = math.pi / 2 - agents.boxes[:, 6]
        cosine, sine = turn.cos()[:, None], turn.sin()[:, None]
        x, y = offsets.unbind(-1)
        local = torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1)
        for label, future, valid in zip(agents.labels.tolist(), local, agents.futures_valid, strict=True):
            if bool(valid.all()):
                groups[GROUP_OF_CLASS[label]].append(future)
    vehicles = _modes(groups[0], config)
    return torch.stack(
        [vehicles] + [_modes(group, config) if _are_varied(group, config) else vehicles for group in groups[1:]]
    )


def _are_varied(futures: list[Tensor], config: UniADConfig) -> bool:
    return len(futures) > 0 and len(np.unique(torch.stack(futures).numpy(), axis=0)) >= config.modes


def _modes(futures: list[Tensor], config: UniADConfig) -> Tensor:
    stacked = torch.stack(futures) if futures else torch.zeros(0, config.forecast_steps, 2)
    return torch.from_numpy(
        find_cluster_centres(stacked.double().numpy(), config.modes, "forecasts of vehicles")
    ).float()


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


def match_agents(detections: Detections, agents: AgentTargets, carried: Tensor, queries: int) -> Matches:
    """Pairs of queries and agents: a track for its own, if it is still there, and fresh queries for all others.

    `carried` are (T,) instances of the tracks, `queries` counts the fresh ones without the ego.
    """
    same = carried[:, None] == agents.instances
    track, owned = same.nonzero().unbind(-1)
    free = (~same.any(0)).nonzero()[:, 0]
    weights = agents.codes.new_tensor(CODE_WEIGHTS)
    fresh_matches = match_boxes(
        detections.class_logits[-1, :queries],
        detections.box_codes[-1, :queries],
        agents.labels[free],
        agents.codes[free],
        weights,
        class_weight=CLASS_WEIGHT,
        box_weight=BOX_WEIGHT,
    )
    return Matches(
        torch.cat([fresh_matches.queries, queries + 1 + track]), torch.cat([free[fresh_matches.wanted], owned])
    )


def detection_losses(
    detections: Detections, agents: AgentTargets, matches: Matches, ego_codes: Tensor, ego_query: int
) -> dict[str, Tensor]:
    """Losses of all layers of the decoder of agents, by name; `ego_codes` are (1, 10)."""
    ego_match = agents.labels.new_tensor([ego_query]), agents.labels.new_tensor([len(agents.labels)])
    everyone = Matches(torch.cat([matches.queries, ego_match[0]]), torch.cat([matches.wanted, ego_match[1]]))
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


def match_elements(elements: MapElements, road: MapTargets) -> Matches:
    """Pairs of queries and map elements, by class and rectangle."""
    distance = torch.cdist(elements.rectangles[-1].detach(), road.rectangles, p=1)
    return assign(CLASS_WEIGHT * class_cost(elements.class_logits[-1], road.labels) + 5 * distance)


def map_losses(
    elements: MapElements, road: MapTargets, matches: Matches, masks: Tensor, drivable: Tensor
) -> dict[str, Tensor]:
    """Losses of the map head by name; `masks` are (K, cells) values of the queries, `drivable` (1, cells) ones."""
    classes = [query_class_loss(logits, road.labels, matches) for logits in elements.class_logits]
    ones = road.rectangles.new_ones(4)
    rectangles = [box_loss(predicted, road.rectangles, matches, ones) for predicted in elements.rectangles]
    return {
        "map class": torch.stack(classes).mean(),
        "map rectangle": RECTANGLE_WEIGHT * torch.stack(rectangles).mean(),
        "map mask": MASK_WEIGHT * mask_loss(masks, road.masks[matches.wanted]),
        "drivable": MASK_WEIGHT * mask_loss(drivable, road.drivable[None]),
    }


def mask_loss(values: Tensor, targets: Tensor) -> Tensor:
    """Loss of (N, cells) mask values, 0 or more: overlap, and squares in which inside and outside count alike."""
    if len(values) == 0:
        return values.sum()
    square, inside = (values - targets).square(), targets.sum(1).clamp(min=1)
    outside = (1 - targets).sum(1).clamp(min=1)
    balanced = (square * targets).sum(1) / inside + (square * (1 - targets)).sum(1) / outside
    shares = values.clamp(max=1)
    overlap = (2 * (shares * targets).sum(1) + 1) / (shares.sum(1) + targets.sum(1) + 1)
    return (balanced + 1 - overlap).mean()


def forecast_losses(forecasts: MotionForecasts, wanted: Tensor, valid: Tensor) -> dict[str, Tensor]:
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


def _deviation_loss(trajectories: Tensor, target: Tensor, valid: Tensor) -> Tensor:
    """Negative log likelihood of (A, modes, steps, 5) forecasts as far as deviations and correlations decide it."""
    error = (target[:, None] - trajectories[..., :2]).detach()
    deviation = trajectories[..., 2:4].clamp(min=SMALLEST_DEVIATION_M)
    correlation = trajectories[..., 4].clamp(-LARGEST_CORRELATION, LARGEST_CORRELATION)
    x, y = (error / deviation).unbind(-1)
    rest = 1 - correlation.square()
    terms = (x * x + y * y - 2 * correlation * x * y) / (2 * rest) + deviation.log().sum(-1) + rest.log() / 2
    counted = valid[:, None].expand_as(terms)
    return (terms.clamp(max=50.0) * counted).sum() / counted.sum().clamp(min=1)


def occupancy_loss(occupancy: Occupancy, wanted: Tensor, valid: Tensor) -> Tensor:
    """Loss of the (V, T, rows, columns) vehicle occupancy where (V, T) is valid, and of masks that steer attention."""
    logits, targets = occupancy.logits[valid], wanted[valid]
    coarse = F.adaptive_max_pool2d(targets, occupancy.mask_logits.shape[-2:])
    return OCCUPANCY_WEIGHT * (
        _occupied_loss(logits, targets) + 0.5 * _occupied_loss(occupancy.mask_logits[valid], coarse)
    )


def _occupied_loss(logits: Tensor, targets: Tensor) -> Tensor:
    """(N, rows, columns) logits."""
    return dice_loss(logits, targets) + focal_loss(logits, targets)
