"""Training phases of VAD-mini, on images or cached perception, and first weights that encode where objects can be."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.extensions.training.frames import MEMORY_DROPOUT, CachedFrames, Frames, TrainingFrame, oversample_changes
from adapters.extensions.training.front import (
    FrontEncoder,
    add_front_backbone,
    front_phase,
    shared_front_encoder,
    transfer_sparse_front_backbone,
)
from adapters.extensions.training.trainer import Phase, Recipe
from adapters.extensions.training.vad.objective import (
    COARSE,
    WEIGHTS,
    AgentMatches,
    VADObjective,
    forecast_losses,
    match_agents,
    network_inputs,
    plan_losses,
    predict_with_features,
)
from adapters.networks.layers.deformable_decoder import logit
from adapters.networks.layers.ego_motion import CAN_BUS_INDICES
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.anchors import find_cluster_centres
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD
from adapters.networks.vad.selection import VADPlanInputs
from benchmark.machine.storage import content_seed

RARE: Final = 0.02
"""First score of every class: most queries are for nothing."""
CAR_WIDTH_M: Final = 1.9
CAR_LENGTH_M: Final = 4.6
CAR_HEIGHT_M: Final = 1.7
LINE_SHARE: Final = 0.2
"""Length of the first lines, as a share of the perception range along y."""
UNREAD_CAN_BUS: Final = (0, 1, 2, 3, 4, 5, 6, 9, 16)
"""Numbers of the CAN bus vector that say nothing of how the ego drives: where north is, and how strong gravity."""
TURN_DEG: Final = 17
SPEED: Final = CAN_BUS_INDICES[0]
FASTEST_M_S: Final = 14.0
"""About the highest speed in the embedded town."""
QUIET: Final = 0.2
"""First size of the learned contents of queries and cells, against that of a normal distribution."""
LOUD: Final = 6**0.5
"""From the usual first weights of a layer to those that keep the size of what they pass on (He et al., ICCV 2015)."""
READER: Final = "pts_bbox_head.front_reader."
"""How the names begin of what reads the map of the front camera."""
_LATERAL: Final = "img_neck.lateral_convs"
_OUTGOING: Final = "img_neck.fpn_convs"
_LEVELS: Final = "pts_bbox_head.transformer.level_embeds"
_LOOKS: Final = "attentions.1.deformable_attention."
EDGE_SHARE: Final = 0.02
"""Margin at the edge of the perception range, as a share of it, without queries."""


def build_untrained(config: VADConfig, frames: Sequence[TrainingFrame], seed: int) -> VAD:
    """A small VAD before its training. A few hundred frames of the training data at least; images are not looked at."""
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(content_seed("vad miniature", seed))
        network = VAD(config)
    (left, rear, _), (right, front, _) = config.perception_range_m[:3], config.perception_range_m[3:]
    low, size = np.array([left, rear]), np.array([right - left, front - rear])
    centres = np.concatenate([np.zeros((0, 2)), *(frame.boxes[:, :2].double().numpy() for frame in frames)])
    centres = (centres - low) / size
    inside = ((centres > EDGE_SHARE) & (centres < 1 - EDGE_SHARE)).all(1)
    middles = np.concatenate([np.zeros((0, 2)), *(frame.lines.mean(1).double().numpy() for frame in frames)])
    set_first_values(
        network,
        torch.from_numpy(find_cluster_centres(centres[inside], config.agents, "boxes")).float(),
        torch.from_numpy(find_cluster_centres((middles - low) / size, config.map_instances, "map elements")).float(),
        _mean_plans(frames, config.commands, config.steps),
    )
    return network


def _mean_plans(frames: Sequence[TrainingFrame], commands: int, steps: int) -> Tensor:
    """(commands, steps, 2) metres from step to step; zero for a command that is never given."""
    plans = torch.zeros(commands, steps, 2)
    for command in range(commands):
        recorded = [frame.ego_future for frame in frames if frame.command == command and frame.ego_future_valid.all()]
        if recorded:
            mean = torch.stack(recorded).mean(0)
            plans[command] = torch.diff(mean, dim=0, prepend=torch.zeros_like(mean[:1]))
    return plans


def set_first_values(network: VAD, agents: Tensor, lines: Tensor, plans: Tensor) -> None:
    """Put the queries where things are, and start from a car, from a line straight ahead, and from the mean plan.

    Places are (N, 2) shares of the perception range. Published training, with thirty times the steps, does without.
    """
    head, config = network.pts_bbox_head, network.config
    with torch.no_grad():
        positions = head.query_embedding.weight[:, : config.channels]
        heights = torch.full_like(agents[:, :1], 0.5)
        _solve(head.transformer.reference_points, positions, torch.cat([agents, heights], 1))
        middles = head.map_instance_embedding.weight[:, : config.channels]
        _solve(head.transformer.map_reference_points, middles, lines)
        points = head.map_pts_embedding.weight
        along = logit(0.5 + LINE_SHARE * torch.linspace(-0.5, 0.5, config.points_per_line))
        offsets = torch.stack([torch.zeros_like(along), along], -1)
        # The point's part of a query has to move its reference by so much, and is free otherwise.
        weight = head.transformer.map_reference_points.weight.double()
        missing = offsets - points[:, : config.channels].double() @ weight.T
        points[:, : config.channels] += (missing @ torch.linalg.pinv(weight).T).float()
        # What frames share would mask their differences: the ego's speed reaches the plan as three per cent of
        # its features otherwise, and is not learned in the time available.
        head.bev_embedding.weight *= QUIET
        for queries in (head.query_embedding, head.map_instance_embedding, head.map_pts_embedding):
            queries.weight[:, config.channels :] *= QUIET
        head.motion_mode_query.weight *= QUIET
        head.ego_query.weight *= QUIET
        can_bus_layer = _linears(head.transformer.can_bus_mlp)[0]
        can_bus_layer.weight[:, UNREAD_CAN_BUS] = 0.0
        can_bus_layer.weight[:, TURN_DEG] *= 0.1
        # Each unit switches on or off at a different speed.
        can_bus_layer.bias.copy_(
            -can_bus_layer.weight[:, SPEED] * torch.linspace(0, FASTEST_M_S, len(can_bus_layer.bias))
        )
        for branch in (*head.cls_branches, *head.map_cls_branches):
            nn.init.constant_(_last_linear(branch).bias, math.log(RARE / (1 - RARE)))
        sizes = [math.log(size) for size in (CAR_WIDTH_M, CAR_LENGTH_M, CAR_HEIGHT_M)]
        for branch in head.reg_branches:
            _soften(_last_linear(branch))
            _last_linear(branch).bias[[2, 3, 5]] = torch.tensor(sizes)
        for branch in (*head.map_reg_branches, *head.traj_branches, head.ego_fut_decoder):
            _soften(_last_linear(branch))
        planned, forecast = _linears(head.ego_fut_decoder), _linears(head.traj_branches[0])
        for layer in (*planned[:-1], *_linears(head.agent_fus_mlp), *forecast[:-1]):
            layer.weight *= LOUD
        _last_linear(head.ego_fut_decoder).bias.copy_(plans.flatten())
        if head.front_reader is not None:
            head.front_reader.zero_message()


def transfer_start_weights(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Start weights of a VAD miniature: all of a trained VAD, extended, or the front eyes of a sparse miniature."""
    return transfer_sparse_front_backbone(trunk, READER) or add_front_backbone(add_finer_map(trunk))


def add_finer_map(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights for two feature maps of an image, the finer first, from those for one; those of other networks stay.

    The finer map starts as the coarse one in cells of half the size, and looks are shared: the network is what it was.
    """
    weights = dict(trunk)
    if f"{_LATERAL}.0.conv.weight" not in trunk or f"{_LATERAL}.1.conv.weight" in trunk:
        return weights
    for part in ("weight", "bias"):
        coarse = trunk[f"{_LATERAL}.0.conv.{part}"]
        weights[f"{_LATERAL}.1.conv.{part}"] = coarse
        # The finer stage has half the channels, and adds nothing yet.
        weights[f"{_LATERAL}.0.conv.{part}"] = torch.zeros_like(coarse[:, ::2] if part == "weight" else coarse)
        weights[f"{_OUTGOING}.1.conv.{part}"] = trunk[f"{_OUTGOING}.0.conv.{part}"]
    weights[_LEVELS] = trunk[_LEVELS].clone()
    weights[_LEVELS][1] = trunk[_LEVELS][0]
    for name, value in trunk.items():
        if _LOOKS not in name or name.endswith(("value_proj.weight", "value_proj.bias")):
            continue
        rows = value.view(VADConfig.miniature().heads, 1, -1, *value.shape[1:])
        # Offsets are in cells, of which the finer map has twice as many.
        finer = 2 * rows if "sampling_offsets" in name else rows
        weights[name] = torch.cat([finer, rows], 1).flatten(0, 2)
    return weights


def _linears(module: nn.Module) -> list[nn.Linear]:
    """The linear layers right inside a module, in their order."""
    return [layer for layer in module.children() if isinstance(layer, nn.Linear)]


def _last_linear(branch: nn.Module) -> nn.Linear:
    return _linears(branch)[-1]


def _soften(layer: nn.Linear) -> None:
    """A tenth of the weights, no bias: first guesses are near what the references say."""
    layer.weight *= 0.1
    nn.init.zeros_(layer.bias)


def _solve(layer: nn.Linear, inputs: Tensor, shares: Tensor) -> None:
    """The least weights that lead from `inputs` to the logits of `shares`."""
    nn.init.zeros_(layer.bias)
    # In double precision, as the last digits of single depend on where in memory things lie; so do the signs of zeros.
    layer.weight.copy_(torch.linalg.lstsq(inputs.double(), logit(shares).double()).solution.T + 0.0)


PERCEPTION: Final = (
    "img_backbone",
    "img_neck",
    *(
        f"pts_bbox_head.{name}"
        for name in (
            "positional_encoding",
            "transformer",
            "cls_branches",
            "reg_branches",
            "map_cls_branches",
            "map_reg_branches",
            "bev_embedding",
            "query_embedding",
            "map_instance_embedding",
            "map_pts_embedding",
        )
    ),
)
"""Frozen parts."""


class VADPlannerObjective:
    """Forecasts and plans alone; agents and lines, nine tenths of a step of `VADObjective`, are found once.

    A small network would know the frames by heart: some of what is remembered is forgotten anew in each step, and what
    is read in the front camera stays as it is.
    """

    clip_frames = 1

    def __init__(self, network: VAD) -> None:
        self.network = network
        for name in PERCEPTION:
            network.get_submodule(name).requires_grad_(False)
        if network.front_eyes is not None:
            network.front_eyes.requires_grad_(False)
        reader = network.pts_bbox_head.front_reader
        if reader is not None:
            reader.freeze_reading()
        self._memory: dict[tuple[str, int], tuple[VADPlanInputs, AgentMatches]] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.CachingObjective` describes."""
        cached_frames = CachedFrames(store, frames, self._cache_scene)
        return cached_frames, oversample_changes(cached_frames, frames)

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        network = self.network
        previous: tuple[Tensor, Tensor] | None = None
        front_before: Tensor | None = None
        with torch.no_grad():
            for frame in scene:
                inputs = network_inputs(frame)
                predictions, finest_front, motion = predict_with_features(network, inputs, previous, True)
                previous = inputs.can_bus, predictions.bev
                # Copies, so that the rest of the same tensors can be freed.
                sights = VADPlanInputs(
                    agent_states=predictions.agent_states[-1].clone(),
                    agent_places=predictions.agent_references[-1, :, :2].clone(),
                    map_states=predictions.map_states[-1].clone(),
                    map_points=predictions.map_points[-1].clone(),
                    map_scores=predictions.map_class_logits[-1].sigmoid().amax(-1),
                    finest_front=finest_front.clone(),
                    can_bus=motion.can_bus,
                    front_before=front_before,
                )
                if predictions.front is not None:
                    front_before = FrontReader.left(predictions.front, front_before)
                self._memory[frame.scene, frame.index] = sights, match_agents(network, predictions, frame)

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of the last frame of a clip; weighted scalars by name."""
        frame = clip[-1]
        sights, matched = self._memory[frame.scene, frame.index]
        if self.network.training:
            agents, lines = (F.dropout(states, MEMORY_DROPOUT) for states in (sights.agent_states, sights.map_states))
            sights = replace(sights, agent_states=agents, map_states=lines)
        outlook = self.network.pts_bbox_head.forecast_and_plan(sights)
        losses = {
            **forecast_losses(self.network, outlook.mode_offsets, outlook.mode_logits, matched, frame),
            **plan_losses(outlook.plan_offsets, outlook.front, frame),
        }
        return {name: WEIGHTS[name] * loss for name, loss in losses.items()}


def find_front_reader(network: VAD) -> FrontReader | None:
    """The part of a network that reads the front camera for its plan, if it has one."""
    return network.pts_bbox_head.front_reader


def build_front_encoder(network: VAD) -> FrontEncoder:
    """Eyes that make the maps for the front phase."""
    if network.front_eyes is not None:
        return FrontEncoder(network.front_eyes, own=True)
    return shared_front_encoder(network, (COARSE,))


def phases() -> tuple[Phase, ...]:
    """The parts of the training of VAD-mini."""
    everything = Recipe(steps=6000, learning_rate=4e-4, warmup=150, clips=2, check_every=1500)
    planner = Recipe(steps=2500, learning_rate=6e-4, warmup=100, clips=24, check_every=1000)
    return (
        front_phase(find_front_reader, build_front_encoder),
        Phase("all", VADObjective, everything),
        Phase("planner", VADPlannerObjective, planner),
    )
