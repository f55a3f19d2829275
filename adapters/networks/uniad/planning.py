"""UniAD's plan (section 3.4 of the paper), and its inputs, intermediate results and outputs for one key frame."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.ego_motion import EgoStatusEncoder
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.uniad.collision_optimiser import MovedPlan
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.map_masks import PastedMasks
from adapters.networks.uniad.motion import MotionForecasts
from adapters.networks.uniad.occupancy import Occupancy
from adapters.networks.uniad.tracking import Boxes, Detections, Instances


@dataclass(frozen=True, slots=True)
class UniADPlan:
    """The plan before it is moved away from occupied cells.

    `fused` are the (modes, C) modes of the ego with track and command, `attended` (C,) the ego after looking at the
    bird's-eye view, `positions_m` (steps, 2) of the lidar in the lidar frame, 0.5 s to 3 s ahead, `front` (1, numbers)
    of the front camera; ``None`` if the plan does not look there.
    """

    fused: Tensor
    attended: Tensor
    positions_m: Tensor
    front: Tensor | None


class PlanningHead(nn.Module):
    """The planner."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        self.config = config
        channels, hidden = config.channels, config.feedforward_channels
        self.navi_embed = nn.Embedding(config.commands, channels)
        self.reg_branch = nn.Sequential(
            nn.Linear(channels, channels), nn.ReLU(), nn.Linear(channels, config.plan_steps * 2)
        )
        layer = nn.TransformerDecoderLayer(channels, config.heads, hidden, batch_first=True)
        self.attn_module = nn.TransformerDecoder(layer, config.plan_layers)
        self.mlp_fuser = nn.Sequential(nn.Linear(3 * channels, channels), nn.LayerNorm(channels), nn.ReLU())
        self.pos_embed = nn.Embedding(1, channels)
        numbers = config.plan_sees_front
        self.front_reader = FrontReader(channels, numbers, 2 * channels) if numbers else None
        self.motion_teller = EgoStatusEncoder(2 * channels) if config.plan_knows_motion else None
        self.bev_adapter = nn.Sequential(
            *(
                nn.Sequential(
                    nn.Conv2d(channels, channels // 2, 3, padding=1), nn.ReLU(), nn.Conv2d(channels // 2, channels, 1)
                )
                for _ in range(3)
            )
        )

    def forward(
        self,
        bev: Tensor,
        bev_positions: Tensor,
        mode_queries: Tensor,
        state: Tensor,
        command: int,
        finest_front: Tensor,
        can_bus: Tensor,
    ) -> UniADPlan:
        """Plan of a key frame in a bird's-eye view of (cells, C).

        `mode_queries` are (modes, C) forecast states of the ego, `state` (C,) its track; `command` 0 right, 1 left, 2
        straight; `finest_front` the (1, C, h, w) finest feature map of the front camera; `can_bus` (18,) float32, as in
        `BEVMotion`.
        """
        front: Tensor | None = None
        messages: list[Tensor] = []
        if self.front_reader is not None:
            front = self.front_reader(finest_front)
            messages.append(self.front_reader.tell(front))
        if self.motion_teller is not None:
            messages.append(self.motion_teller(can_bus))
        to_state, to_plan = torch.cat(messages).sum(0).chunk(2) if messages else (None, None)
        if to_state is not None:
            state = state + to_state
        shared = torch.cat([state, self.navi_embed.weight[command]]).expand(len(mode_queries), -1)
        fused = self.mlp_fuser(torch.cat([mode_queries, shared], -1))
        query = fused.amax(0, keepdim=True) + self.pos_embed.weight
        rows, columns = self.config.grid.shape
        image = (bev + bev_positions).view(1, rows, columns, -1).permute(0, 3, 1, 2)
        image = image + self.bev_adapter(image)
        attended = self.attn_module(query[None], image.flatten(2).transpose(1, 2))[0, 0]
        if to_plan is not None:
            attended = attended + to_plan
        steps = self.reg_branch(attended).float().view(self.config.plan_steps, 2)
        return UniADPlan(fused, attended, steps.cumsum(0), front)


@dataclass(frozen=True, slots=True)
class UniADInputs:
    """One key frame; a change of scene forgets the past, but for what `UniAD.reset` says.

    `images` are (6, 3, H, W), normalised and padded: front, front right, front left, back, back left, back right;
    `lidar2img` (6, 4, 4), lidar frame in metres to pixels of the padded images; `can_bus` (18,) float64, absolute. For
    rows of (3, 3) and (3,) metres, global = lidar @ l2g_r_mat + l2g_t. `timestamp` is in seconds; `command` 0 right, 1
    left, 2 straight.
    """

    images: Tensor
    lidar2img: Tensor
    can_bus: Tensor
    l2g_r_mat: Tensor
    l2g_t: Tensor
    timestamp: float
    command: int
    scene_token: str


@dataclass(frozen=True, slots=True)
class UniADOutputs:
    """Outputs for one key frame; lidar frame, x right, y forward, metres and radians.

    Attributes:
        plan: (6, 2) float32 positions of the lidar origin 0.5 s to 3 s ahead.
        plan_before_optimisation: (6, 2) the same before it is moved away from occupied cells.
        collision: How it was moved; ``None`` if that is switched off.
        boxes: (N, 9) centre x, y, z, width, length, height, yaw, velocity x, y of tracks. Yaw is that of the heading,
            counter-clockwise from the x axis; length lies along it.
        box_scores: (N,) 0 to 1, falling.
        box_labels: (N,) index into `benchmark.constants.DETECTION_CLASSES`.
        track_ids: (N,) the same for the same agent from frame to frame.
        trajectories: (N, 6 modes, 12 steps, 2) forecast centres 0.5 s to 6 s ahead.
        trajectory_scores: (N, 6) probabilities of the modes, sum 1.
        occupied: (5, 200, 200) booleans, now and every 0.5 s, as `adapters.networks.uniad.occupancy.Occupancy`.
        road: Masks of map elements and of the drivable area; ``None`` if they are switched off.
    """

    plan: Tensor
    plan_before_optimisation: Tensor
    collision: MovedPlan | None
    boxes: Tensor
    box_scores: Tensor
    box_labels: Tensor
    track_ids: Tensor
    trajectories: Tensor
    trajectory_scores: Tensor
    occupied: Tensor
    road: PastedMasks | None


@dataclass(frozen=True, slots=True)
class UniADPredictions:
    """Everything that the network computes for one key frame.

    Attributes:
        bev: (cells, C) bird's-eye view.
        moved_references: (T, 3) where the T tracks were expected, logits of shares of the perception range.
        entering: Queries that went into the decoder.
        after: The same instances after the life cycle and the memory.
        tracks: The N that are reported, falling scores.
        forecasts: For the tracks and then the ego.
        vehicles: (N,) which tracks the occupancy is of.
        plan: Before it is moved away from occupied cells.
    """

    bev: Tensor
    moved_references: Tensor
    entering: Instances
    detections: Detections
    after: Instances
    next_instances: Instances
    tracks: Boxes
    ego: Boxes
    elements: MapElements
    forecasts: MotionForecasts
    vehicles: Tensor
    occupancy: Occupancy
    plan: UniADPlan
