"""What the networks with a bird's-eye view share: how they see it (BEVFormer, Li et al., 2022)."""

from collections import OrderedDict

import torch
from torch import Tensor, nn

from adapters.networks.layers.bev_config import BEVConfig
from adapters.networks.layers.bev_geometry import turned_view
from adapters.networks.layers.bevformer import BEVFormerEncoder, ImageFeatures
from adapters.networks.layers.deformable_decoder import DeformableDecoder
from adapters.networks.layers.ego_motion import CAN_BUS, EgoMotion


class BEVTransformer(nn.Module):
    """Encoder of the bird's-eye view; subclasses add decoders and then, as is published, `can_bus_mlp`.

    `level_embeddings` counts the feature maps for which there are parameters.
    """

    can_bus_mlp: nn.Sequential

    def __init__(self, config: BEVConfig, level_embeddings: int) -> None:
        super().__init__()
        channels = config.channels
        self.level_embeds = nn.Parameter(torch.randn(level_embeddings, channels))
        self.cams_embeds = nn.Parameter(torch.randn(config.cameras, channels))
        self.encoder = BEVFormerEncoder(config)

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
        """Bird's-eye view of one moment, (cells, C).

        `queries`, `positions` and the `previous` view of the same scene are (cells, C); `maps` (cameras, C, h, w)
        features for each level, of (cameras, 3, H, W) images; `projections` (cameras, 4, 4) from metres to pixels.
        """
        features = ImageFeatures.of(maps, images, self.cams_embeds, self.level_embeds)
        turned = None if previous is None else turned_view(previous, self.encoder.grid, motion.previous_cells)
        cells = queries + self.can_bus_mlp(motion.can_bus.to(queries.dtype))
        result: Tensor = self.encoder(cells, positions, features, projections, motion.shift, turned)
        return result


def bev_decoder(config: BEVConfig) -> DeformableDecoder:
    """A decoder of queries that look at the bird's-eye view."""
    return DeformableDecoder(
        config.channels, config.heads, config.feedforward_channels, 1, config.bev_points, config.decoder_layers
    )


def can_bus_network(channels: int) -> nn.Sequential:
    """Layers from the CAN bus vector to the channels that are added to every cell."""
    return nn.Sequential(
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
