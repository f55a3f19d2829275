"""Training frames of a straight road, with images of noise, and a store of one scene of them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, TrainingFrame
from tests.adapters.networks.vad.small_vad import rig

TIMES_S = 0.5 * torch.arange(1, 13)


def road_frame(
    boxes: Tensor, number: int, scene: str, *, speed: float, aside: float = 0.0, lines_to_m: float = 30.0
) -> TrainingFrame:
    """The ego drives along y on a road 12 m wide, a divider half a metre to its right; boxes keep their velocity."""
    generator = torch.Generator().manual_seed(100 * number + ord(scene[0]))
    can_bus = torch.zeros(18, dtype=torch.float64)
    can_bus[1], can_bus[3:7], can_bus[13] = 0.5 * speed * number, math.cos(math.pi / 4), speed
    can_bus[16], can_bus[17] = math.pi / 2, 90.0
    pose = torch.eye(4, dtype=torch.float64)
    pose[1, 3] = can_bus[1]
    places = boxes[:, None, :2] + boxes[:, None, 7:9] * TIMES_S[:, None]
    y = torch.linspace(-lines_to_m, lines_to_m, 20)
    cells = (torch.arange(DRIVABLE_CELLS) + 0.5) * 0.8 - DRIVABLE_HALF_M
    return TrainingFrame(
        scene=scene,
        index=number,
        timestamp_s=0.5 * number,
        images=torch.randint(0, 128 if scene == "a" else 256, (6, 3, 64, 96), generator=generator, dtype=torch.uint8),
        lidar2img=rig(),
        global_T_lidar=pose,
        can_bus=can_bus,
        command=2,
        ego_future=torch.stack([aside * TIMES_S[:6], speed * TIMES_S[:6]], -1),
        ego_future_valid=torch.ones(6, dtype=torch.bool),
        boxes=boxes,
        labels=torch.tensor([0, 8]),
        instances=torch.tensor([3, 7]),
        futures=torch.cat([places, boxes[:, None, 6:7].repeat(1, 12, 1)], -1),
        futures_valid=torch.ones((2, 12), dtype=torch.bool),
        lines=torch.stack([torch.stack([torch.full_like(y, x), y], -1) for x in (-6.0, 0.5, 6.0)]),
        line_labels=torch.tensor([2, 0, 2]),
        drivable=(cells.abs() < 6)[None].expand(DRIVABLE_CELLS, -1).clone(),
    )


def a_frame(number: int = 0, scene: str = "a", *, speed: float = 6.0, aside: float = 0.0) -> TrainingFrame:
    """A car drives 12 m ahead, a pedestrian stands beside the way."""
    boxes = torch.tensor(
        [[1.0 + aside, 12.0, -1.0, 4.5, 1.9, 1.6, math.pi / 2, 0.0, 4.0], [-5, 8, -0.9, 0.6, 0.6, 1.7, 0.3, 0, 0]]
    )
    return road_frame(boxes, number, scene, speed=speed, aside=aside)


def clip(count: int = 3) -> list[TrainingFrame]:
    return [a_frame(number) for number in range(count)]


def empty(frame: TrainingFrame) -> TrainingFrame:
    """The same frame with nothing to learn."""
    names = ("boxes", "labels", "instances", "futures", "futures_valid", "lines", "line_labels")
    nothing: dict[str, Any] = {name: getattr(frame, name)[:0] for name in names}
    nothing |= {name: torch.zeros_like(getattr(frame, name)) for name in ("ego_future_valid", "drivable")}
    return replace(frame, **nothing)


class OneScene:
    """`adapters.extensions.training.frames.Frames` of frames that are given in time order."""

    identity = "one scene"

    def __init__(self, frames: Sequence[TrainingFrame]) -> None:
        self._frames, self.scenes = list(frames), ("a",)

    def __len__(self) -> int:
        return len(self._frames)

    def frames_of(self, scene: str) -> range:
        return range(len(self._frames))

    def frame(self, number: int) -> TrainingFrame:
        return self._frames[number]

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        return self._frames[max(number - length + 1, 0) : number + 1]
