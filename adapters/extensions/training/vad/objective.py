"""How VAD learns (section 3.5 of its paper): boxes, forecasts, map and plan of consecutive key frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.dense_targets import CHANNELS, OFFSETS, dense_loss, offset_loss
from adapters.extensions.training.frames import TrainingFrame, mask_ego_status, rotate_can_bus
from adapters.extensions.training.front import WEIGHTS as FRONT_WEIGHTS
from adapters.extensions.training.front import front_losses
from adapters.extensions.training.image_encoder import miniature_images
from adapters.extensions.training.losses import (
    Matches,
    box_loss,
    direction_loss,
    lateral_loss,
    line_loss,
    match_boxes,
    match_lines,
    normalise_boxes,
    plan_loss,
    query_class_loss,
    trajectory_losses,
)
from adapters.extensions.training.plan_room import (
    agent_constraint,
    boundary_constraint,
    direction_constraint,
    room_loss,
)
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.selection import VADPredictions

COARSE: Final = "lateral_convs.1."
"""Of the feature pyramid: what the finer map has in common with the coarse one stays while only that is learned."""
CLIP_FRAMES: Final = 3
LEARNED_FRAMES: Final = 2
"""The last frames of a clip, which have losses; earlier ones only leave their view."""
ENCODER_KEPT: Final = ("conv1", "bn1", "layer1")
"""Parts of the image network that stay as they are."""
WITHOUT_SPEED: Final = 1 / 3
"""Share of clips that are not told how the ego moves: the plan has to come from what is seen."""
WITHOUT_PAST: Final = 0.4
"""Share of clips whose first learned frame is as at the start of a scene; it saves a sixth of the time, too."""
PACE_STEP: Final = 1
"""The planned step whose distance the tokens have to know: 1 s."""
OFFSETS_FROM: Final = CHANNELS + 1
"""The first channel of the view that says where lines are; it follows the one of the pace."""
PACE_M: Final = 7.0
PACE_SPREAD_M: Final = 4.0
"""Mean and spread of that distance in the embedded town, about."""
WEIGHTS: Final = {
    "class": 2.0,
    "box": 0.25,
    "forecast": 0.2,
    "mode": 0.2,
    "line_class": 2.0,
    "line": 0.25,
    "line_direction": 0.05,
    "dense": 1.0,
    "offsets": 1.0,
    "lane": 2.0,
    "ahead": 6.0,
    "gap": 2.0,
    "walkers": 5.0,
    "pace": 1.0,
    "plan": 0.5,
    "plan_steps": 1.0,
    # Half a metre to the side is little beside the metres ahead, but leads off the road.
    "plan_aside": 6.0,
    "plan_agents": 0.2,
    "plan_boundary": 0.2,
    "plan_direction": 0.2,
    "plan_room": 2.0,
}
"""Weights of the losses; metres where a loss has a unit."""


@dataclass(frozen=True, slots=True)
class EgoMotionAugmentation:
    """Disguise of a clip, so that the plan cannot be read off the ego's own motion.

    The world is turned by `turn_rad`: no image shows where north is. Unless `speed_known`, the network is not told how
    the ego moves; its past view is aligned all the same.
    """

    turn_rad: float
    speed_known: bool
    past_known: bool

    @classmethod
    def drawn(cls) -> "EgoMotionAugmentation":
        """Disguise from the random numbers of the process, which the trainer seeds for each step."""
        turn, speed, past = torch.rand(3).tolist()
        return cls(2 * math.pi * turn, speed >= WITHOUT_SPEED, past >= WITHOUT_PAST)


class VADObjective:
    """`frames.Objective` for VAD; all but the last stages of the image network stay as they are."""

    clip_frames = CLIP_FRAMES

    def __init__(self, network: VAD) -> None:
        self.network = network
        network.img_neck.requires_grad_(True)
        for name in ENCODER_KEPT:
            network.img_backbone.get_submodule(name).requires_grad_(False)

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of a clip of consecutive key frames; weighted scalars by name, means over the learned frames."""
        disguise = EgoMotionAugmentation.drawn()
        first_learned = max(len(clip) - LEARNED_FRAMES, 0)
        previous: tuple[Tensor, Tensor] | None = None
        learned_losses: list[dict[str, Tensor]] = []
        for number in range(first_learned if not disguise.past_known else 0, len(clip)):
            learned = number >= first_learned
            with torch.set_grad_enabled(learned):
                inputs = network_inputs(clip[number])
                inputs = replace(inputs, can_bus=rotate_can_bus(inputs.can_bus, disguise.turn_rad))
                predictions = predict(self.network, inputs, previous, disguise.speed_known)
                if learned:
                    learned_losses.append(frame_losses(self.network, predictions, clip[number]))
            # As published, nothing flows back in time.
            previous = inputs.can_bus, predictions.bev.detach()
        return {
            name: WEIGHTS[name] * torch.stack([losses[name] for losses in learned_losses]).mean() for name in WEIGHTS
        }


@dataclass(frozen=True, slots=True)
class AgentMatches:
    """Annotated agents of a key frame and the queries that stand for them, after each layer of the decoder.

    `inside` (N,) are those in range, `wanted` (G, 10) their `normalise_boxes`, in the network's convention.
    """

    inside: Tensor
    wanted: Tensor
    layers: Sequence[Matches]


def network_inputs(frame: TrainingFrame) -> VADInputs:
    """Inputs of a frame as `adapters.networks.vad.planner.VADPlanner` makes them; on the processor."""
    images = miniature_images(frame.images)
    return VADInputs(
        # Convolutions on processors take two thirds of the time in this order of memory.
        images=images.contiguous(memory_format=torch.channels_last),
        lidar2img=frame.lidar2img,
        can_bus=frame.can_bus,
        command=frame.command,
        scene_token=frame.scene,
    )


def frame_losses(network: VAD, predictions: VADPredictions, frame: TrainingFrame) -> dict[str, Tensor]:
    """Losses of one key frame by the names of `WEIGHTS`, not weighted."""
    return {
        **_agent_losses(network, predictions, frame),
        **_map_losses(network, predictions, frame),
        "dense": dense_loss(predictions.bev, frame, network.config.grid, CHANNELS),
        "offsets": offset_loss(predictions.bev[:, OFFSETS_FROM : OFFSETS_FROM + OFFSETS], frame, network.config.grid),
        "pace": _pace_loss(predictions, frame),
        **plan_losses(predictions.plan_offsets, predictions.front, frame),
    }


def predict(
    network: VAD, inputs: VADInputs, previous: tuple[Tensor, Tensor] | None, speed_known: bool
) -> VADPredictions:
    """The predictions alone of `predict_with_features`, with the same arguments."""
    return predict_with_features(network, inputs, previous, speed_known)[0]


def predict_with_features(
    network: VAD, inputs: VADInputs, previous: tuple[Tensor, Tensor] | None, speed_known: bool
) -> tuple[VADPredictions, Tensor, BEVMotion]:
    """`VAD.predict` with a past that the caller holds, the front map that the plan looks at, and the motion as told.

    `previous` are the (18,) CAN bus vector and (cells, C) view of the frame before, ``None`` at the start of a scene.
    """
    can_bus, view = previous or (None, None)
    config = network.config
    motion = BEVMotion.between(can_bus, inputs.can_bus, config.grid, config.rotation_centre)
    if not speed_known:
        motion = mask_ego_status(motion)
    maps = network.img_neck(network.img_backbone(inputs.images))
    projections = inputs.lidar2img.float()
    motion = motion.to(inputs.images.device)
    finest_front = network.finest_front(maps[0], inputs.images)
    predictions: VADPredictions = network.pts_bbox_head(maps, inputs.images, projections, motion, view, finest_front)
    return predictions, finest_front, motion


def match_agents(network: VAD, predictions: VADPredictions, frame: TrainingFrame) -> AgentMatches:
    """Pairs of queries and annotated agents after each layer."""
    low, high = (torch.tensor(network.config.perception_range_m[first : first + 2]) for first in (0, 3))
    inside = ((frame.boxes[:, :2] > low) & (frame.boxes[:, :2] < high)).all(-1)
    boxes, labels = frame.boxes[inside], frame.labels[inside]
    # The network's yaw is that of mmdet3d before version 1.0.
    targets = normalise_boxes(torch.cat([boxes[:, :6], -boxes[:, 6:7] - math.pi / 2, boxes[:, 7:]], 1))
    weights = network.pts_bbox_head.code_weights
    layers = zip(predictions.class_logits, predictions.box_codes, strict=True)
    return AgentMatches(
        inside, targets, [match_boxes(logits, codes, labels, targets, weights) for logits, codes in layers]
    )


def _agent_losses(network: VAD, predictions: VADPredictions, frame: TrainingFrame) -> dict[str, Tensor]:
    """Boxes after every layer, forecasts of the queries that the last layer found boxes for."""
    matched = match_agents(network, predictions, frame)
    labels, weights = frame.labels[matched.inside], network.pts_bbox_head.code_weights
    classes, codes = [], []
    for logits, box_codes, matches in zip(predictions.class_logits, predictions.box_codes, matched.layers, strict=True):
        classes.append(query_class_loss(logits, labels, matches))
        codes.append(box_loss(box_codes, matched.wanted, matches, weights))
    return {
        "class": torch.stack(classes).sum(),
        "box": torch.stack(codes).sum(),
        **forecast_losses(network, predictions.mode_offsets, predictions.mode_logits, matched, frame),
    }


def forecast_losses(
    network: VAD, mode_offsets: Tensor, mode_logits: Tensor, matched: AgentMatches, frame: TrainingFrame
) -> dict[str, Tensor]:
    """Unweighted losses of forecasts by name: (A, modes, steps, 2) metres from step to step, (A, modes) logits."""
    steps, matches = network.config.steps, matched.layers[-1]
    boxes = frame.boxes[matched.inside]
    future = frame.futures[matched.inside][matches.wanted, :steps, :2] - boxes[matches.wanted, None, :2]
    forecast, mode = trajectory_losses(
        mode_offsets[matches.queries].cumsum(2),
        mode_logits[matches.queries],
        future,
        frame.futures_valid[matched.inside][matches.wanted, :steps],
    )
    return {"forecast": forecast, "mode": mode}


def _map_losses(network: VAD, predictions: VADPredictions, frame: TrainingFrame) -> dict[str, Tensor]:
    config = network.config
    low, high = (torch.tensor(config.perception_range_m[first : first + 2]) for first in (0, 3))
    annotated = _resample_lines(frame.lines, config.points_per_line)
    classes, lines, directions = [], [], []
    for logits, shares in zip(predictions.map_class_logits, predictions.map_points, strict=True):
        points = low + shares * (high - low)
        matches, matched = match_lines(logits, points, frame.line_labels, annotated)
        classes.append(query_class_loss(logits, frame.line_labels, matches))
        lines.append(line_loss(points, matched, matches))
        directions.append(direction_loss(points, matched, matches))
    return {
        "line_class": torch.stack(classes).sum(),
        "line": torch.stack(lines).sum(),
        "line_direction": torch.stack(directions).sum(),
    }


def _resample_lines(lines: Tensor, points: int) -> Tensor:
    """(M, P, 2) lines with another number of evenly spaced points."""
    if not len(lines):
        return lines.new_zeros((0, points, 2))
    return F.interpolate(lines.transpose(1, 2), points, mode="linear", align_corners=True).transpose(1, 2)


def _pace_loss(predictions: VADPredictions, frame: TrainingFrame) -> Tensor:
    """How well each cell, agent and map element knows the ego's pace (channel after the dense ones): plans read it."""
    if not frame.ego_future_valid[PACE_STEP]:
        return predictions.bev.sum() * 0
    target = (frame.ego_future[PACE_STEP, 1] - PACE_M) / PACE_SPREAD_M
    read = (predictions.bev, predictions.agent_states[-1], predictions.map_states[-1])
    return torch.stack([(tokens[:, CHANNELS] - target).abs().mean() for tokens in read]).sum()


def plan_losses(plan_offsets: Tensor, front: Tensor | None, frame: TrainingFrame) -> dict[str, Tensor]:
    """Unweighted losses of (commands, steps, 2) plans, metres from step to step, and of (1, numbers) front readings."""
    offsets = plan_offsets[frame.command]
    plan = offsets.cumsum(0)
    recorded = torch.diff(frame.ego_future, dim=0, prepend=torch.zeros_like(frame.ego_future[:1]))
    nothing = dict.fromkeys(FRONT_WEIGHTS, plan.sum() * 0)
    return {
        **(nothing if front is None else front_losses(front[0], frame)),
        "plan": plan_loss(plan, frame.ego_future, frame.ego_future_valid),
        "plan_steps": plan_loss(offsets, recorded, frame.ego_future_valid),
        "plan_aside": lateral_loss(plan[:, 0], frame.ego_future[:, 0], frame.ego_future_valid),
        "plan_agents": agent_constraint(plan, frame),
        "plan_boundary": boundary_constraint(plan, frame),
        "plan_direction": direction_constraint(plan, frame),
        "plan_room": room_loss(plan, frame),
    }
