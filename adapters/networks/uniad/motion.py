"""Forecasts: agents look at each other, at the map and at their goals (MotionFormer, section 3.2 of the paper)."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualFeedForward, normalised_branch, plain_branch, sine_features
from adapters.networks.layers.deformable_attention import deformable_sampling
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.tracking import Boxes
from benchmark.errors import InputError


def embedding_layer(channels: int) -> nn.Sequential:
    """Two linear layers, the first twice as wide."""
    return fusion_layer(channels, channels)


def fusion_layer(inputs: int, channels: int) -> nn.Sequential:
    """Layers from `inputs` numbers to `channels`, over twice as many."""
    return nn.Sequential(nn.Linear(inputs, 2 * channels), nn.ReLU(), nn.Linear(2 * channels, channels))


class AgentInteraction(nn.Module):
    """The modes of an agent look at each other and then at other things."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.interaction_transformer = nn.TransformerDecoderLayer(channels, heads, hidden, batch_first=True)

    def forward(self, tokens: Tensor, things: Tensor) -> Tensor:
        """(A, modes, C) and (T, C) to (A, modes, C)."""
        result: Tensor = self.interaction_transformer(tokens, things.expand(len(tokens), *things.shape))
        return result


class IntentionInteraction(nn.Module):
    """The modes of an agent look at each other."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.interaction_transformer = nn.TransformerEncoderLayer(channels, heads, hidden, batch_first=True)

    def forward(self, tokens: Tensor) -> Tensor:
        """(A, modes, C) to (A, modes, C)."""
        result: Tensor = self.interaction_transformer(tokens)
        return result


class GoalAttention(nn.Module):
    """Deformable attention around the end of a forecast, with a pattern for each of its steps."""

    def __init__(self, channels: int, heads: int, steps: int, points: int) -> None:
        super().__init__()
        self.heads, self.steps, self.points = heads, steps, points
        self.sampling_offsets = nn.Linear(channels, heads * steps * points * 2)
        self.attention_weights = nn.Linear(channels, heads * steps * points)
        self.value_proj = nn.Linear(channels, channels)
        self.output_proj = nn.Sequential(nn.Linear(steps * channels, channels), nn.LayerNorm(channels), nn.ReLU())

    def forward(self, tokens: Tensor, positions: Tensor, goals: Tensor, bev: Tensor, shape: tuple[int, int]) -> Tensor:
        """Tokens, (Q, C), that have looked at (cells, C) around goals: (Q, 2) x, y, 0 to 1 over the bird's-eye view."""
        query, looks = tokens + positions, (len(tokens), self.heads, self.steps, 1, self.points)
        offsets = self.sampling_offsets(query).view(*looks, 2)
        weights = self.attention_weights(query).view(looks).float().softmax(-1)
        values = self.value_proj(bev).view(1, len(bev), self.heads, -1)
        places = goals.repeat_interleave(self.steps, 0)
        sampled = deformable_sampling(
            values,
            (shape,),
            places[:, None, None, None],
            offsets.transpose(1, 2).flatten(0, 1),
            weights.transpose(1, 2).flatten(0, 1),
        )
        attended: Tensor = self.output_proj(sampled.view(len(tokens), -1))
        return tokens + attended


class GoalInteraction(nn.Module):
    """`GoalAttention`, then a feed-forward block; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int, steps: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([GoalAttention(channels, heads, steps, points)])
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(2)])

    def forward(self, tokens: Tensor, positions: Tensor, goals: Tensor, bev: Tensor, shape: tuple[int, int]) -> Tensor:
        """Arguments and result as in `GoalAttention`."""
        tokens = self.norms[0](self.attentions[0](tokens, positions, goals, bev, shape))
        result: Tensor = self.norms[1](self.ffns[0](tokens))
        return result


class MotionFormer(nn.Module):
    """The interactions of all layers, and what fuses them."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        channels, layers = config.channels, range(config.motion_layers)
        sizes = (channels, config.heads, config.feedforward_channels)
        self.intention_interaction_layers = IntentionInteraction(*sizes)
        self.track_agent_interaction_layers = nn.ModuleList([AgentInteraction(*sizes) for _ in layers])
        self.map_interaction_layers = nn.ModuleList([AgentInteraction(*sizes) for _ in layers])
        self.bev_interaction_layers = nn.ModuleList(
            [GoalInteraction(*sizes, config.forecast_steps, config.bev_points) for _ in layers]
        )
        self.static_dynamic_fuser = fusion_layer(2 * channels, channels)
        self.dynamic_embed_fuser = fusion_layer(3 * channels, channels)
        self.in_query_fuser = fusion_layer(2 * channels, channels)
        self.out_query_fuser = fusion_layer(4 * channels, channels)


GROUP_OF_CLASS = (0, 0, 0, 0, 0, 3, 1, 1, 2, 3)
"""Anchors of vehicles, cycles, pedestrians, and barriers and cones, for the ten classes of nuScenes."""
HALF_TURN = 3.1415953
"""Not quite pi; the published network has learned it so."""
GAUSSIAN = 5
"""Numbers per forecast step: x, y, two deviations and a correlation."""


@dataclass(frozen=True, slots=True)
class MotionForecasts:
    """Forecasts for A agents, the last of which is the ego; K layers.

    `trajectories` (K, A, modes, steps, 5) are x, y from the agent's place in metres along the axes of the lidar, two
    standard deviations, correlation; `log_probabilities` (K, A, modes); `queries` (K, A, modes, C); `positions` (A, C)
    encoded places.
    """

    trajectories: Tensor
    log_probabilities: Tensor
    queries: Tensor
    positions: Tensor


def rotate(offsets: Tensor, angles: Tensor) -> Tensor:
    """Offsets, (A, ..., 2) metres, turned counter-clockwise by (A,) radians."""
    shape = (-1, *[1] * (offsets.dim() - 2))
    cosine, sine = angles.cos().view(shape), angles.sin().view(shape)
    x, y = offsets.unbind(-1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


@dataclass(frozen=True, slots=True)
class _Goals:
    """Encoded ends of A agents' forecasts: in the agent's frame, in the scene's, and from the agent in the scene's."""

    in_agent: Tensor
    in_scene: Tensor
    from_agent: Tensor


class MotionHead(nn.Module):
    """Forecasts of all reported agents and of the ego.

    `anchors` are (groups, modes, steps, 2) typical forecasts in the frames of agents, metres; zeros until
    `load_anchors`, because published checkpoints lack them. With `stores_anchors` they are part of the state dict, and
    loaded with it.
    """

    anchors: Tensor
    group_of_class: Tensor

    def __init__(self, config: UniADConfig, anchors: Tensor | None = None, *, stores_anchors: bool = False) -> None:
        super().__init__()
        self.config = config
        channels, layers = config.channels, config.motion_layers
        shape = (config.motion_groups, config.modes, config.forecast_steps, 2)
        self.register_buffer("anchors", torch.zeros(shape), persistent=stores_anchors)
        groups = torch.tensor([GROUP_OF_CLASS[label % len(GROUP_OF_CLASS)] for label in range(config.agent_classes)])
        self.register_buffer("group_of_class", groups.clamp(max=config.motion_groups - 1), persistent=False)
        self.learnable_motion_query_embedding = nn.Embedding(config.motion_groups * config.modes, channels)
        self.motionformer = MotionFormer(config)
        # Published checkpoints hold it; no prediction uses it.
        self.layer_track_query_fuser = nn.Sequential(
            nn.Linear(config.decoder_layers * channels, channels), nn.LayerNorm(channels), nn.ReLU()
        )
        self.agent_level_embedding_layer = embedding_layer(channels)
        self.scene_level_ego_embedding_layer = embedding_layer(channels)
        self.scene_level_offset_embedding_layer = embedding_layer(channels)
        self.boxes_query_embedding_layer = embedding_layer(channels)
        self.traj_cls_branches = nn.ModuleList([normalised_branch(channels, 1) for _ in range(layers)])
        outputs = config.forecast_steps * GAUSSIAN
        self.traj_reg_branches = nn.ModuleList([plain_branch(channels, outputs) for _ in range(layers)])
        self._has_anchors = stores_anchors
        if anchors is not None:
            self.load_anchors(anchors)

    def load_anchors(self, anchors: Tensor) -> None:
        """Set the anchors, finite numbers of (groups, modes, steps, 2) metres."""
        if anchors.shape != self.anchors.shape or not bool(anchors.isfinite().all()):
            raise InputError(
                f"motion anchors must be finite and have the shape {list(self.anchors.shape)}, not "
                f"{list(anchors.shape)}; pass the array of the published motion_anchor_infos_mode6.pkl"
            )
        self.anchors.copy_(anchors)
        self._has_anchors = True

    def forward(self, agents: Boxes, elements: MapElements, bev: Tensor) -> MotionForecasts:
        """Forecasts of A agents, the ego last, in a bird's-eye view of (cells, C)."""
        if not self._has_anchors:
            raise InputError(
                "UniAD has no motion anchors, which are not in its checkpoint; import motion_anchor_infos_mode6.pkl too"
            )
        former, centres = self.motionformer, agents.boxes[:, :2]
        positions = self.boxes_query_embedding_layer(self._encode(centres).to(bev.dtype))
        places = positions[:, None].expand(-1, self.config.modes, -1)
        placed_agents, placed_lines = agents.states + positions, elements.queries + elements.query_positions
        goals, anchors, learned = self._encode_anchors(agents)
        intentions = former.intention_interaction_layers(goals.in_agent)
        goals = _Goals(intentions, goals.in_scene, goals.from_agent)
        static = intentions + goals.from_agent + learned
        tokens, reference = torch.zeros_like(static), anchors
        agent_tokens = placed_agents[:, None].expand_as(tokens)
        trajectories, queries = [], []
        for layer in range(self.config.motion_layers):
            dynamic = former.dynamic_embed_fuser(torch.cat([goals.in_agent, goals.from_agent, goals.in_scene], -1))
            intention = former.static_dynamic_fuser(torch.cat([static, dynamic], -1))
            tokens = former.in_query_fuser(torch.cat([tokens, intention], -1))
            attended = [
                former.track_agent_interaction_layers[layer](tokens + places, placed_agents),
                former.map_interaction_layers[layer](tokens + places, placed_lines),
                self._attend_to_goals(layer, tokens, places, centres[:, None] + reference[:, :, -1], bev),
            ]
            tokens = former.out_query_fuser(torch.cat([*attended, agent_tokens], -1))
            predicted = self.traj_reg_branches[layer](tokens).float()
            predicted = predicted.view(*tokens.shape[:2], self.config.forecast_steps, GAUSSIAN)
            reference = predicted[..., :2].cumsum(-2)
            trajectories.append(torch.cat([reference, predicted[..., 2:4].exp(), predicted[..., 4:].tanh()], -1))
            queries.append(tokens)
            goals = self._goals(agents, reference[:, :, -1])
        logits = [
            branch(states)[..., 0].float() for branch, states in zip(self.traj_cls_branches, queries, strict=True)
        ]
        log_probabilities = torch.stack(logits).log_softmax(-1)
        return MotionForecasts(torch.stack(trajectories), log_probabilities, torch.stack(queries), positions)

    def _encode(self, places: Tensor) -> Tensor:
        """(..., 2) metres to (..., C) sines, those of y first."""
        x_low, y_low, _, x_high, y_high, _ = self.config.perception_range_m
        shares = torch.stack(
            [(places[..., 1] - y_low) / (y_high - y_low), (places[..., 0] - x_low) / (x_high - x_low)], -1
        )
        return sine_features(shares.float() * (2 * math.pi), self.config.channels // 2).flatten(-2)

    def _encode_anchors(self, agents: Boxes) -> tuple[_Goals, Tensor, Tensor]:
        """Encoded ends of the agents' anchors, the anchors along the lidar's axes, and learned queries for them."""
        group = self.group_of_class[agents.labels]
        group_anchors = self.anchors[group]
        anchors = rotate(group_anchors, agents.boxes[:, 6] - HALF_TURN)
        learned = self.learnable_motion_query_embedding.weight
        learned = learned.view(self.config.motion_groups, self.config.modes, -1)[group]
        ends = anchors[:, :, -1]
        return self._embed_goals(group_anchors[:, :, -1], agents.boxes[:, None, :2] + ends, ends), anchors, learned

    def _goals(self, agents: Boxes, ends: Tensor) -> _Goals:
        """Encoded (A, modes, 2) ends, metres from the agents along the axes of the lidar."""
        in_agent = rotate(ends, HALF_TURN - agents.boxes[:, 6])
        return self._embed_goals(in_agent, agents.boxes[:, None, :2] + ends, ends)

    def _embed_goals(self, in_agent: Tensor, in_scene: Tensor, from_agent: Tensor) -> _Goals:
        dtype = self.learnable_motion_query_embedding.weight.dtype
        return _Goals(
            self.agent_level_embedding_layer(self._encode(in_agent).to(dtype)),
            self.scene_level_ego_embedding_layer(self._encode(in_scene).to(dtype)),
            self.scene_level_offset_embedding_layer(self._encode(from_agent).to(dtype)),
        )

    def _attend_to_goals(self, layer: int, tokens: Tensor, places: Tensor, ends: Tensor, bev: Tensor) -> Tensor:
        """(A, modes, C) after looking at the bird's-eye view around (A, modes, 2) ends in the lidar frame."""
        x_low, y_low, _, x_high, y_high, _ = self.config.perception_range_m
        x, y = ends.unbind(-1)
        shares = torch.stack([(x - x_low) / (x_high - x_low), (y - y_low) / (y_high - y_low)], -1)
        flat = [rows.reshape(-1, rows.shape[-1]) for rows in (tokens, places, shares)]
        attended: Tensor = self.motionformer.bev_interaction_layers[layer](*flat, bev, self.config.grid.shape)
        return attended.view_as(tokens)
