"""Base of the networks with a bird's-eye view, and its encoder BEVFormer (Li et al., ECCV 2022)."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualFeedForward
from adapters.networks.layers.bev_geometry import BEVGrid, VisibleCells, find_visible_cells, rotate_view
from adapters.networks.layers.deformable_attention import SamplingPattern, Shapes, deformable_sampling, ring_of_offsets
from adapters.networks.layers.deformable_decoder import DeformableDecoder
from adapters.networks.layers.ego_motion import CAN_BUS, BEVMotion
from adapters.networks.layers.reporting import PUBLISHED, ReportingRules


@dataclass(frozen=True, slots=True, kw_only=True)
class BEVConfig:
    """Sizes that fix names and shapes of parameters, and how a network reads its inputs.

    Attributes:
        bev_rows: Cells of the bird's-eye view along y, the driving direction.
        perception_range_m: x, y, z of one corner, then of the other, in the lidar frame.
        decoder_layers: Of the agent decoder, and of others like it.
        pyramid_levels: Outputs of the feature pyramid; those past the stages are strided convolutions.
        backbone_blocks: Residual blocks in the stages of the image network, of which there are four or as many as are
            read; (3, 4, 6, 3) is ResNet-50, (3, 4, 23, 3) is ResNet-101.
        backbone_width: Channels after its first convolution; 64 in both.
        channels: Width of all tokens; a multiple of `heads` and of 4.
        height_points: Heights of the pillar over a cell at which images are sampled.
        image_points: Sampling points per head and level in images, a multiple of `height_points`.
        bev_points: Sampling points per head in the bird's-eye view.
        rotation_centre: Column and row of the previous view, in cells, around which it is turned.
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
    reporting: ReportingRules = PUBLISHED

    @property
    def grid(self) -> BEVGrid:
        """The bird's-eye view."""
        return BEVGrid(self.bev_rows, self.bev_columns, self.perception_range_m)


class TemporalSelfAttention(nn.Module):
    """Cells attend to the previous view and to their own. `points` are looks per head and view."""

    def __init__(self, channels: int, heads: int, points: int) -> None:
        super().__init__()
        self.heads, self.points = heads, points
        self.sampling_offsets = nn.Linear(2 * channels, heads * 2 * points * 2)
        self.attention_weights = nn.Linear(2 * channels, heads * 2 * points)
        self.value_proj = nn.Linear(channels, channels)
        self.output_proj = nn.Linear(channels, channels)
        for layer in (self.sampling_offsets, self.attention_weights):
            nn.init.zeros_(layer.weight)
        nn.init.zeros_(self.attention_weights.bias)
        with torch.no_grad():
            self.sampling_offsets.bias.copy_(ring_of_offsets(heads, 2, points))

    def forward(
        self,
        cells: Tensor,
        positions: Tensor,
        references: Tensor,
        shape: tuple[int, int],
        views: tuple[Tensor, Tensor] | None,
    ) -> Tensor:
        """Cells, (cells, C), that have looked at the previous and at this view around (cells, 2) x, y, 0 to 1.

        `views` are (cells, C) each; without a past the cells stand for both.
        """
        past = cells if views is None else views[0]
        query = torch.cat([past, cells + positions], -1)
        offsets = self.sampling_offsets(query).view(-1, self.heads, 2, self.points, 2)
        logits = self.attention_weights(query).view(-1, self.heads, 2, self.points)
        # The mean of the two views, each of which has weights that sum to one.
        weights = logits.float().softmax(-1) / 2
        projected = [self.value_proj(view) for view in (views or (cells,))]
        values = torch.cat([projected[0], projected[-1]]).view(2 * len(cells), self.heads, -1)
        sampled = deformable_sampling(values[None], (shape, shape), references[:, None, None, None], offsets, weights)
        attended: Tensor = self.output_proj(sampled)
        return cells + attended


class SpatialCrossAttention(nn.Module):
    """Attention of cells to the images that see them; `points` looks per head and map, a multiple of `heights`."""

    def __init__(self, channels: int, heads: int, levels: int, points: int) -> None:
        super().__init__()
        self.deformable_attention = SamplingPattern(channels, channels, heads, levels, points)
        self.output_proj = nn.Linear(channels, channels)
        nn.init.xavier_uniform_(self.output_proj.weight)
        nn.init.zeros_(self.output_proj.bias)

    def forward(self, cells: Tensor, features: Tensor, shapes: Shapes, hits: VisibleCells) -> Tensor:
        """Cells, (cells, C), that have looked at the (cameras, S, C) features of the cameras that see them."""
        pattern = self.deformable_attention
        # Point p belongs to height p modulo heights.
        heights = hits.image_points.shape[1]
        references = hits.image_points.repeat(1, pattern.points // heights, 1)[:, None, None]
        sampled = deformable_sampling(
            pattern.values(features),
            shapes,
            references,
            pattern.offsets(cells)[hits.cell],
            pattern.weights(cells)[hits.cell],
            hits.camera,
        )
        # Summed in one order on every device; graphics cards add to an index in any order.
        summed = F.embedding_bag(hits.cell_order, sampled, hits.cell_starts, mode="sum")
        attended: Tensor = self.output_proj(summed / hits.cameras_per_cell.to(summed.dtype))
        return cells + attended


class BEVFormerLayer(nn.Module):
    """Past, images, feed-forward; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, bev_points: int, image_points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList(
            [
                TemporalSelfAttention(channels, heads, bev_points),
                SpatialCrossAttention(channels, heads, levels, image_points),
            ]
        )
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(
        self,
        cells: Tensor,
        positions: Tensor,
        references: Tensor,
        shape: tuple[int, int],
        views: tuple[Tensor, Tensor] | None,
        images: "ImageFeatures",
        hits: VisibleCells,
    ) -> Tensor:
        """Arguments as in `TemporalSelfAttention` and `SpatialCrossAttention`; (cells, C) to (cells, C)."""
        cells = self.norms[0](self.attentions[0](cells, positions, references, shape, views))
        cells = self.norms[1](self.attentions[1](cells, images.features, images.shapes, hits))
        result: Tensor = self.norms[2](self.ffns[0](cells))
        return result


@dataclass(frozen=True, slots=True)
class ImageFeatures:
    """Features of all cameras. (cameras, S, C), each map row by row, fine to coarse."""

    features: Tensor
    shapes: tuple[tuple[int, int], ...]
    height: int
    width: int

    @classmethod
    def of(cls, maps: Sequence[Tensor], images: Tensor, cameras: Tensor, levels: Tensor) -> "ImageFeatures":
        """Features with all maps in one row, each cell with the embedding of its camera and level.

        `maps` are (cameras, C, h, w) for each level, of (cameras, 3, H, W) images; `cameras` (cameras, C) and `levels`
        (levels or more, C) are embeddings.
        """
        flat = [
            features.flatten(2).transpose(1, 2) + cameras[:, None] + levels[level]
            for level, features in enumerate(maps)
        ]
        shapes = tuple((features.shape[-2], features.shape[-1]) for features in maps)
        return cls(torch.cat(flat, 1), shapes, images.shape[-2], images.shape[-1])


class BEVFormerEncoder(nn.Module):
    """A stack of `BEVFormerLayer` over a grid."""

    pillars: Tensor
    centres: Tensor

    def __init__(self, config: BEVConfig) -> None:
        super().__init__()
        points, heights = config.image_points, config.height_points
        if points % heights:
            raise ValueError(f"{points} points per head cannot be shared evenly by {heights} heights")
        self.grid = config.grid
        self.register_buffer("pillars", self.grid.pillars(heights), persistent=False)
        self.register_buffer("centres", self.grid.centres(), persistent=False)
        sizes = (config.channels, config.heads, config.feedforward_channels, config.pyramid_levels)
        self.layers = nn.ModuleList(
            [BEVFormerLayer(*sizes, config.bev_points, points) for _ in range(config.encoder_layers)]
        )

    def forward(
        self,
        cells: Tensor,
        positions: Tensor,
        images: ImageFeatures,
        projections: Tensor,
        shift: Tensor,
        previous: Tensor | None,
    ) -> Tensor:
        """Bird's-eye view of one moment, (cells, C), from (cells, C) queries and positions.

        `projections` are (cameras, 4, 4) from metres to pixels; `shift` is (2,) x, y of the ego's motion, 1 for the
        length of the grid. Both views are sampled as if shifted, the present one too: the published code adds in place,
        and its weights have learned it. `previous` is the (cells, C) previous view, turned to the present heading.
        """
        hits = find_visible_cells(self.pillars, projections, images.height, images.width)
        references = self.centres + shift
        # With a past, all layers look at the queries of the first one as the present.
        views = None if previous is None else (previous, cells)
        for layer in self.layers:
            cells = layer(cells, positions, references, self.grid.shape, views, images, hits)
        return cells


class BEVTransformer(nn.Module):
    """Encoder of the bird's-eye view; subclasses add decoders and then, as is published, `can_bus_mlp`."""

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
        motion: BEVMotion,
        previous: Tensor | None,
    ) -> Tensor:
        """Bird's-eye view of one moment, (cells, C), like the queries, positions and previous view of the scene.

        `maps` are (cameras, C, h, w) for each level, of (cameras, 3, H, W) images; `projections` (cameras, 4, 4) from
        metres to pixels.
        """
        features = ImageFeatures.of(maps, images, self.cams_embeds, self.level_embeds)
        turned = None if previous is None else rotate_view(previous, self.encoder.grid, motion.previous_cells)
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
