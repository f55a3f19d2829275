"""A UniAD network that is small enough to learn a made-up road in seconds, and frames for it."""

import math
from dataclasses import replace

import torch

from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.uniad.phases import build_untrained
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from tests.adapters.extensions.training.road_frames import road_frame

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
    """The ego drives at 4 m/s (6 m/s in other scenes) behind a car; a pedestrian crosses."""
    speed = 4.0 if scene == "a" else 6.0
    ahead_m, aside_m = 10.0 + 0.5 * (5 - speed) * number, -4.0 + 0.5 * number
    boxes = torch.tensor(
        [
            [0.5, ahead_m, -1.0, 4.5, 1.9, 1.6, math.pi / 2, 0.0, 5.0],
            [aside_m, 8.0 - 0.5 * speed * number, -0.9, 0.6, 0.6, 1.7, 0.0, 1.0, 0.0],
        ]
    )
    return road_frame(boxes, number, scene, speed=speed, lines_to_m=15.0)


def clip(count: int = 2, scene: str = "a") -> list[TrainingFrame]:
    return [a_frame(number, scene) for number in range(count)]


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


def learner(seed: int = 0) -> UniAD:
    return build_untrained(LEARNER, many_frames(), seed)
