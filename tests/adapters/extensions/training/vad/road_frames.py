"""Training frames of a straight road, with images of noise."""

import math
from dataclasses import replace

import torch

from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, TrainingFrame
from tests.adapters.networks.vad.small_vad import rig


def a_frame(number: int = 0, scene: str = "a", *, steps_per_s: float = 6.0, aside: float = 0.0) -> TrainingFrame:
    """A car drives north on a road 12 m wide, a car ahead of it and a pedestrian beside it; images of noise."""
    generator = torch.Generator().manual_seed(number + ord(scene[0]))
    can_bus = torch.zeros(18, dtype=torch.float64)
    can_bus[1] = 0.5 * steps_per_s * number
    can_bus[3:7] = math.cos(math.pi / 4)
    can_bus[13] = steps_per_s
    can_bus[16], can_bus[17] = math.pi / 2, 90.0
    times = 0.5 * torch.arange(1, 7)
    y = torch.linspace(-30, 30, 20)
    cells = (torch.arange(DRIVABLE_CELLS) + 0.5) * 0.8 - DRIVABLE_HALF_M
    boxes = torch.tensor(
        [[1.0 + aside, 12.0, -1.0, 4.5, 1.9, 1.6, math.pi / 2, 0.0, 4.0], [-5, 8, -0.9, 0.6, 0.6, 1.7, 0.3, 0, 0]]
    )
    futures = boxes[:, None, [0, 1, 6]].repeat(1, 12, 1)
    futures[0, :, 1] += 4.0 * 0.5 * torch.arange(1, 13)
    return TrainingFrame(
        scene=scene,
        index=number,
        timestamp_s=0.5 * number,
        images=torch.randint(0, 128 if scene == "a" else 256, (6, 3, 64, 96), generator=generator, dtype=torch.uint8),
        lidar2img=rig(),
        global_T_lidar=torch.eye(4, dtype=torch.float64),
        can_bus=can_bus,
        command=2,
        ego_future=torch.stack([aside * times, steps_per_s * times], -1),
        ego_future_valid=torch.ones(6, dtype=torch.bool),
        boxes=boxes,
        labels=torch.tensor([0, 8]),
        instances=torch.tensor([0, 1]),
        futures=futures,
        futures_valid=torch.ones((2, 12), dtype=torch.bool),
        lines=torch.stack([torch.stack([torch.full_like(y, x), y], -1) for x in (-6.0, 0.5, 6.0)]),
        line_labels=torch.tensor([2, 0, 2]),
        drivable=(cells.abs() < 6)[None].expand(DRIVABLE_CELLS, -1).clone(),
    )


def empty(frame: TrainingFrame) -> TrainingFrame:
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
    )


def moved(frame: TrainingFrame, seed: int) -> TrainingFrame:
    """The same with everything elsewhere."""
    by = 16.0 * torch.rand(2, generator=torch.Generator().manual_seed(seed)) - 8.0
    boxes = frame.boxes.clone()
    boxes[:, :2] += by
    return replace(frame, boxes=boxes, lines=frame.lines + by)


def clip(count: int = 3) -> list[TrainingFrame]:
    return [a_frame(number) for number in range(count)]
