"""The most certain boxes and lines and the collision-free plan, from SparseDrive's raw predictions."""

import math
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from adapters.networks.sparse.boxes import decode_boxes, heading_of
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.decoder import DecodedInstances
from adapters.networks.sparse.motion_planner import PlannerPredictions
from adapters.networks.sparse.queue import EGO_SIZE_M

EGO_MARGIN: Final = 1.1
"""The ego is taken to be larger by this factor."""
STANDING_M: Final = 0.5
"""Motion over the planned time below which an object keeps its heading."""
CERTAIN_SCORE: Final = 0.5
"""Agents that are less certain are not avoided."""
FAR_M: Final = 1e6
SHIFT: Final = 0.5
BOX: Final = 7
"""Numbers: centre x, y, z, extents along, across and upwards, heading."""


def find_collisions(plans: Tensor, boxes: Tensor, scores: Tensor, forecasts: Tensor) -> Tensor:
    """Collisions of plans, (M,) booleans, with agents of a high enough score.

    `plans` are (M, S, 2) positions and `forecasts` of agents (N, S, 2), metres, lidar frame; `boxes` are (N, 11).
    """
    ego, agents = ego_boxes(plans), agent_boxes(boxes, scores, forecasts)
    ego, agents = ego.expand(len(agents), -1, -1, -1).clone(), agents[:, None].expand(-1, len(plans), -1, -1)
    _shift_as_published(ego)
    hit = has_corner_inside(ego, agents) | has_corner_inside(agents, ego)
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
    future_boxes = torch.cat([forecasts, rest, heading[..., None]], -1)
    return torch.where((scores < CERTAIN_SCORE)[:, None, None], torch.full_like(future_boxes, FAR_M), future_boxes)


def _headings(path: Tensor, at_rest: Tensor) -> Tensor:
    """(K, S + 1, 2) positions and (K,) headings of what stands still to (K, S) headings after the first position."""
    central = path[:, 2:] - path[:, :-2]
    along = torch.cat([central, path[:, -1:] - path[:, -2:-1]], 1)
    moving = (path[:, -1] - path[:, 0]).norm(dim=-1) >= STANDING_M
    return torch.where(moving[:, None], torch.atan2(along[..., 1], along[..., 0]), at_rest[:, None])


def _shift_as_published(ego: Tensor) -> None:
    """Change two boxes the way the published code does.

    It means to move every ego box forward, but counts along the wrong axis: all seven numbers of two boxes, those of
    the first plan at the first two steps for the first agent, change by the cosine and the sine of a third one's
    numbers.
    """
    rows = ego.view(-1, BOX)
    sixth = 6
    if len(rows) > sixth:
        rows[0] += SHIFT * rows[sixth].cos()
        rows[1] += SHIFT * rows[sixth].sin()


def has_corner_inside(boxes: Tensor, others: Tensor) -> Tensor:
    """Whether, (...), a corner of the other box lies in a box or on its edge, seen from above; boxes are (..., 7)."""
    # The published code computes corners in double precision.
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


MAP_CLASSES: Final = ("ped_crossing", "divider", "boundary")
REFUSED_LOGIT: Final = -999.0
"""Logit of a plan that collides."""


@dataclass(frozen=True, slots=True)
class SparsePredictions:
    """Everything that a sparse network computed for one key frame, before selection; `track_ids` are (N,) int64."""

    agents: DecodedInstances
    lines: DecodedInstances
    track_ids: Tensor
    planner: PlannerPredictions


@dataclass(frozen=True, slots=True)
class SparseOutputs:
    """Outputs for one key frame; lidar frame, x right, y forward, metres and radians.

    Attributes:
        plan: (6, 2) positions of the lidar origin 0.5 s to 3 s ahead: of the given command, and of its modes the most
            likely collision-free one.
        plan_modes: (3 commands, 6 modes, 6, 2) the same for all.
        plan_scores: (3, 6) 0 to 1, exactly 0 where a plan of the given command was refused because it collides.
        boxes: (N, 9) centre x, y, z (of the bottom face), width, length, height, yaw, velocity x, y. Yaw is that of the
            heading, counter-clockwise from the x axis; length lies along it.
        box_scores: (N,) 0 to 1, falling.
        box_labels: (N,) index into `benchmark.constants.DETECTION_CLASSES`.
        track_ids: (N,) int64, the same number for the same agent from frame to frame.
        trajectories: (N, 6 modes, 12 steps, 2) forecast centres.
        trajectory_scores: (N, 6) 0 to 1, each mode for itself.
        map_points: (L, 20, 2); a line may appear under several classes.
        map_scores: (L,) 0 to 1, falling.
        map_labels: (L,) index into `MAP_CLASSES`.
    """

    plan: Tensor
    plan_modes: Tensor
    plan_scores: Tensor
    boxes: Tensor
    box_scores: Tensor
    box_labels: Tensor
    track_ids: Tensor
    trajectories: Tensor
    trajectory_scores: Tensor
    map_points: Tensor
    map_scores: Tensor
    map_labels: Tensor


@dataclass(frozen=True, slots=True)
class SparseBoxSelection:
    """The K boxes that are reported, from instances in (K,) `rows`.

    `scores` are (K,) of class and centre, falling; `class_scores` (K,) of the class alone, falling in an order of its
    own.
    """

    rows: Tensor
    scores: Tensor
    labels: Tensor
    class_scores: Tensor


@dataclass(frozen=True, slots=True)
class SparseLineSelection:
    """The L map elements that are reported: (L, P, 2) points in metres, with scores of 0 to 1, falling."""

    points: Tensor
    scores: Tensor
    labels: Tensor


@dataclass(frozen=True, slots=True)
class SparsePlanSelection:
    """The plan, (S, 2) metres, and what it was chosen from: (commands, M, S, 2), with scores of 0 to 1."""

    plan: Tensor
    modes: Tensor
    scores: Tensor


def select(config: SparseConfig, predictions: SparsePredictions, command: int) -> SparseOutputs:
    """Outputs for a key frame; `command` (0 right, 1 left, 2 straight) says whose plan counts."""
    selected, lines = select_boxes(config, predictions.agents), select_lines(config, predictions.lines)
    chosen = select_plan(config, predictions, command)
    x, y, z, along, across, height, heading, *velocity = decode_boxes(predictions.agents.anchors)[selected.rows].unbind(
        -1
    )
    return SparseOutputs(
        plan=chosen.plan,
        plan_modes=chosen.modes,
        plan_scores=chosen.scores,
        boxes=torch.stack([x, y, z - height / 2, across, along, height, heading, *velocity[:2]], -1),
        box_scores=selected.scores,
        box_labels=selected.labels,
        track_ids=predictions.track_ids[selected.rows],
        trajectories=forecast_centres(predictions)[selected.rows],
        trajectory_scores=predictions.planner.motion_logits[selected.rows].sigmoid(),
        map_points=lines.points,
        map_scores=lines.scores,
        map_labels=lines.labels,
    )


def select_boxes(config: SparseConfig, agents: DecodedInstances) -> SparseBoxSelection:
    """The boxes of the most certain classes, in the order of the certainty of class and centre together."""
    best, labels = agents.logits.max(-1)
    class_scores, rows = best.sigmoid().sort(descending=True, stable=True)
    class_scores, rows = class_scores[: config.reported_boxes], rows[: config.reported_boxes]
    qualities = agents.stages[-1].qualities
    assert qualities is not None
    scores, order = (class_scores * qualities[rows, 0].sigmoid()).sort(descending=True, stable=True)
    rows = rows[order]
    return SparseBoxSelection(rows, scores, labels[rows], class_scores)


def select_lines(config: SparseConfig, lines: DecodedInstances) -> SparseLineSelection:
    """The most certain pairs of a line and a class."""
    classes = config.map_classes
    scores, pairs = lines.logits.sigmoid().flatten().sort(descending=True, stable=True)
    scores, pairs = scores[: config.reported_lines], pairs[: config.reported_lines]
    points = lines.anchors[pairs.div(classes, rounding_mode="floor")].view(len(pairs), -1, 2)
    return SparseLineSelection(points, scores, pairs % classes)


def select_plan(config: SparseConfig, predictions: SparsePredictions, command: int) -> SparsePlanSelection:
    """The most likely plan for the command that hits no agent; if all of them hit one, the most likely one."""
    planner, agents = predictions.planner, predictions.agents
    modes = planner.plan_offsets.cumsum(-2)
    likely = planner.motion_logits.argmax(-1)
    agent_rows = torch.arange(len(likely), device=likely.device)
    forecasts = forecast_centres(predictions)[agent_rows, likely, : config.steps]
    hit = find_collisions(modes[command], agents.anchors, agents.scores, forecasts)
    logits = planner.plan_logits.clone()
    logits[command] = torch.where(hit & ~hit.all(), torch.full_like(logits[command], REFUSED_LOGIT), logits[command])
    return SparsePlanSelection(modes[command, logits[command].argmax()], modes, logits.sigmoid())


def forecast_centres(predictions: SparsePredictions) -> Tensor:
    """(N, modes, steps, 2) metres, lidar frame."""
    return predictions.planner.motion_offsets.cumsum(-2) + predictions.agents.anchors[:, None, None, :2]
