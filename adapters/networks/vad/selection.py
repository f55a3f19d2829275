"""VAD's raw predictions for one key frame, and their most certain boxes and lines, in metres, and the plan."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from adapters.networks.layers.deformable_decoder import (
    are_within,
    decode_boxes,
    extent_corners,
    select_strongest,
    to_metres,
)
from adapters.networks.vad.config import VADConfig


@dataclass(frozen=True, slots=True)
class VADPredictions:
    """Raw predictions; K decoder layers, A agents, M map elements of P points, C channels; lidar frame.

    Positions "as shares" are 0 to 1 over the perception range.

    Attributes:
        bev: (cells, C) bird's-eye view, which is also what the next frame remembers.
        agent_states: (K, A, C).
        agent_first_references: (A, 3) as shares; `agent_references` (K, A, 3).
        class_logits: (K, A, classes).
        box_codes: (K, A, 10) as `adapters.networks.layers.deformable_decoder.box_codes`, x, y, z in metres.
        mode_offsets: (A, modes, steps, 2) metres from step to step; `mode_logits` (A, modes).
        map_states: (K, M * P, C).
        map_first_references: (M * P, 2) as shares; `map_references` (K, M * P, 2).
        map_class_logits: (K, M, map classes).
        map_extents: (K, M, 4) centre x, y, width, height as shares; `map_points` (K, M, P, 2).
        plan_offsets: (commands, steps, 2) metres from step to step.
        front: (1, numbers) what the plan takes from the front camera, where it does.
    """

    bev: Tensor
    agent_states: Tensor
    agent_first_references: Tensor
    agent_references: Tensor
    class_logits: Tensor
    box_codes: Tensor
    mode_offsets: Tensor
    mode_logits: Tensor
    map_states: Tensor
    map_first_references: Tensor
    map_references: Tensor
    map_class_logits: Tensor
    map_extents: Tensor
    map_points: Tensor
    plan_offsets: Tensor
    front: Tensor | None = None


@dataclass(frozen=True, slots=True)
class VADPlanInputs:
    """Inputs of the forecasts and the plan of one key frame; states after the last layer, places as shares.

    `agent_states` (A, C); `agent_places` (A, 2); `map_states` (M * P, C); `map_points` (M, P, 2); `map_scores` (M,) of
    the most likely class; `finest_front` (1, C, h, w) feature map of the front camera; `can_bus` (18,) float32, as in
    `adapters.networks.layers.ego_motion.BEVMotion`; `front_before` (1, numbers) of the frames before.
    """

    agent_states: Tensor
    agent_places: Tensor
    map_states: Tensor
    map_points: Tensor
    map_scores: Tensor
    finest_front: Tensor
    can_bus: Tensor
    front_before: Tensor | None = None


@dataclass(frozen=True, slots=True)
class VADPlanPredictions:
    """Forecasts and plan; the attributes are those of `VADPredictions`."""

    mode_offsets: Tensor
    mode_logits: Tensor
    plan_offsets: Tensor
    front: Tensor | None


MAP_CLASSES = ("divider", "ped_crossing", "boundary")

MARGIN_M = 5.0
"""How far outside the perception range, on the ground, boxes and lines are still reported."""
HIGHEST_M = 10.0
"""Boxes whose centre is higher or lower are not."""


@dataclass(frozen=True, slots=True)
class VADOutputs:
    """Outputs for one key frame; lidar frame, x right, y forward, metres and radians.

    Attributes:
        plan: (6, 2) positions of the lidar origin 0.5 s to 3 s ahead, for the given command.
        plan_modes: (3, 6, 2) the same for all commands.
        boxes: (N, 9) centre x, y, z (of the bottom face), width, length, height, yaw, velocity x, y. Yaw is that of the
            heading, counter-clockwise from the x axis; length lies along it.
        box_scores: (N,) 0 to 1, falling.
        box_labels: (N,) index into `benchmark.constants.DETECTION_CLASSES`.
        trajectories: (N, 6 modes, 6 steps, 2) forecast centres.
        trajectory_scores: (N, 6) probabilities of the modes, sum 1.
        map_points: (L, 20, 2).
        map_scores: (L,) 0 to 1, falling.
        map_labels: (L,) index into `MAP_CLASSES`.
    """

    plan: Tensor
    plan_modes: Tensor
    boxes: Tensor
    box_scores: Tensor
    box_labels: Tensor
    trajectories: Tensor
    trajectory_scores: Tensor
    map_points: Tensor
    map_scores: Tensor
    map_labels: Tensor


@dataclass(frozen=True, slots=True)
class VADBoxSelection:
    """N boxes with the conventions of the network, of (N,) queries `agents`, scores falling.

    `boxes` are (N, 9) centre x, y, z of the bottom, width, length, height, yaw, velocity x, y. The heading is -yaw -
    pi/2: this is the yaw of mmdet3d before version 1.0.
    """

    boxes: Tensor
    scores: Tensor
    labels: Tensor
    agents: Tensor


@dataclass(frozen=True, slots=True)
class VADLineSelection:
    """The L reported map elements, (L, P, 2), scores falling; `corners` are (L, 4) least, greatest x, y; metres."""

    corners: Tensor
    points: Tensor
    scores: Tensor
    labels: Tensor


def select(config: VADConfig, predictions: VADPredictions, command: int) -> VADOutputs:
    """Outputs for a key frame; `command` (0 right, 1 left, 2 straight) says whose plan counts."""
    plans = predictions.plan_offsets.cumsum(1)
    selected, lines = select_boxes(config, predictions), select_lines(config, predictions)
    yaw = selected.boxes[:, 6:7]
    heading = torch.remainder(-yaw - math.pi / 2 + math.pi, 2 * math.pi) - math.pi
    offsets = predictions.mode_offsets[selected.agents]
    return VADOutputs(
        plan=plans[command],
        plan_modes=plans,
        boxes=torch.cat([selected.boxes[:, :6], heading, selected.boxes[:, 7:]], 1),
        box_scores=selected.scores,
        box_labels=selected.labels,
        trajectories=selected.boxes[:, None, None, :2] + offsets.cumsum(2),
        trajectory_scores=predictions.mode_logits[selected.agents].softmax(-1),
        map_points=lines.points,
        map_scores=lines.scores,
        map_labels=lines.labels,
    )


def select_boxes(config: VADConfig, predictions: VADPredictions) -> VADBoxSelection:
    """The most certain boxes whose centres are not far outside the perception range."""
    scores, labels, agents = select_strongest(predictions.class_logits[-1], config.max_boxes)
    boxes = decode_boxes(predictions.box_codes[-1, agents])
    lower, upper = _reported_range(config)
    inside = are_within(boxes[:, :3], (*lower, -HIGHEST_M), (*upper, HIGHEST_M))
    boxes = boxes[inside]
    bottom = boxes[:, 2:3] - boxes[:, 5:6] / 2
    boxes = torch.cat([boxes[:, :2], bottom, boxes[:, 3:]], 1)
    return VADBoxSelection(boxes, scores[inside], labels[inside], agents[inside])


def select_lines(config: VADConfig, predictions: VADPredictions) -> VADLineSelection:
    """The most certain map elements that do not reach far outside the perception range."""
    scores, labels, lines = select_strongest(predictions.map_class_logits[-1], config.max_lines)
    low, high = config.perception_range_m[:2], config.perception_range_m[3:5]
    corners = to_metres(extent_corners(predictions.map_extents[-1, lines]).view(-1, 2, 2), low, high).flatten(-2)
    lower, upper = _reported_range(config)
    inside = are_within(corners, (*lower, *lower), (*upper, *upper))
    points = to_metres(predictions.map_points[-1, lines], low, high)
    return VADLineSelection(corners[inside], points[inside], scores[inside], labels[inside])


def _reported_range(config: VADConfig) -> tuple[tuple[float, float], tuple[float, float]]:
    """x, y of the least and of the greatest reported position, metres."""
    x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
    return (x_low - MARGIN_M, y_low - MARGIN_M), (x_high + MARGIN_M, y_high + MARGIN_M)
