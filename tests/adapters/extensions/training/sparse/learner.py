"""A sparse network that is small enough to learn a made-up road in seconds, and frames for it."""

from dataclasses import replace

import torch
from torch import nn

from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.sparse.start import initialise
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseNetwork
from tests.adapters.extensions.training.road_frames import TIMES_S, a_frame
from tests.adapters.networks.sparse.miniature import MINIATURE, projections

TINY = replace(
    MINIATURE, interaction_blocks=1, channels=16, heads=2, anchors=12, remembered_anchors=6, stages=2, queue_frames=2
)
SPEED = 2.0


def frame(index: int, scene: str = "scene", *, boxes: int = 3, lines: int = 2, turn: float = 0.0) -> TrainingFrame:
    """An ego that drives north at 2 m/s, and what drives beside it, faster than it."""
    generator = torch.Generator().manual_seed(7 * index + len(scene))
    places = torch.tensor([[4.0, 9.0], [-5.0, 14.0], [0.0, -12.0]])[:boxes]
    numbers = torch.tensor([-1.0, 4.5, 1.9, 1.6, 1.2, 1.0, -2.0]).repeat(boxes, 1)
    futures = torch.cat(
        [places[:, None] + TIMES_S[:, None] * torch.tensor([1.0, -2.0]), torch.full((boxes, 12, 1), 1.2)], -1
    )
    size = (6, 3, TINY.image_height_px, TINY.image_width_px)
    return replace(
        a_frame(index, scene, speed=SPEED),
        timestamp_s=100.0 + 0.5 * index,
        images=torch.randint(0, 256, size, generator=generator, dtype=torch.uint8),
        lidar2img=torch.from_numpy(projections()).double(),
        can_bus=torch.zeros(18, dtype=torch.float64).index_fill(0, torch.tensor([13]), SPEED),
        ego_future=torch.stack([turn * TIMES_S[:6] ** 2, SPEED * TIMES_S[:6]], 1),
        boxes=torch.cat([places, numbers], 1),
        labels=torch.arange(boxes) % 2,
        instances=torch.arange(boxes),
        futures=futures,
        futures_valid=torch.ones(boxes, 12, dtype=torch.bool),
        lines=torch.stack([torch.full((20,), 2.0), torch.linspace(-10, 10, 20)], -1).expand(lines, -1, -1).clone(),
        line_labels=torch.arange(lines) % 3,
    )


def network(name: str, config: SparseConfig = TINY) -> SparseNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(3)
        made = DiffusionDrive(config) if name == "diffusiondrive" else SparseDrive(config)
        for layer in made.modules():
            if isinstance(layer, nn.Conv2d):
                nn.init.kaiming_normal_(layer.weight)
        initialise(made)
    decoder, lines = made.head.det_head, made.head.map_head
    with torch.no_grad():
        decoder.instance_bank.anchor[:, :2] *= 12
        decoder.instance_bank.anchor[:, 2:] *= 0.3
        lines.instance_bank.anchor.mul_(10)
        speeds, steps = torch.linspace(0, 4, 6)[:, None], torch.arange(1, 7) * 0.5
        anchors = made.head.motion_plan_head.plan_anchor
        anchors.copy_(torch.stack([torch.zeros(6, 6), speeds * steps], -1).expand(3, -1, -1, -1))
        anchors[0, ..., 0] = 0.2 * steps**2
        anchors[1, ..., 0] = -0.2 * steps**2
    return made
