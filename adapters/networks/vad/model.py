"""VAD: six images, camera matrices and motion in; a plan, boxes, forecasts and a map out, under published names."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import (
    CrossAttentionDecoder,
    LaneEncoder,
    LearnedGridEncoding,
    normalised_branch,
    plain_branch,
)
from adapters.networks.layers.bev_network import BEVTransformer, bev_decoder, can_bus_network
from adapters.networks.layers.deformable_decoder import DecoderOutputs, box_codes, line_extent, to_metres
from adapters.networks.layers.ego_motion import BEVMotion, EgoStatusEncoder
from adapters.networks.layers.front_reader import FrontBackbone, FrontReader, compute_front_maps
from adapters.networks.layers.resnet import EXPANSION, FeaturePyramid, ResNet
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.selection import VADOutputs, VADPlanInputs, VADPlanPredictions, VADPredictions, select
from benchmark.errors import InputError

LEVEL_EMBEDDINGS = 4
"""Published networks have as many whether or not they use them."""


class VADTransformer(BEVTransformer):
    """The encoder and the two decoders of VAD (section 3.1 of its paper)."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__(config, max(LEVEL_EMBEDDINGS, config.pyramid_levels))
        self.decoder = bev_decoder(config)
        self.map_decoder = bev_decoder(config)
        self.reference_points = nn.Linear(config.channels, 3)
        self.map_reference_points = nn.Linear(config.channels, 2)
        self.can_bus_mlp = can_bus_network(config.channels)

    def decode_agents(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> DecoderOutputs:
        """States and x, y, z of agents in a bird's-eye view of (cells, C).

        `queries` are (A, 2 C), positions and then contents; `branches` take (A, C) to (A, 10) corrections, one per
        layer.
        """
        positions, contents = queries.chunk(2, -1)
        references = self.reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: DecoderOutputs = self.decoder(contents, positions, references, bev, shapes, branches, (0, 1, 4))
        return decoded

    def decode_map(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> DecoderOutputs:
        """Points of map elements in a bird's-eye view; arguments as in `decode_agents`, corrections (M * P, 2)."""
        positions, contents = queries.chunk(2, -1)
        references = self.map_reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: DecoderOutputs = self.map_decoder(contents, positions, references, bev, shapes, branches, (0, 1))
        return decoded


BOX_CODE = 10


class VADHead(nn.Module):
    """Everything after the image features (sections 3.1 to 3.4 of the paper)."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__()
        self.config = config
        channels, layers = config.channels, config.decoder_layers
        # Weights of training losses; nothing reads them here, but published checkpoints hold them.
        self.code_weights = nn.Parameter(torch.tensor([1.0] * 8 + [0.2] * 2), requires_grad=False)
        self.map_code_weights = nn.Parameter(torch.ones(4), requires_grad=False)
        self.positional_encoding = LearnedGridEncoding(config.bev_rows, config.bev_columns, channels)
        self.transformer = VADTransformer(config)
        self.cls_branches = nn.ModuleList([normalised_branch(channels, config.agent_classes) for _ in range(layers)])
        self.reg_branches = nn.ModuleList([plain_branch(channels, BOX_CODE) for _ in range(layers)])
        self.traj_branches = nn.ModuleList([plain_branch(2 * channels, config.steps * 2)])
        self.traj_cls_branches = nn.ModuleList([normalised_branch(2 * channels, 1)])
        self.map_cls_branches = nn.ModuleList([normalised_branch(channels, config.map_classes) for _ in range(layers)])
        self.map_reg_branches = nn.ModuleList([plain_branch(channels, 2) for _ in range(layers)])
        self.bev_embedding = nn.Embedding(config.grid.cells, channels)
        self.query_embedding = nn.Embedding(config.agents, 2 * channels)
        self.map_instance_embedding = nn.Embedding(config.map_instances, 2 * channels)
        self.map_pts_embedding = nn.Embedding(config.points_per_line, 2 * channels)
        cross = (channels, config.heads, config.feedforward_channels)
        self.motion_decoder = CrossAttentionDecoder(*cross)
        self.motion_mode_query = nn.Embedding(config.modes, channels)
        self.pos_mlp_sa = nn.Linear(2, channels)
        self.lane_encoder = LaneEncoder(channels)
        self.motion_map_decoder = CrossAttentionDecoder(*cross)
        self.pos_mlp = nn.Linear(2, channels)
        self.ego_query = nn.Embedding(1, channels)
        self.ego_agent_decoder = CrossAttentionDecoder(*cross)
        self.ego_agent_pos_mlp = nn.Linear(2, channels)
        self.ego_map_decoder = CrossAttentionDecoder(*cross)
        self.ego_map_pos_mlp = nn.Linear(2, channels)
        self.ego_fut_decoder = plain_branch(2 * channels, config.commands * config.steps * 2)
        numbers = config.plan_sees_front
        compares = config.plan_compares_front
        self.front_reader = FrontReader(channels, numbers, 2 * channels, compares=compares) if numbers else None
        self.motion_teller = EgoStatusEncoder(2 * channels) if config.plan_knows_motion else None
        self.agent_fus_mlp = nn.Sequential(
            nn.Linear(config.modes * 2 * channels, channels),
            nn.LayerNorm(channels),
            nn.ReLU(),
            nn.Linear(channels, channels),
        )

    def forward(
        self,
        maps: list[Tensor],
        images: Tensor,
        projections: Tensor,
        motion: BEVMotion,
        previous: Tensor | None,
        finest_front: Tensor,
        front_before: Tensor | None = None,
    ) -> VADPredictions:
        """Predictions for one key frame; all but the last two arguments as in `VADTransformer.encode`.

        `finest_front` is the (1, C, h, w) feature map that the plan looks at, `front_before` (1, numbers) of the frames
        before.
        """
        bev = self.transformer.encode(
            self.bev_embedding.weight, self.positional_encoding(), maps, images, projections, motion, previous
        )
        agents = self.transformer.decode_agents(self.query_embedding.weight, bev, self.reg_branches)
        queries = self.map_instance_embedding.weight[:, None] + self.map_pts_embedding.weight
        lines = self.transformer.decode_map(queries.flatten(0, 1), bev, self.map_reg_branches)

        map_points = self._group_by_line(lines.references)
        map_logits = self._classes_of_lines(lines)
        sights = VADPlanInputs(
            agent_states=agents.states[-1],
            agent_places=agents.references[-1, :, :2],
            map_states=lines.states[-1],
            map_points=map_points[-1],
            map_scores=map_logits[-1].sigmoid().amax(-1),
            finest_front=finest_front,
            can_bus=motion.can_bus,
            front_before=front_before,
        )
        outlook = self.forecast_and_plan(sights)

        lower, upper = self.config.perception_range_m[:3], self.config.perception_range_m[3:]
        logits = [branch(states).float() for branch, states in zip(self.cls_branches, agents.states, strict=True)]
        return VADPredictions(
            bev=bev,
            agent_states=agents.states,
            agent_first_references=agents.first_references,
            agent_references=agents.references,
            class_logits=torch.stack(logits),
            box_codes=box_codes(to_metres(agents.references, lower, upper), agents.corrections),
            mode_offsets=outlook.mode_offsets,
            mode_logits=outlook.mode_logits,
            map_states=lines.states,
            map_first_references=lines.first_references,
            map_references=lines.references,
            map_class_logits=map_logits,
            map_extents=line_extent(map_points),
            map_points=map_points,
            plan_offsets=outlook.plan_offsets,
            front=outlook.front,
        )

    def forecast_and_plan(self, sights: VADPlanInputs) -> VADPlanPredictions:
        """Forecasts and plan from what was seen in one key frame."""
        lane_features, lane_places = self._lanes(sights)
        lane_mask = sights.map_scores > self.config.lane_score
        forecasts = self._forecast(sights.agent_states, sights.agent_places, lane_features, lane_places, lane_mask)
        mode_offsets = self.traj_branches[0](forecasts).float()
        front = None if self.front_reader is None else self.front_reader(sights.finest_front)
        return VADPlanPredictions(
            mode_offsets.view(*mode_offsets.shape[:2], self.config.steps, 2),
            self.traj_cls_branches[0](forecasts)[..., 0].float(),
            self._plan(forecasts, sights.agent_places, lane_features, lane_places, self._told(front, sights)),
            front,
        )

    def _told(self, front: Tensor | None, sights: VADPlanInputs) -> Tensor | None:
        """(1, 2 C) what the plan is told beside agents and map elements, if anything."""
        messages = []
        if self.front_reader is not None and front is not None:
            messages.append(self.front_reader.told(front, sights.front_before))
        if self.motion_teller is not None:
            messages.append(self.motion_teller(sights.can_bus))
        return torch.stack(messages).sum(0) if messages else None

    def _group_by_line(self, points: Tensor) -> Tensor:
        """(K, M * P, D) to (K, M, P, D)."""
        return points.view(len(points), self.config.map_instances, self.config.points_per_line, -1)

    def _classes_of_lines(self, lines: DecoderOutputs) -> Tensor:
        """(K, M, map classes) logits, from the mean of a line's points."""
        means = self._group_by_line(lines.states).mean(2)
        logits = [branch(states).float() for branch, states in zip(self.map_cls_branches, means, strict=True)]
        return torch.stack(logits)

    def _lanes(self, sights: VADPlanInputs) -> tuple[Tensor, Tensor]:
        """(M, C) features of the map elements, and their (M, 2) places as shares.

        An element is where its point nearest to the corner with the least x and y is: the published code takes norms of
        shares, whose origin is that corner and not the ego.
        """
        points = sights.map_points
        nearest = points.square().sum(-1).sqrt().argmin(1)
        places = points.gather(1, nearest[:, None, None].expand(-1, 1, 2))[:, 0]
        features: Tensor = self.lane_encoder(sights.map_states.view(*points.shape[:2], -1))
        return features, places

    def _forecast(
        self, agents: Tensor, places: Tensor, lanes: Tensor, lane_places: Tensor, lane_seen: Tensor
    ) -> Tensor:
        """Features of every mode of every agent, (A, modes, 2 C), from all modes of all agents and the lanes nearby.

        `agents` are (A, C) and `lanes` (M, C), their places (A, 2) and (M, 2) as shares; `lane_seen` is (M,).
        """
        tokens = (agents[:, None] + self.motion_mode_query.weight).flatten(0, 1)
        positions = _linear(self.pos_mlp_sa, places).repeat_interleave(self.config.modes, 0)
        among_agents = self.motion_decoder(tokens, positions).view(-1, self.config.modes, self.config.channels)

        relative = lane_places - places[:, None]
        nearby = relative.square().sum(-1).sqrt() <= self.config.lane_distance
        # An empty lane in the corner, visible to all agents, gives agents without lanes something to attend to.
        relative = torch.cat([relative, torch.ones_like(relative[:, :1])], 1)
        allowed = torch.cat([nearby & lane_seen, torch.ones_like(nearby[:, :1])], 1)
        values = torch.cat([lanes, torch.zeros_like(lanes[:1])])
        among_lanes = self.motion_map_decoder(
            among_agents,
            _linear(self.pos_mlp, torch.zeros_like(places[:1])),
            values + _linear(self.pos_mlp, relative),
            values,
            allowed[:, None],
        )
        return torch.cat([among_agents, among_lanes], -1)

    def _plan(
        self, forecasts: Tensor, places: Tensor, lanes: Tensor, lane_places: Tensor, message: Tensor | None
    ) -> Tensor:
        """(commands, steps, 2) metres from step to step: the ego query looks at the agents, then at the lanes."""
        agents = self.agent_fus_mlp(forecasts.flatten(1))
        origin = torch.zeros_like(places[:1])
        after_agents = self.ego_agent_decoder(
            self.ego_query.weight,
            _linear(self.ego_agent_pos_mlp, origin),
            agents + _linear(self.ego_agent_pos_mlp, places),
            agents,
        )
        after_lanes = self.ego_map_decoder(
            after_agents,
            _linear(self.ego_map_pos_mlp, origin),
            lanes + _linear(self.ego_map_pos_mlp, lane_places),
            lanes,
        )
        ego_features = torch.cat([after_agents, after_lanes], -1)
        if message is not None:
            ego_features = ego_features + message
        offsets: Tensor = self.ego_fut_decoder(ego_features)
        return offsets.float().view(self.config.commands, self.config.steps, 2)


def _linear(layer: nn.Linear, places: Tensor) -> Tensor:
    """Positions, which are in single precision, through a layer of any."""
    result: Tensor = layer(places.to(layer.weight.dtype))
    return result


@dataclass(frozen=True, slots=True)
class VADInputs:
    """One key frame; a change of scene forgets the past.

    `images` are (6, 3, H, W), normalised and padded: front, front right, front left, back, back left, back right;
    `lidar2img` (6, 4, 4), lidar frame in metres to pixels of the padded images; `can_bus` (18,) float64, absolute;
    `command` 0 right, 1 left, 2 straight.
    """

    images: Tensor
    lidar2img: Tensor
    can_bus: Tensor
    command: int
    scene_token: str


@dataclass(frozen=True, slots=True)
class _VADMemory:
    """Memory of a frame for the next one; `can_bus` is float64, absolute, `front` what `FrontReader.left` leaves."""

    scene_token: str
    can_bus: Tensor
    bev: Tensor
    front: Tensor | None


class VAD(nn.Module):
    """The network and what it remembers; call it under ``torch.inference_mode()``, frame after frame."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__()
        self.config = config
        self.pts_bbox_head = VADHead(config)
        self.img_backbone = ResNet(config.backbone_blocks, config.backbone_outputs, config.backbone_width)
        widths = [config.backbone_width * EXPANSION * 2**stage for stage in config.backbone_outputs]
        self.img_neck = FeaturePyramid(widths, config.channels, config.pyramid_levels)
        self.front_eyes = FrontBackbone(config.backbone_width, config.channels) if config.front_eyes else None
        self._memory: _VADMemory | None = None
        self.eval()

    def reset(self) -> None:
        """Forget the past; the next frame is the first of a scene."""
        self._memory = None

    def forward(self, inputs: VADInputs) -> VADOutputs:
        """Outputs for one key frame; frames of a scene come in the order of time."""
        return select(self.config, self.predict(inputs), inputs.command)

    def predict(self, inputs: VADInputs) -> VADPredictions:
        """Predictions for one key frame before selection; it is remembered.

        Camera matrices or motion with NaN or infinity are an `InputError`: such a camera would see nothing, unnoticed.
        """
        if not (inputs.lidar2img.isfinite().all() and inputs.can_bus.isfinite().all()):
            raise InputError(
                f"camera matrices or CAN bus of a frame of scene {inputs.scene_token} contain NaN or infinity; "
                "check the data set's calibration and poses"
            )
        memory = self._memory if self._memory and self._memory.scene_token == inputs.scene_token else None
        images = inputs.images
        motion = self.ego_motion(inputs).to(images.device)
        projections = inputs.lidar2img.to(images.device, torch.float32)
        maps = self.img_neck(self.img_backbone(images))
        predictions: VADPredictions = self.pts_bbox_head(
            maps,
            images,
            projections,
            motion,
            memory.bev if memory else None,
            self.finest_front(maps[0], images),
            memory.front if memory else None,
        )
        front = predictions.front
        absolute = inputs.can_bus.detach().to("cpu", torch.float64, copy=True)
        front_state = None if front is None else FrontReader.left(front, memory.front if memory else None)
        self._memory = _VADMemory(inputs.scene_token, absolute, predictions.bev, front_state)
        return predictions

    def finest_front(self, finest: Tensor, images: Tensor) -> Tensor:
        """Map of the front camera that the plan looks at, (1, C, h, w), as `compute_front_maps`."""
        return compute_front_maps(self.front_eyes, finest, images, self.config.cameras)

    def ego_motion(self, inputs: VADInputs) -> BEVMotion:
        """Motion of the ego since the frame that is remembered: zero if it is of another scene, or there is none."""
        memory = self._memory if self._memory and self._memory.scene_token == inputs.scene_token else None
        previous = memory.can_bus if memory else None
        return BEVMotion.between(previous, inputs.can_bus, self.config.grid, self.config.rotation_centre)
