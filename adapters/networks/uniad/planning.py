"""The plan from the ego's forecast, its track, the command and the bird's-eye view (section 3.4 of the paper)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.layers.motion_teller import MotionTeller
from adapters.networks.uniad.config import UniADConfig


@dataclass(frozen=True, slots=True)
class UniADPlan:
    """The plan before it is moved away from occupied cells.

    Attributes:
        fused: (modes, C) the ego's modes with track and command.
        attended: (C,) the ego after looking at the bird's-eye view.
        positions_m: (steps, 2) of the lidar in the lidar frame, 0.5 s to 3 s ahead.
        front: (1, numbers) what the plan took from the front camera; ``None`` if it does not look there.
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
        self.motion_teller = MotionTeller(2 * channels) if config.plan_knows_motion else None
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

        `mode_queries` are (modes, C) forecast states of the ego, `state` (C,) its track; `command` is 0 right, 1 left,
        2 straight; `finest_front` the (1, C, h, w) finest feature map of the front camera; `can_bus` (18,) float32, as
        `adapters.networks.layers.ego_motion.EgoMotion` has it.
        """
        front: Tensor | None = None
        told: list[Tensor] = []
        if self.front_reader is not None:
            front = self.front_reader(finest_front)
            told.append(self.front_reader.tell(front))
        if self.motion_teller is not None:
            told.append(self.motion_teller(can_bus))
        to_state, to_plan = torch.cat(told).sum(0).chunk(2) if told else (None, None)
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
