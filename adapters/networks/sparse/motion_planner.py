"""Shared part of both planners: attention among agents, ego and map, and forecasts of agents."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualAttention, plain_branch
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.aggregation import (
    AsymmetricFeedForward,
    CameraFeatures,
    class_branch,
    decoupled_attention,
    point_encoder,
    sine_of_points,
)
from adapters.networks.sparse.boxes import KeyframeMotion, heading_of
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.decoder import DecodedInstances, find_most_certain
from adapters.networks.sparse.queue import STATUS, InstanceQueue, Queue, QueueMemory

LAYERS_OF_A_BLOCK = 7


@dataclass(frozen=True, slots=True)
class MotionPlannerInputs:
    """Scene of a key frame, as a planner is given it; `past` and `motion` are from the frame before.

    `ids` are (N,) numbers of the agents; `front` is the (1, C, h, w) coarsest feature map of the front camera,
    `finest_front` its finest one; `command` 0 right, 1 left, 2 straight.
    """

    agents: DecodedInstances
    lines: DecodedInstances
    ids: Tensor
    cameras: CameraFeatures
    front: Tensor
    finest_front: Tensor
    command: int
    box_encoder: nn.Module
    past: QueueMemory | None
    motion: KeyframeMotion | None

    @property
    def front_before(self) -> Tensor | None:
        """(1, numbers) what the frame before has left of what its plan took from the front camera; stale is nothing."""
        if self.past is None or self.motion is None or not self.motion.fresh:
            return None
        return self.past.front


@dataclass(frozen=True, slots=True)
class Interaction:
    """Tokens after agents and the ego have looked at each other: (N + 1, C) each, the ego in the last row.

    `watched` are (W + 1, C) each, of the most certain agents and of the ego as they were before.
    """

    features: Tensor
    embeddings: Tensor
    watched: tuple[Tensor, Tensor]

    @property
    def tokens(self) -> Tensor:
        """(N + 1, C) features and embeddings added."""
        return self.features + self.embeddings


@dataclass(frozen=True, slots=True)
class PlannerPredictions:
    """Predictions of a planner; M modes, T agent steps, S planned steps; lidar frame, metres from step to step.

    `motion_logits` (N, M) and `motion_offsets` (N, M, T, 2) of agents; `plan_logits` (commands, M); `plan_offsets`
    (commands, M, S, 2); `status` (10,) of the ego; `denoising` steps of the diffusion planner only; `front` (1,
    numbers) that the plan took from the front camera's finest map, ``None`` if it does not look there.
    """

    motion_logits: Tensor
    motion_offsets: Tensor
    plan_logits: Tensor
    plan_offsets: Tensor
    status: Tensor
    queue: Queue
    memory: QueueMemory
    denoising: Mapping[str, Tensor]
    front: Tensor | None = None


class MotionRefinement(nn.Module):
    """Forecasts, and the status of the ego; the regression planner adds its plans."""

    def __init__(self, config: SparseConfig, plans: bool) -> None:
        super().__init__()
        channels = config.channels
        self.motion_cls_branch = class_branch(channels, 1)
        self.motion_reg_branch = plain_branch(channels, config.agent_steps * 2)
        if plans:
            self.plan_cls_branch = class_branch(channels, 1)
            self.plan_reg_branch = plain_branch(channels, config.steps * 2)
        self.plan_status_branch = plain_branch(channels, STATUS)


def interaction_layers(config: SparseConfig, plans: bool) -> nn.ModuleList:
    """Layers of the blocks of `MotionPlanner.interact`, and a `MotionRefinement`."""
    channels, heads = config.channels, config.heads
    layers: list[nn.Module] = []
    for _ in range(config.interaction_blocks):
        layers += [
            ResidualAttention(2 * channels, heads),
            ResidualAttention(2 * channels, heads),
            nn.LayerNorm(channels),
            ResidualAttention(channels, heads),
            nn.LayerNorm(channels),
            AsymmetricFeedForward(channels, channels, config.planner_hidden_channels),
            nn.LayerNorm(channels),
        ]
    return nn.ModuleList([*layers, MotionRefinement(config, plans)])


class MotionPlanner(nn.Module):
    """Base of both planners; `layers` are lists under published names, which differ, `interaction_layers` first."""

    def __init__(self, config: SparseConfig, layers: Mapping[str, nn.ModuleList]) -> None:
        super().__init__()
        self.config = config
        channels = config.channels
        forecasts = (config.agent_classes, config.modes, config.agent_steps, 2)
        plans = (config.commands, config.modes, config.steps, 2)
        self.motion_anchor = nn.Parameter(torch.randn(forecasts), requires_grad=False)
        self.plan_anchor = nn.Parameter(torch.randn(plans), requires_grad=False)
        self.instance_queue = InstanceQueue(config)
        self._interaction = next(iter(layers))
        for name, modules in layers.items():
            self.add_module(name, modules)
        self.fc_before = nn.Linear(channels, 2 * channels, bias=False)
        self.fc_after = nn.Linear(2 * channels, channels, bias=False)
        self.motion_anchor_encoder = point_encoder(channels, channels)
        self.plan_anchor_encoder = point_encoder(channels, channels)
        numbers = config.plan_sees_front
        compares = config.plan_compares_front
        self.front_reader = FrontReader(channels, numbers, channels, compares=compares) if numbers else None

    @property
    def interaction(self) -> nn.ModuleList:
        """Blocks of layers, and a `MotionRefinement`."""
        layers = self.get_submodule(self._interaction)
        assert isinstance(layers, nn.ModuleList)
        return layers

    @property
    def refinement(self) -> MotionRefinement:
        """The last of them."""
        last = self.interaction[-1]
        assert isinstance(last, MotionRefinement)
        return last

    def interact(self, scene: MotionPlannerInputs, queue: Queue) -> Interaction:
        """Agents and the ego look at their past, at the most certain agents and at the map."""
        agents, lines = scene.agents, scene.lines
        features = torch.cat([agents.features, queue.ego_features[-1]])
        embeddings = torch.cat([agents.embeddings, scene.box_encoder(queue.ego_boxes[-1])])
        past_features = torch.cat([queue.features, queue.ego_features], 1).transpose(0, 1)
        past_boxes = torch.cat([queue.boxes, queue.ego_boxes], 1).transpose(0, 1)
        past = past_features, scene.box_encoder(past_boxes)
        allowed = queue.allowed()[:, None]
        ego = features.new_full((1,), len(features) - 1, dtype=torch.int64)
        rows = torch.cat([find_most_certain(agents.scores, self.config.watched_agents), ego])
        watched = features[rows], embeddings[rows]
        line_rows = find_most_certain(lines.scores, self.config.watched_lines)
        lanes, places = lines.features[line_rows], lines.embeddings[line_rows]
        features = self.attend_to_scene(features, embeddings, past, allowed, watched, (lanes, places))
        return Interaction(features, embeddings, watched)

    def attend_to_scene(
        self,
        features: Tensor,
        embeddings: Tensor,
        past: tuple[Tensor, Tensor],
        allowed: Tensor,
        watched: tuple[Tensor, Tensor],
        lanes: tuple[Tensor, Tensor],
    ) -> Tensor:
        """Features, (..., N + 1, C), after agents and the ego have looked at the rest.

        `past` are features and embeddings of the last L frames, (..., N + 1, L, C) each, and `allowed`, (..., N + 1, 1,
        L), which of these frames each may look at; `watched` and `lanes` are features and embeddings of agents and map
        elements.
        """
        lines, places = lanes
        layers = list(self.interaction)[:-1]
        for first in range(0, len(layers), LAYERS_OF_A_BLOCK):
            look_back, look_around, norm, look_at_map, second_norm, feed, third_norm = layers[
                first : first + LAYERS_OF_A_BLOCK
            ]
            query = features[..., None, :], embeddings[..., None, :]
            features = self.attend_decoupled(look_back, query, past, allowed)[..., 0, :]
            features = norm(self.attend_decoupled(look_around, (features, embeddings), watched))
            features = look_at_map(features, features + embeddings, lines + places, lines)
            features = third_norm(feed(second_norm(features)))
        return features

    def attend_decoupled(
        self,
        layer: nn.Module,
        query: tuple[Tensor, Tensor],
        key: tuple[Tensor, Tensor],
        allowed: Tensor | None = None,
    ) -> Tensor:
        """`adapters.networks.sparse.aggregation.decoupled_attention` with the planner's own projections."""
        return decoupled_attention(layer, self.fc_before, self.fc_after, query, key, allowed)

    def forecast(self, agents: DecodedInstances, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """Forecast logits, (N, modes), and (N, modes, steps, 2) metres per step, lidar frame, from (N, C) tokens."""
        ends = self.rotate_anchors(agents)[:, :, -1]
        queries = self.motion_anchor_encoder(sine_of_points(ends, self.config.channels)) + tokens[:, None]
        logits = self.refinement.motion_cls_branch(queries)[..., 0].float()
        return logits, self.refinement.motion_reg_branch(queries).float().unflatten(-1, (-1, 2))

    def rotate_anchors(self, agents: DecodedInstances) -> Tensor:
        """(N, modes, steps, 2) typical forecasts of the classes of N agents, turned as they head, from their places."""
        anchors = self.motion_anchor[agents.logits.argmax(-1)]
        heading = heading_of(agents.anchors)[:, None, None]
        sine, cosine = heading.sin(), heading.cos()
        x, y = anchors.unbind(-1)
        return torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1)

    def add_front(self, ego: Tensor, finest: Tensor, before: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Tokens of the egos with the front camera's (B, numbers) added, and these, ``None`` without a front reader.

        `ego` is (1, C), or (B, 1, C) of several key frames; `finest` (B, C, h, w); `before` (B, numbers) of the key
        frames before (`FrontReader.left`).
        """
        if self.front_reader is None:
            return ego, None
        numbers = self.front_reader(finest)
        return ego + self.front_reader.told(numbers, before).view_as(ego), numbers

    def plan_queries(self, ego: Tensor) -> Tensor:
        """(commands, modes, C) tokens, one for each plan that is thought of, from that of the ego, (1, C)."""
        points = sine_of_points(self.plan_anchor[:, :, -1], self.config.channels)
        queries: Tensor = self.plan_anchor_encoder(points) + ego
        return queries

    def remember(
        self, scene: MotionPlannerInputs, queue: Queue, ego_feature: Tensor, status: Tensor, front: Tensor | None
    ) -> QueueMemory:
        """Memory for the next frame; `ego_feature` (1, C) takes the place of the newest one in the queue."""
        return QueueMemory(
            queue.features,
            queue.boxes,
            queue.periods,
            scene.ids,
            scene.agents.scores,
            torch.cat([queue.ego_features[:-1], ego_feature[None]]),
            queue.ego_boxes,
            queue.ego_period,
            status,
            None if front is None else FrontReader.left(front, scene.front_before),
        )
