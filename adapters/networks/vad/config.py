"""Sizes of a VAD network: the two published ones, and any other for tests and miniatures."""

from dataclasses import dataclass
from typing import Self

from adapters.camera_inputs import NetworkImageFormat
from adapters.networks.layers.bev_network import BEVConfig
from adapters.networks.layers.reporting import ReportingRules


@dataclass(frozen=True, slots=True, kw_only=True)
class VADConfig(BEVConfig):
    """Sizes of VAD, beside those of all networks with a bird's-eye view.

    Attributes:
        steps: Planned and forecast steps of 0.5 s.
        backbone_outputs: Stages (0 to 3) that feed the feature pyramid.
        lane_distance: Largest distance, as a share of the perception range, at which a map element is seen by an agent.
        lane_score: Least score of a map element that an agent sees.
        image_scale: Scale of input images against 1600 x 900; `image_size`, width and height, overrides it.
        plan_sees_front: Numbers that the plan takes from a fine feature map of the front camera beside agents and map
            elements; the published networks have none.
        plan_compares_front: Whether it takes as well how these numbers have changed since the key frames before.
        front_eyes: Whether it looks at the front camera through an image network of its own, of the width of the other.
        plan_knows_motion: Whether the plan is told speed, acceleration and yaw rate.
    """

    backbone_outputs: tuple[int, ...]
    image_scale: float
    perception_range_m: tuple[float, float, float, float, float, float] = (-15.0, -30.0, -2.0, 15.0, 30.0, 2.0)
    agents: int = 300
    map_instances: int = 100
    points_per_line: int = 20
    steps: int = 6
    backbone_blocks: tuple[int, ...] = (3, 4, 6, 3)
    lane_distance: float = 0.2
    lane_score: float = 0.5
    max_boxes: int = 100
    max_lines: int = 50
    image_size: tuple[int, int] | None = None
    plan_sees_front: int = 0
    plan_compares_front: bool = False
    front_eyes: bool = False
    plan_knows_motion: bool = False

    @property
    def image_format(self) -> NetworkImageFormat:
        """Format of the images that the network reads."""
        return (
            NetworkImageFormat.scaled(self.image_scale)
            if self.image_size is None
            else NetworkImageFormat(*self.image_size)
        )

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
            backbone_outputs=(1, 2),
            pyramid_levels=2,
            image_scale=0.14,
            image_size=(224, 128),
            plan_sees_front=64,
            plan_compares_front=True,
            front_eyes=True,
            plan_knows_motion=True,
            channels=64,
            feedforward_channels=128,
            heads=2,
            agents=50,
            map_instances=20,
            points_per_line=10,
            backbone_blocks=(1, 1, 1),
            backbone_width=16,
            height_points=2,
            image_points=4,
            bev_points=2,
            rotation_centre=(12.0, 16.0),
            max_boxes=50,
            max_lines=20,
            reporting=ReportingRules(steered_from_m=6.0),
        )
