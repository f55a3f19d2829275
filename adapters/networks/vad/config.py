"""Sizes of a VAD network: the two published ones, and any other for tests and miniatures."""

from dataclasses import dataclass
from typing import Self

from adapters.camera_inputs import ImageFormat
from adapters.networks.layers.bev_geometry import BEVGrid


@dataclass(frozen=True, slots=True)
class VADConfig:
    """What fixes the names and the shapes of a network's parameters, and how it reads its inputs.

    Attributes:
        bev_rows: Cells of the bird's-eye view along y, the driving direction.
        bev_columns: Cells along x.
        perception_range_m: x, y, z of one corner, then of the other, in the lidar frame.
        channels: Width of all tokens; a multiple of `heads` and of 4.
        feedforward_channels: Hidden width of the feed-forward blocks.
        heads: Attention heads.
        encoder_layers: Layers of the bird's-eye-view encoder.
        decoder_layers: Layers of the agent decoder and of the map decoder.
        agents: Agent queries.
        map_instances: Map queries.
        points_per_line: Points of a map element.
        agent_classes: Kinds of agents.
        map_classes: Kinds of map elements.
        modes: Forecasts per agent.
        steps: Planned and forecast steps of 0.5 s.
        commands: Plans, one for each driving command.
        cameras: Cameras, in the order of the specification.
        backbone_blocks: Residual blocks in the four stages of the image network; (3, 4, 6, 3) is ResNet-50.
        backbone_width: Channels after its first convolution; 64 in ResNet-50.
        backbone_outputs: Stages (0 to 3) that feed the feature pyramid.
        pyramid_levels: Outputs of the feature pyramid; those past the stages are strided convolutions.
        height_points: Heights of the pillar over a cell at which images are sampled.
        image_points: Sampling points per head and level in images, a multiple of `height_points`.
        bev_points: Sampling points per head in the bird's-eye view.
        rotation_centre: Column and row of the previous view, in cells, around which it is turned.
        lane_distance: Largest distance, as a share of the perception range, at which a map element is seen by an agent.
        lane_score: Least score of a map element that an agent sees.
        max_boxes: Boxes that are reported.
        max_lines: Map elements that are reported.
        image_scale: Scale of input images against 1600 x 900.
        image_size: Width and height of input images, if they are not 1600 x 900 scaled.
    """

    bev_rows: int
    bev_columns: int
    encoder_layers: int
    decoder_layers: int
    backbone_outputs: tuple[int, ...]
    pyramid_levels: int
    image_scale: float
    perception_range_m: tuple[float, float, float, float, float, float] = (-15.0, -30.0, -2.0, 15.0, 30.0, 2.0)
    channels: int = 256
    feedforward_channels: int = 512
    heads: int = 8
    agents: int = 300
    map_instances: int = 100
    points_per_line: int = 20
    agent_classes: int = 10
    map_classes: int = 3
    modes: int = 6
    steps: int = 6
    commands: int = 3
    cameras: int = 6
    backbone_blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    backbone_width: int = 64
    height_points: int = 4
    image_points: int = 8
    bev_points: int = 4
    rotation_centre: tuple[float, float] = (100.0, 100.0)
    lane_distance: float = 0.2
    lane_score: float = 0.5
    max_boxes: int = 100
    max_lines: int = 50
    image_size: tuple[int, int] | None = None

    @property
    def grid(self) -> BEVGrid:
        """The bird's-eye view."""
        return BEVGrid(self.bev_rows, self.bev_columns, self.perception_range_m)

    @property
    def image_format(self) -> ImageFormat:
        """What images the network reads."""
        return ImageFormat.scaled(self.image_scale) if self.image_size is None else ImageFormat(*self.image_size)

    @classmethod
    def tiny(cls) -> Self:
        """VAD-tiny: 100 x 100 cells, three layers, images at 0.4."""
        return cls(
            bev_rows=100,
            bev_columns=100,
            encoder_layers=3,
            decoder_layers=3,
            backbone_outputs=(3,),
            pyramid_levels=1,
            image_scale=0.4,
        )

    @classmethod
    def base(cls) -> Self:
        """VAD-base: 200 x 200 cells, six layers, images at 0.8."""
        return cls(
            bev_rows=200,
            bev_columns=200,
            encoder_layers=6,
            decoder_layers=6,
            backbone_outputs=(1, 2, 3),
            pyramid_levels=4,
            image_scale=0.8,
        )

    @classmethod
    def miniature(cls) -> Self:
        """VAD-mini: what two processor cores can train, for images of 224 x 128; made for the embedded town."""
        return cls(
            bev_rows=32,
            bev_columns=24,
            perception_range_m=(-30.0, -32.0, -2.5, 30.0, 32.0, 0.5),
            encoder_layers=1,
            decoder_layers=2,
            backbone_outputs=(2,),
            pyramid_levels=1,
            image_scale=0.14,
            image_size=(224, 128),
            channels=64,
            feedforward_channels=128,
            heads=2,
            agents=50,
            map_instances=20,
            points_per_line=10,
            backbone_blocks=(1, 1, 1, 1),
            backbone_width=16,
            height_points=2,
            image_points=4,
            bev_points=2,
            rotation_centre=(12.0, 16.0),
            max_boxes=50,
            max_lines=20,
        )
