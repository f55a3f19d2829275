"""Sizes of a UniAD network: the published one, and any other for tests and miniatures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Self

from adapters.camera_inputs import MINIATURE_IMAGE, ImageFormat
from adapters.networks.layers.bev_geometry import BEVGrid

PUBLISHED_IMAGE: Final = ImageFormat.scaled(1.0)
MAP_OFFSETS: Final = "seg_head.transformer.encoder.layers.0.attentions.0.sampling_offsets.weight"
"""The tensor whose shape tells for how many levels a checkpoint's map head was made."""


@dataclass(frozen=True, slots=True)
class UniADConfig:
    """What fixes the names and the shapes of a network's parameters, and how it reads its inputs.

    Attributes:
        bev_rows: Cells of the bird's-eye view along y, the driving direction; a multiple of 8.
        bev_columns: Cells along x; a multiple of 8.
        perception_range_m: x, y, z of one corner, then of the other, in the lidar frame.
        channels: Width of all tokens; a multiple of `heads` and of 4.
        feedforward_channels: Hidden width of the feed-forward blocks.
        occupancy_feedforward_channels: The same in the decoder of the occupancy head.
        heads: Attention heads.
        encoder_layers: Layers of the bird's-eye-view encoder.
        decoder_layers: Layers of the agent decoder.
        queries: Agent queries beside the one of the ego.
        agent_classes: Kinds of agents.
        map_queries: Queries for map elements.
        map_classes: Kinds of map elements.
        map_layers: Layers of the map head's encoder, and of its decoder.
        map_levels: Feature maps for which the map head's attention has parameters; it is given one map
            (`adapters.networks.uniad.map_attention`).
        thing_mask_layers: Blocks that make the masks of map elements.
        stuff_mask_layers: Blocks that make the mask of the drivable area.
        motion_layers: Layers of the forecast.
        motion_groups: Groups of kinds of agents with anchors of their own.
        modes: Forecasts per agent.
        forecast_steps: Forecast steps of 0.5 s.
        occupancy_steps: The present and steps of 0.5 s after it.
        plan_layers: Layers of the planner.
        plan_steps: Planned steps of 0.5 s.
        commands: Driving commands.
        cameras: Cameras, in the order of the specification.
        backbone_blocks: Residual blocks in the four stages of the image network; (3, 4, 23, 3) is ResNet-101.
        backbone_width: Channels after its first convolution; 64 in ResNet-101.
        backbone_style: Which convolution of its blocks strides, as in `adapters.networks.layers.resnet.Bottleneck`.
        deformable_stages: Its stages whose 3 x 3 convolutions are deformable.
        pyramid_levels: Feature maps of an image that the bird's-eye view reads, 3 or more.
        height_points: Heights of the pillar over a cell at which images are sampled.
        image_points: Sampling points per head and level in images, a multiple of `height_points`.
        bev_points: Sampling points per head in the bird's-eye view.
        memory_length: States that a track remembers.
        max_boxes: Most tracks, and most boxes, that are reported.
        max_lines: Map elements that get a mask.
        occupancy_half_m: Half the side of the square whose occupancy is predicted.
        occupied_above: Occupancy times the track's score above which a cell counts as occupied.
        rotation_centre: Column and row of the previous view, in cells, around which it is turned.
        image_format: Its images.
        motion_across_scenes: Whether the first key frame of a scene is told the motion from wherever the ego was last
            (in the very first, from the origin), as the published network is; else that it has not moved.
        counterclockwise_yaw: Whether the yaw of boxes is the heading plus a quarter turn. The published network's is
            the negative of that, so that it turns the anchors of agents that cross to the wrong side.
    """

    bev_rows: int = 200
    bev_columns: int = 200
    perception_range_m: tuple[float, float, float, float, float, float] = (-51.2, -51.2, -5.0, 51.2, 51.2, 3.0)
    channels: int = 256
    feedforward_channels: int = 512
    occupancy_feedforward_channels: int = 2048
    heads: int = 8
    encoder_layers: int = 6
    decoder_layers: int = 6
    queries: int = 900
    agent_classes: int = 10
    map_queries: int = 300
    map_classes: int = 3
    map_layers: int = 6
    map_levels: int = 4
    thing_mask_layers: int = 4
    stuff_mask_layers: int = 6
    motion_layers: int = 3
    motion_groups: int = 4
    modes: int = 6
    forecast_steps: int = 12
    occupancy_steps: int = 5
    plan_layers: int = 3
    plan_steps: int = 6
    commands: int = 3
    cameras: int = 6
    backbone_blocks: tuple[int, int, int, int] = (3, 4, 23, 3)
    backbone_width: int = 64
    backbone_style: Literal["pytorch", "caffe"] = "caffe"
    deformable_stages: tuple[int, ...] = (2, 3)
    pyramid_levels: int = 4
    height_points: int = 4
    image_points: int = 8
    bev_points: int = 4
    memory_length: int = 4
    max_boxes: int = 300
    max_lines: int = 100
    occupancy_half_m: float = 50.0
    occupied_above: float = 0.1
    rotation_centre: tuple[float, float] = (100.0, 100.0)
    image_format: ImageFormat = PUBLISHED_IMAGE
    motion_across_scenes: bool = True
    counterclockwise_yaw: bool = False

    @property
    def grid(self) -> BEVGrid:
        """The bird's-eye view."""
        return BEVGrid(self.bev_rows, self.bev_columns, self.perception_range_m)

    @classmethod
    def base(cls, map_levels: int = 4) -> Self:
        """The published network, base_e2e of stage 2; its map head has parameters for four levels, or for one."""
        return cls(map_levels=map_levels)

    @classmethod
    def miniature(cls) -> Self:
        """A network that two processor cores train in less than an hour; its weights come with this package."""
        return cls(
            bev_rows=24,
            bev_columns=24,
            perception_range_m=(-30.0, -30.0, -2.6, 30.0, 30.0, 0.6),
            channels=48,
            feedforward_channels=96,
            occupancy_feedforward_channels=96,
            heads=4,
            encoder_layers=1,
            decoder_layers=2,
            queries=80,
            map_queries=24,
            map_layers=1,
            map_levels=1,
            thing_mask_layers=1,
            stuff_mask_layers=1,
            motion_layers=2,
            plan_layers=2,
            backbone_blocks=(1, 1, 1, 1),
            backbone_width=16,
            backbone_style="pytorch",
            deformable_stages=(),
            pyramid_levels=3,
            height_points=2,
            image_points=4,
            bev_points=2,
            max_boxes=24,
            max_lines=12,
            occupancy_half_m=12.0,
            # Its occupancy is faint everywhere: at 0.1 the plan would be moved away from nothing.
            occupied_above=0.2,
            rotation_centre=(12.0, 12.0),
            image_format=MINIATURE_IMAGE,
            motion_across_scenes=False,
            counterclockwise_yaw=True,
        )

    @classmethod
    def base_of(cls, shapes: Mapping[str, Sequence[int]]) -> Self:
        """The published network that fits a checkpoint.

        Args:
            shapes: Of its tensors by name. Where the map head's are absent or odd, the result is the usual network, and
                whoever loads the tensors will say what does not fit.

        Returns:
            The configuration, with the levels that the map head's attention has parameters for.
        """
        base = cls.base()
        offsets = shapes.get(MAP_OFFSETS, ())
        one_level = 2 * base.heads * base.bev_points
        return cls.base(1) if len(offsets) == 2 and offsets[0] == one_level else base
