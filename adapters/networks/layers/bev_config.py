"""What the networks with a bird's-eye view have in common: their sizes."""

from dataclasses import dataclass

from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.layers.reporting import PUBLISHED, Reporting


@dataclass(frozen=True, slots=True, kw_only=True)
class BEVConfig:
    """Sizes that fix names and shapes of parameters, and how a network reads its inputs.

    Attributes:
        bev_rows: Cells of the bird's-eye view along y, the driving direction.
        bev_columns: Cells along x.
        perception_range_m: x, y, z of one corner, then of the other, in the lidar frame.
        decoder_layers: Layers of the agent decoder, and of others like it.
        pyramid_levels: Outputs of the feature pyramid; those past the stages are strided convolutions.
        max_boxes: Boxes (and tracks) that are reported.
        max_lines: Map elements that are reported.
        backbone_blocks: Residual blocks in the stages of the image network, of which there are four or as many as are
            read; (3, 4, 6, 3) is ResNet-50, (3, 4, 23, 3) is ResNet-101.
        backbone_width: Channels after its first convolution; 64 in both.
        channels: Width of all tokens; a multiple of `heads` and of 4.
        feedforward_channels: Hidden width of the feed-forward blocks.
        cameras: Cameras, in the order of the specification.
        height_points: Heights of the pillar over a cell at which images are sampled.
        image_points: Sampling points per head and level in images, a multiple of `height_points`.
        bev_points: Sampling points per head in the bird's-eye view.
        rotation_centre: Column and row of the previous view, in cells, around which it is turned.
        reporting: Which of its boxes count as what it expects, and which way short plans lead.
    """

    bev_rows: int
    bev_columns: int
    perception_range_m: tuple[float, float, float, float, float, float]
    encoder_layers: int
    decoder_layers: int
    pyramid_levels: int
    max_boxes: int
    max_lines: int
    backbone_blocks: tuple[int, ...]
    backbone_width: int = 64
    channels: int = 256
    feedforward_channels: int = 512
    heads: int = 8
    agent_classes: int = 10
    map_classes: int = 3
    modes: int = 6
    commands: int = 3
    cameras: int = 6
    height_points: int = 4
    image_points: int = 8
    bev_points: int = 4
    rotation_centre: tuple[float, float] = (100.0, 100.0)
    reporting: Reporting = PUBLISHED

    @property
    def grid(self) -> BEVGrid:
        """The bird's-eye view."""
        return BEVGrid(self.bev_rows, self.bev_columns, self.perception_range_m)
