"""Training frames of a made-up road, and a network that is small enough to learn them in seconds."""

import math
from dataclasses import replace

import torch

from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, TrainingFrame
from adapters.networks.uniad.config import UniADConfig
from tests.adapters.networks.vad.small_vad import rig

LEARNER = replace(
    UniADConfig.miniature(),
    bev_rows=16,
    bev_columns=16,
    perception_range_m=(-16.0, -16.0, -2.6, 16.0, 16.0, 0.6),
    channels=32,
    heads=2,
    queries=12,
    map_queries=6,
    decoder_layers=1,
    motion_layers=1,
    plan_layers=1,
    backbone_width=4,
    max_boxes=6,
    occupancy_half_m=8.0,
    rotation_centre=(8.0, 8.0),
)


def a_frame(number: int = 0, scene: str = "a") -> TrainingFrame:
    """The ego drives along y at 4 m/s (6 m/s in other scenes) behind a car; a pedestrian crosses; images of noise."""
    generator = torch.Generator().manual_seed(100 * number + ord(scene[0]))
    speed = 4.0 if scene == "a" else 6.0
    can_bus = torch.zeros(18, dtype=torch.float64)
    can_bus[1], can_bus[13] = 0.5 * speed * number, speed
    can_bus[16], can_bus[17] = math.pi / 2, 90.0
    pose = torch.eye(4, dtype=torch.float64)
    pose[1, 3] = 0.5 * speed * number
    ahead_m, aside_m = 10.0 + 0.5 * (5 - speed) * number, -4.0 + 0.5 * number
    boxes = torch.tensor(
        [
            [0.5, ahead_m, -1.0, 4.5, 1.9, 1.6, math.pi / 2, 0.0, 5.0],
            [aside_m, 8.0 - 0.5 * speed * number, -0.9, 0.6, 0.6, 1.7, 0.0, 1.0, 0.0],
        ]
    )
    times = 0.5 * torch.arange(1, 13)
    futures = torch.cat(
        [boxes[:, None, :2] + boxes[:, None, 7:9] * times[:, None], boxes[:, None, 6:7].repeat(1, 12, 1)], -1
    )
    y = torch.linspace(-15, 15, 20)
    cells = (torch.arange(DRIVABLE_CELLS) + 0.5) * 0.8 - DRIVABLE_HALF_M
    return TrainingFrame(
        scene=scene,
        index=number,
        timestamp_s=0.5 * number,
        images=torch.randint(0, 128 if scene == "a" else 256, (6, 3, 64, 96), generator=generator, dtype=torch.uint8),
        lidar2img=rig().double(),
        global_T_lidar=pose,
        can_bus=can_bus,
        command=2,
        ego_future=torch.stack([torch.zeros(6), speed * times[:6]], -1),
        ego_future_valid=torch.ones(6, dtype=torch.bool),
        boxes=boxes,
        labels=torch.tensor([0, 8]),
        instances=torch.tensor([3, 7]),
        futures=futures,
        futures_valid=torch.ones((2, 12), dtype=torch.bool),
        lines=torch.stack([torch.stack([torch.full_like(y, x), y], -1) for x in (-6.0, 0.5, 6.0)]),
        line_labels=torch.tensor([2, 0, 2]),
        drivable=(cells.abs() < 6)[None].expand(DRIVABLE_CELLS, -1).clone(),
    )


def without_annotations(frame: TrainingFrame) -> TrainingFrame:
    """The same frame with nothing to learn."""
    return replace(
        frame,
        boxes=frame.boxes[:0],
        labels=frame.labels[:0],
        instances=frame.instances[:0],
        futures=frame.futures[:0],
        futures_valid=frame.futures_valid[:0],
        lines=frame.lines[:0],
        line_labels=frame.line_labels[:0],
        ego_future_valid=torch.zeros(6, dtype=torch.bool),
        drivable=torch.zeros_like(frame.drivable),
    )


def many_frames() -> list[TrainingFrame]:
    """Frames enough for anchors: everything is somewhere else, and drives at another speed, in each of them."""
    generator = torch.Generator().manual_seed(5)
    found = []
    for number in range(20):
        frame = a_frame()
        moved = torch.rand(2, generator=generator) * 20 - 10
        boxes, futures = frame.boxes.clone(), frame.futures.clone()
        boxes[:, :2] += moved
        futures[..., :2] += moved + torch.rand(12, 2, generator=generator).cumsum(0)
        found.append(replace(frame, boxes=boxes, futures=futures, index=number))
    return found
