"""Annotations of several key frames, in the encoding of the sparse networks."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import torch
from torch import Tensor

from adapters.extensions.training.frames import LINE_POINTS, TrainingFrame
from adapters.extensions.training.plan_room import NearbyBodies
from adapters.networks.sparse.boxes import BOX_CODE
from adapters.networks.sparse.queue import STATUS

LINE_CLASS_OF_LABEL: Final = (1, 0, 2)
"""Place in `adapters.networks.sparse.selection.MAP_CLASSES` for each line label of training frames."""
FARTHEST_M: Final = 40.0
"""Boxes that are farther away are not looked for: at the size of the images they are a few pixels."""
MOTION_IN_CAN_BUS: Final = slice(7, 16)
"""Acceleration, rotation rate and velocity; the steering angle is not recorded."""


@dataclass(frozen=True, slots=True)
class Targets:
    """Annotations of F key frames, those of a frame behind those of the frame before; lidar frame, metres.

    `boxes` are (G, 11) undecoded, `futures` (G, T, 2) positions at steps of 0.5 s, from where the box is; `lines` are
    (M, P, 2), `plans` (F, S, 2) recorded positions of the ego, `status` is (F, 10) with a steering angle of 0, `around`
    all that is annotated, at the S steps of a plan.
    """

    boxes: Tensor
    box_labels: Tensor
    box_counts: tuple[int, ...]
    futures: Tensor
    futures_valid: Tensor
    lines: Tensor
    line_labels: Tensor
    line_counts: tuple[int, ...]
    plans: Tensor
    plans_valid: Tensor
    commands: Tensor
    status: Tensor
    around: NearbyBodies

    @classmethod
    def of(cls, frames: Sequence[TrainingFrame], points_per_line: int, device: torch.device) -> Self:
        """Annotations of key frames in the order of the predictions."""
        masks = [frame.boxes[:, :2].norm(dim=-1) <= FARTHEST_M for frame in frames]
        boxes = torch.cat([frame.boxes[mask] for frame, mask in zip(frames, masks, strict=True)])
        futures = torch.cat([frame.futures[mask] for frame, mask in zip(frames, masks, strict=True)])
        classes = torch.tensor(LINE_CLASS_OF_LABEL)
        status = torch.zeros(len(frames), STATUS)
        status[:, :9] = torch.stack([frame.can_bus[MOTION_IN_CAN_BUS] for frame in frames]).float()
        return cls(
            boxes=box_numbers(boxes).to(device),
            box_labels=torch.cat([frame.labels[mask] for frame, mask in zip(frames, masks, strict=True)]).to(device),
            box_counts=tuple(int(mask.sum()) for mask in masks),
            futures=(futures[..., :2] - boxes[:, None, :2]).to(device),
            futures_valid=torch.cat([frame.futures_valid[mask] for frame, mask in zip(frames, masks, strict=True)]).to(
                device
            ),
            lines=reduce_points(torch.cat([frame.lines for frame in frames]), points_per_line).to(device),
            line_labels=classes[torch.cat([frame.line_labels for frame in frames])].to(device),
            line_counts=tuple(len(frame.lines) for frame in frames),
            plans=torch.stack([frame.ego_future for frame in frames]).to(device),
            plans_valid=torch.stack([frame.ego_future_valid for frame in frames]).to(device),
            commands=torch.tensor([frame.command for frame in frames], device=device),
            status=status.to(device),
            around=NearbyBodies.of(frames, frames[0].ego_future.shape[0]).on(device),
        )


def box_numbers(boxes: Tensor) -> Tensor:
    """(N, 9) boxes of training frames to (N, 11) undecoded ones; see `adapters.networks.sparse.boxes`."""
    numbers = boxes.new_zeros(len(boxes), BOX_CODE)
    numbers[:, :3] = boxes[:, :3]
    numbers[:, 3:6] = boxes[:, 3:6].clamp(min=0.05).log()
    numbers[:, 6], numbers[:, 7] = boxes[:, 6].sin(), boxes[:, 6].cos()
    numbers[:, 8:10] = boxes[:, 7:9]
    return numbers


def reduce_points(lines: Tensor, points: int) -> Tensor:
    """(M, 20, 2) evenly spaced points to (M, points, 2)."""
    places = torch.linspace(0, LINE_POINTS - 1, points)
    lower = places.floor().long().clamp(max=LINE_POINTS - 2)
    share = (places - lower)[:, None]
    return lines[:, lower] * (1 - share) + lines[:, lower + 1] * share
