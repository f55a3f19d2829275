"""From image features to a bird's-eye view, and from the view to agents and map elements."""

from collections import OrderedDict

import torch
from torch import Tensor, nn

from adapters.networks.layers.bev_geometry import turned_view
from adapters.networks.layers.bevformer import BEVFormerEncoder, ImageFeatures
from adapters.networks.layers.deformable_decoder import Decoded, DeformableDecoder
from adapters.networks.layers.ego_motion import CAN_BUS, EgoMotion
from adapters.networks.vad.config import VADConfig

LEVEL_EMBEDDINGS = 4
"""Published networks have as many whether or not they use them."""


class VADTransformer(nn.Module):
    """The encoder and the two decoders of VAD (section 3.1 of its paper)."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__()
        channels, heads, hidden = config.channels, config.heads, config.feedforward_channels
        self.level_embeds = nn.Parameter(torch.randn(max(LEVEL_EMBEDDINGS, config.pyramid_levels), channels))
        self.cams_embeds = nn.Parameter(torch.randn(config.cameras, channels))
        self.encoder = BEVFormerEncoder(
            config.grid,
            config.encoder_layers,
            channels,
            heads,
            hidden,
            config.pyramid_levels,
            config.bev_points,
            config.image_points,
            config.height_points,
        )
        decoder = (channels, heads, hidden, 1, config.bev_points, config.decoder_layers)
        self.decoder = DeformableDecoder(*decoder)
        self.map_decoder = DeformableDecoder(*decoder)
        self.reference_points = nn.Linear(channels, 3)
        self.map_reference_points = nn.Linear(channels, 2)
        self.can_bus_mlp = nn.Sequential(
            OrderedDict(
                [
                    ("0", nn.Linear(CAN_BUS, channels // 2)),
                    ("1", nn.ReLU()),
                    ("2", nn.Linear(channels // 2, channels)),
                    ("3", nn.ReLU()),
                    ("norm", nn.LayerNorm(channels)),
                ]
            )
        )

    def encode(
        self,
        queries: Tensor,
        positions: Tensor,
        maps: list[Tensor],
        images: Tensor,
        projections: Tensor,
        motion: EgoMotion,
        previous: Tensor | None,
    ) -> Tensor:
        """Bird's-eye view of one moment.

        Args:
            queries: (cells, C).
            positions: (cells, C).
            maps: For each level, (cameras, C, h, w) features.
            images: (cameras, 3, H, W) they are from.
            projections: (cameras, 4, 4) from metres to pixels.
            motion: Since the previous moment.
            previous: (cells, C) the view of the previous moment.

        Returns:
            (cells, C).
        """
        features = ImageFeatures.of(maps, images, self.cams_embeds, self.level_embeds)
        turned = None if previous is None else turned_view(previous, self.encoder.grid, motion.previous_cells)
        cells = queries + self.can_bus_mlp(motion.can_bus.to(queries.dtype))
        result: Tensor = self.encoder(cells, positions, features, projections, motion.shift, turned)
        return result

    def decode_agents(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> Decoded:
        """Agents in a bird's-eye view.

        Args:
            queries: (A, 2 C), positions and then contents.
            bev: (cells, C).
            branches: For each layer, (A, C) to (A, 10) corrections.

        Returns:
            States and x, y, z of the agents.
        """
        positions, contents = queries.chunk(2, -1)
        references = self.reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: Decoded = self.decoder(contents, positions, references, bev, shapes, branches, (0, 1, 4))
        return decoded

    def decode_map(self, queries: Tensor, bev: Tensor, branches: nn.ModuleList) -> Decoded:
        """Points of map elements in a bird's-eye view; arguments as in `decode_agents`, corrections (M * P, 2)."""
        positions, contents = queries.chunk(2, -1)
        references = self.map_reference_points(positions).float().sigmoid()
        shapes = (self.encoder.grid.shape,)
        decoded: Decoded = self.map_decoder(contents, positions, references, bev, shapes, branches, (0, 1))
        return decoded
