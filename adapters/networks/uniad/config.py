"""Sizes of a UniAD network: the published one, and any other for tests and miniatures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Self

from adapters.camera_inputs import MINIATURE_IMAGE, NetworkImageFormat
from adapters.networks.layers.bev_network import BEVConfig
from adapters.networks.layers.reporting import ReportingRules

PUBLISHED_IMAGE: Final = NetworkImageFormat.scaled(1.0)
MAP_OFFSETS: Final = "seg_head.transformer.encoder.layers.0.attentions.0.sampling_offsets.weight"
"""The tensor whose shape tells for how many levels a checkpoint's map head was made."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UniADConfig(BEVConfig):
    """Sizes of UniAD, beside those of all networks with a bird's-eye view, whose rows and columns are multiples of 8.

    Attributes:
        queries: Agent queries beside the one of the ego.
        map_levels: Feature maps for which the map head's attention has parameters; it is given one map
            (`adapters.networks.uniad.map_head`).
        thing_mask_layers: Blocks that make the masks of map elements.
        stuff_mask_layers: Blocks that make the mask of the drivable area.
        motion_groups: Groups of kinds of agents with anchors of their own.
        forecast_steps: Of 0.5 s, like the planned steps.
        occupancy_steps: The present and steps of 0.5 s after it.
        backbone_outputs: Stages (0 to 3) that feed the feature pyramid.
        backbone_style: As in `adapters.networks.layers.resnet.Bottleneck`.
        deformable_stages: Stages of the image network whose 3 x 3 convolutions are deformable.
        memory_length: States that a track remembers.
        occupancy_half_m: Half the side of the square whose occupancy is predicted.
        occupied_above: Occupancy times the track's score above which a cell counts as occupied.
        born_score: A query that is more certain becomes a track.
        asleep_score: A track that is less certain is not reported.
        tracks_apart: Tracks whose boxes' centres are nearer to each other than this share of the shorter one's length
            follow the same thing, and one of them ends, or is not born. 0: they all live, as published.
        motion_across_scenes: Whether the first key frame of a scene is told the motion from wherever the ego was last
            (in the very first, from the origin), as the published network is; else that it has not moved.
        plan_sees_front: Numbers that the plan takes from the finest feature map of the front camera beside the
            bird's-eye view; the published network has none.
        plan_knows_motion: Whether the plan is told speed, acceleration and yaw rate.
        counterclockwise_yaw: Whether the yaw of boxes is the heading plus a quarter turn. The published network's is
            the negative of that, so that it turns the anchors of agents that cross to the wrong side.
    """

    bev_rows: int = 200
    bev_columns: int = 200
    perception_range_m: tuple[float, float, float, float, float, float] = (-51.2, -51.2, -5.0, 51.2, 51.2, 3.0)
    occupancy_feedforward_channels: int = 2048
    encoder_layers: int = 6
    decoder_layers: int = 6
    queries: int = 900
    map_queries: int = 300
    map_layers: int = 6
    map_levels: int = 4
    thing_mask_layers: int = 4
    stuff_mask_layers: int = 6
    motion_layers: int = 3
    motion_groups: int = 4
    forecast_steps: int = 12
    occupancy_steps: int = 5
    plan_layers: int = 3
    plan_steps: int = 6
    backbone_blocks: tuple[int, ...] = (3, 4, 23, 3)
    backbone_outputs: tuple[int, ...] = (1, 2, 3)
    backbone_style: Literal["pytorch", "caffe"] = "caffe"
    deformable_stages: tuple[int, ...] = (2, 3)
    pyramid_levels: int = 4
    memory_length: int = 4
    max_boxes: int = 300
    max_lines: int = 100
    occupancy_half_m: float = 50.0
    occupied_above: float = 0.1
    born_score: float = 0.4
    asleep_score: float = 0.35
    tracks_apart: float = 0.0
    image_format: NetworkImageFormat = PUBLISHED_IMAGE
    motion_across_scenes: bool = True
    plan_sees_front: int = 0
    plan_knows_motion: bool = False
    counterclockwise_yaw: bool = False

    @classmethod
    def base(cls, map_levels: int = 4) -> Self:
        """The published network, base_e2e of stage 2; its map head has parameters for four levels, or for one."""
        return cls(map_levels=map_levels)

    @classmethod
    def miniature(cls) -> Self:
        """A network that two processor cores can train; its eyes are those of VAD-mini, which it starts from."""
        return cls(
            bev_rows=32,
            bev_columns=24,
            perception_range_m=(-30.0, -32.0, -2.5, 30.0, 32.0, 0.5),
            channels=64,
            feedforward_channels=128,
            occupancy_feedforward_channels=128,
            heads=2,
            encoder_layers=1,
            decoder_layers=2,
            queries=50,
            map_queries=24,
            map_layers=1,
            map_levels=1,
            thing_mask_layers=1,
            stuff_mask_layers=1,
            motion_layers=2,
            plan_layers=2,
            backbone_blocks=(1, 1, 1, 1),
            backbone_width=16,
            backbone_outputs=(1, 2),
            backbone_style="pytorch",
            deformable_stages=(),
            pyramid_levels=2,
            height_points=2,
            image_points=4,
            bev_points=2,
            max_boxes=24,
            max_lines=12,
            occupancy_half_m=12.0,
            # Its occupancy is low everywhere: at 0.1 the plan would avoid cells that are empty.
            occupied_above=0.2,
            rotation_centre=(12.0, 16.0),
            image_format=MINIATURE_IMAGE,
            # On scenes of a held-out town, seven of ten vehicles are tracked at this value.
            born_score=0.28,
            asleep_score=0.25,
            reporting=ReportingRules(least_score=0.25),
            # It redetects tracked vehicles: tracks would pile up, over twenty of them after 10 s.
            tracks_apart=0.5,
            motion_across_scenes=False,
            plan_sees_front=64,
            plan_knows_motion=True,
            counterclockwise_yaw=True,
        )

    @classmethod
    def base_of(cls, shapes: Mapping[str, Sequence[int]]) -> Self:
        """The published network that fits a checkpoint's tensors, with the levels that its map head has parameters for.

        Where these are absent or odd, the result is the usual network, and loading says what does not fit.
        """
        base = cls.base()
        offsets = shapes.get(MAP_OFFSETS, ())
        one_level = 2 * base.heads * base.bev_points
        return cls.base(1) if len(offsets) == 2 and offsets[0] == one_level else base
