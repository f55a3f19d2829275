"""Sizes of the sparse networks: the published ones, and any other for tests and miniatures."""

from dataclasses import dataclass, replace
from typing import Literal, Self

from adapters.camera_inputs import NUSCENES_IMAGE, NetworkImageFormat
from adapters.networks.layers.reporting import PUBLISHED, ReportingRules

STRIDE = 32
"""Pixels of a cell of the coarsest feature map."""
STAGES = 4
"""Of the image network; the last has the coarsest features."""


def image_length_fits(pixels: int) -> bool:
    """Whether images can have this height or width: whole cells, which the planner reduces to one for the ego."""
    cells = pixels // STRIDE
    return pixels % STRIDE == 0 and cells >= 2 and (cells + 1) // 2 < 2 * (cells // 2)


@dataclass(frozen=True, slots=True)
class SparseConfig:
    """Sizes that fix names and shapes of a network's parameters, and how it remembers; both planners have the same.

    Attributes:
        image_height_px: Of the input images, like the width one of `image_length_fits`.
        backbone_blocks: Residual blocks in the four stages of the image network; (3, 4, 6, 3) is ResNet-50.
        backbone_width: Channels after its first convolution; 64 in ResNet-50.
        finest_stage: Of the image network, the first that is read; 0 has a cell for 4 x 4 pixels, 1 for 8 x 8.
        cameras: In the order of the specification, the front one first.
        channels: Width of all tokens; a multiple of `heads` and of 8.
        heads: Attention heads, and groups of channels that are sampled from images together.
        hidden_channels: Hidden width of the feed-forward blocks of the decoders of boxes and lines.
        stages: Of the decoders; the first sees the present frame alone.
        anchors: Box queries, of which the next frame gets `remembered_anchors`.
        lines: Map queries, of which the next frame gets `remembered_lines`.
        learned_points: Points of a box at which images are sampled, besides its centre and six near its faces.
        samples_per_height: Points at each height of a map point at which images are sampled.
        queue_frames: Frames that the planner looks back on, the present one included.
        interaction_blocks: Blocks in which agents, the ego and the map look at each other.
        watched_agents: The most certain agents, that all others look at.
        watched_lines: The most certain map elements, that agents look at.
        modes: Forecasts per agent, and plans per driving command.
        steps: Planned steps of 0.5 s.
        agent_steps: Forecast steps of 0.5 s, at least `steps`.
        speed_from_poses: Whether the planner reads how fast the ego drives from where it was in the frame before; the
            published ones take their own prediction of then, and need a long training to know it.
        plan_sees_front: Numbers that the plan takes from the finest feature map of the front camera beside what the ego
            takes from its coarsest one; the published networks have none.
        plan_compares_front: Whether it takes as well how these numbers have changed since the key frames before.
        front_eyes: Whether it looks at the front camera through an image network of its own, of the width of the other.
        memory_crosses_scenes: Whether what is remembered outlives a change of scene, as it does in the published
            models: there time alone decides how much of it is used, and a stale memory is still attended to once.
    """

    image_height_px: int = 256
    image_width_px: int = 704
    image_resize: Literal["linear", "bicubic"] = "bicubic"
    backbone_blocks: tuple[int, int, int, int] = (3, 4, 6, 3)
    backbone_width: int = 64
    finest_stage: int = 0
    cameras: int = 6
    channels: int = 256
    heads: int = 8
    hidden_channels: int = 1024
    planner_hidden_channels: int = 512
    stages: int = 6
    anchors: int = 900
    remembered_anchors: int = 600
    lines: int = 100
    remembered_lines: int = 33
    points_per_line: int = 20
    agent_classes: int = 10
    map_classes: int = 3
    learned_points: int = 6
    samples_per_height: int = 3
    queue_frames: int = 4
    interaction_blocks: int = 3
    watched_agents: int = 50
    watched_lines: int = 10
    modes: int = 6
    steps: int = 6
    agent_steps: int = 12
    commands: int = 3
    reported_boxes: int = 300
    reported_lines: int = 100
    speed_from_poses: bool = False
    plan_sees_front: int = 0
    plan_compares_front: bool = False
    front_eyes: bool = False
    memory_crosses_scenes: bool = True
    reporting: ReportingRules = PUBLISHED

    def __post_init__(self) -> None:
        if not (image_length_fits(self.image_height_px) and image_length_fits(self.image_width_px)):
            raise ValueError(f"the networks have no images of {self.image_width_px} x {self.image_height_px} pixels")

    @property
    def levels(self) -> int:
        """Feature maps that are read."""
        return STAGES - self.finest_stage

    @property
    def image_format(self) -> NetworkImageFormat:
        """Input format: 1600 x 900 scaled and cut off at the top; the miniatures see the whole images, resized."""
        if self.image_resize == "linear":
            return NetworkImageFormat(self.image_width_px, self.image_height_px)
        width, height = NUSCENES_IMAGE
        rows = height * self.image_width_px // width
        return NetworkImageFormat(
            self.image_width_px, rows, crop_top=max(rows - self.image_height_px, 0), resize="bicubic"
        )

    @classmethod
    def sparsedrive(cls) -> Self:
        """SparseDrive-S as it is evaluated: ResNet-50, images of 704 x 256; a change of scene makes it forget."""
        return cls(memory_crosses_scenes=False)

    @classmethod
    def sparsedrive_base(cls) -> Self:
        """SparseDrive-B: ResNet-101, images of 1408 x 512; its weights were never published."""
        return replace(cls(), image_height_px=512, image_width_px=1408, backbone_blocks=(3, 4, 23, 3))

    @classmethod
    def diffusiondrive(cls) -> Self:
        """DiffusionDrive for nuScenes, which keeps the sizes of SparseDrive-S."""
        return cls.sparsedrive()

    @classmethod
    def miniature(cls) -> Self:
        """SparseDrive-mini and DiffusionDrive-mini, which learn the mini town on a processor core in an hour.

        Their plans have their own eyes, compare what they see, and lead straight ahead if they are short.
        """
        return cls(
            image_height_px=128,
            image_width_px=224,
            image_resize="linear",
            backbone_blocks=(1, 1, 1, 1),
            backbone_width=16,
            finest_stage=1,
            channels=64,
            heads=2,
            hidden_channels=128,
            planner_hidden_channels=128,
            stages=3,
            anchors=72,
            remembered_anchors=36,
            lines=16,
            remembered_lines=8,
            points_per_line=10,
            learned_points=1,
            samples_per_height=1,
            queue_frames=3,
            interaction_blocks=2,
            watched_agents=16,
            watched_lines=8,
            reported_boxes=60,
            reported_lines=16,
            speed_from_poses=True,
            plan_sees_front=64,
            plan_compares_front=True,
            front_eyes=True,
            memory_crosses_scenes=False,
            # On scenes of a held-out town, seven of ten vehicles are found at this score.
            reporting=ReportingRules(least_score=0.18, apart=0.5, steered_from_m=6.0),
        )
