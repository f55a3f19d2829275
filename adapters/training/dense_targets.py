"""What the first channels of a bird's-eye view say of the ground in training: a target for every cell.

A view that has learned where road, lines and agents are is a far quicker start for the decoders than one that only they
teach. No parameters are added: channel number c of the view is the logit of target number c.
"""

from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.vad.selection import MAP_CLASSES
from adapters.training.frames import DRIVABLE_HALF_M, TrainingFrame
from benchmark.constants import DETECTION_CLASSES

VEHICLES: Final = tuple(
    DETECTION_CLASSES.index(name) for name in ("car", "truck", "construction_vehicle", "bus", "trailer")
)
CHANNELS: Final = 1 + len(MAP_CLASSES) + 2
"""Drivable; each kind of map element; vehicles; other agents."""
DENSE_GAIN: Final = 4.0
"""From a normalised channel of the view to a logit."""
LINES_WITHIN_M: Final = (15.0, 30.0)
"""x and y up to which map elements are annotated."""


def dense_targets(frame: TrainingFrame, grid: BEVGrid) -> tuple[Tensor, Tensor]:
    """Targets of all cells.

    Args:
        frame: The key frame.
        grid: Of the view.

    Returns:
        (cells, `CHANNELS`) 0 or 1, and (cells, `CHANNELS`) whether the target is known.
    """
    low, high = torch.tensor(grid.range_m[:2]), torch.tensor(grid.range_m[3:5])
    centres = low + grid.centres() * (high - low)
    half_cell_m = (high - low) / torch.tensor([grid.columns, grid.rows]) / 2
    drivable = F.grid_sample(
        frame.drivable.float()[None, None], (centres / DRIVABLE_HALF_M)[None, None], align_corners=False
    ).view(-1)
    near = [_near_lines(centres, frame.lines[frame.line_labels == kind], half_cell_m) for kind in range(3)]
    vehicle = torch.isin(frame.labels, torch.tensor(VEHICLES))
    inside = [_in_boxes(centres, frame.boxes[chosen], half_cell_m) for chosen in (vehicle, ~vehicle)]
    targets = torch.stack([drivable > 0.5, *near, *inside], -1).float()
    known = torch.ones_like(targets, dtype=torch.bool)
    known[:, 1 : 1 + len(MAP_CLASSES)] = (centres.abs() < torch.tensor(LINES_WITHIN_M)).all(-1, keepdim=True)
    return targets, known


def dense_loss(bev: Tensor, frame: TrainingFrame, grid: BEVGrid, weight: float) -> Tensor:
    """Cross entropy of the first channels of a bird's-eye view; the mean over what is known.

    Args:
        bev: (cells, C).
        frame: What is annotated.
        grid: Of the view.
        weight: What the loss counts.

    Returns:
        A scalar.
    """
    targets, known = dense_targets(frame, grid)
    entropy = F.binary_cross_entropy_with_logits(DENSE_GAIN * bev[:, :CHANNELS], targets, reduction="none")
    # Cells of lines and agents are few.
    weights = known * (1 + 2 * targets)
    return weight * (entropy * weights).sum() / weights.sum()


def _near_lines(centres: Tensor, lines: Tensor, half_cell_m: Tensor) -> Tensor:
    """(cells,) whether a piece of a line passes through the cell or touches it."""
    if not len(lines):
        return torch.zeros(len(centres), dtype=torch.bool)
    middles = (lines[:, 1:] + lines[:, :-1]) / 2
    points = torch.cat([lines, middles], 1).flatten(0, 1)
    return ((centres[:, None] - points).abs() <= half_cell_m).all(-1).any(-1)


def _in_boxes(centres: Tensor, boxes: Tensor, half_cell_m: Tensor) -> Tensor:
    """(cells,) whether the centre is in a box that is half a cell larger on all sides."""
    x, y, _, length, width, _, yaw = boxes[:, :7].unbind(-1)
    offset_x, offset_y = centres[:, :1] - x, centres[:, 1:] - y
    ahead = (offset_x * yaw.cos() + offset_y * yaw.sin()).abs()
    aside = (offset_y * yaw.cos() - offset_x * yaw.sin()).abs()
    margin_m = float(half_cell_m.max())
    return ((ahead <= length / 2 + margin_m) & (aside <= width / 2 + margin_m)).any(-1)
