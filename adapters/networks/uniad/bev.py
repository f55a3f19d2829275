"""From image features to a bird's-eye view, and from the view to boxes for all queries (BEVFormer, Li et al., 2022)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.bev_network import BEVTransformer, bev_decoder, can_bus_network
from adapters.networks.layers.branches import normalised_branch, plain_branch
from adapters.networks.layers.coders import box_codes, logit, metres
from adapters.networks.layers.ego_motion import EgoMotion
from adapters.networks.layers.positional import LearnedGridEncoding
from adapters.networks.uniad.config import UniADConfig

BOX_CODE = 10
PAST_STEPS = 8
"""Past positions that the published network also predicts and does not use."""


@dataclass(frozen=True, slots=True)
class Detections:
    """Predictions of the K layers of the decoder for Q queries.

    Attributes:
        states: (K, Q, C).
        class_logits: (K, Q, classes).
        box_codes: (K, Q, 10) as `adapters.networks.layers.coders.box_codes`, metres in the lidar frame.
        reference_logits: (Q, 3) logits of the last layer's centres as shares of the perception range.
    """

    states: Tensor
    class_logits: Tensor
    box_codes: Tensor
    reference_logits: Tensor


class DetectionTransformer(BEVTransformer):
    """The encoder of the bird's-eye view and the decoder of agents."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__(config, config.pyramid_levels)
        self.decoder = bev_decoder(config)
        self.can_bus_mlp = can_bus_network(config.channels)


class DetectionHead(nn.Module):
    """Bird's-eye view and boxes (sections 3.1 of the paper)."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        self.config = config
        channels, layers = config.channels, config.decoder_layers
        # Weights of training losses; nothing reads them here, but published checkpoints hold them.
        self.code_weights = nn.Parameter(torch.tensor([1.0] * 8 + [0.2] * 2), requires_grad=False)
        self.positional_encoding = LearnedGridEncoding(config.bev_rows, config.bev_columns, channels)
        self.transformer = DetectionTransformer(config)
        self.cls_branches = nn.ModuleList([normalised_branch(channels, config.agent_classes) for _ in range(layers)])
        self.reg_branches = nn.ModuleList([plain_branch(channels, BOX_CODE) for _ in range(layers)])
        self.past_traj_reg_branches = nn.ModuleList([plain_branch(channels, PAST_STEPS * 2) for _ in range(layers)])
        self.bev_embedding = nn.Embedding(config.grid.cells, channels)

    def encode(
        self, maps: list[Tensor], images: Tensor, projections: Tensor, motion: EgoMotion, previous: Tensor | None
    ) -> Tensor:
        """(cells, C) bird's-eye view of one moment; arguments as in `BEVTransformer.encode`."""
        return self.transformer.encode(
            self.bev_embedding.weight, self.positional_encoding(), maps, images, projections, motion, previous
        )

    def detect(self, bev: Tensor, queries: Tensor, reference_logits: Tensor) -> Detections:
        """Boxes of (Q, 2 C) queries, positions and then contents, in a bird's-eye view of (cells, C), after each layer.

        `reference_logits` are (Q, 3) of where they look first.
        """
        positions, contents = queries.chunk(2, -1)
        references, shapes = reference_logits.float().sigmoid(), (self.config.grid.shape,)
        decoded = self.transformer.decoder(contents, positions, references, bev, shapes, self.reg_branches, (0, 1, 4))
        logits = [branch(states).float() for branch, states in zip(self.cls_branches, decoded.states, strict=True)]
        lower, upper = self.config.perception_range_m[:3], self.config.perception_range_m[3:]
        return Detections(
            states=decoded.states,
            class_logits=torch.stack(logits),
            box_codes=box_codes(metres(decoded.references, lower, upper), decoded.corrections),
            reference_logits=logit(decoded.references[-1]),
        )

    def past_offsets(self, states: Tensor) -> Tensor:
        """(Q, C) states of the last layer to (Q, 8, 2) past positions; for diagnosis, nothing here uses them."""
        predicted: Tensor = self.past_traj_reg_branches[-1](states)
        return predicted.float().view(-1, PAST_STEPS, 2)
