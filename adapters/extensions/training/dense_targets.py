"""Dense targets that start a bird's-eye view faster than decoders do: channel c is the logit of target c."""

from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import DRIVABLE_HALF_M, TrainingFrame
from adapters.networks.layers.bev_geometry import BEVGrid
from adapters.networks.vad.selection import MAP_CLASSES
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
DIVIDER, _, BOUNDARY = range(len(MAP_CLASSES))
OFFSET_KINDS: Final = (DIVIDER, BOUNDARY)
"""Map elements along which one drives: dividers and boundaries of the road."""
LANE_AHEAD_M: Final = (4.0, 10.0, 18.0)
LANE_WITHIN_M: Final = 5.0
"""Where ahead of the lidar lines are asked for, and how near they have to be."""
LANE_NUMBERS: Final = 2 * len(LANE_AHEAD_M)
OFFSETS: Final = 2 * len(OFFSET_KINDS)
"""Channels that say where in a cell, or how far from it, the nearest of each kind is: x and y."""
OFFSET_UNIT_M: Final = 1.25
OFFSET_WITHIN_M: Final = 3.5
"""Metres of a channel's 1, and how near a line has to be to be asked for."""


def dense_targets(frame: TrainingFrame, grid: BEVGrid) -> tuple[Tensor, Tensor]:
    """Targets of all cells: (cells, `CHANNELS`) 0 or 1, and (cells, `CHANNELS`) whether the target is known."""
    low, high = torch.tensor(grid.range_m[:2]), torch.tensor(grid.range_m[3:5])
    centres = low + grid.centres() * (high - low)
    half_cell_m = (high - low) / torch.tensor([grid.columns, grid.rows]) / 2
    drivable = F.grid_sample(
        frame.drivable.float()[None, None], (centres / DRIVABLE_HALF_M)[None, None], align_corners=False
    ).view(-1)
    near_lines = [_near_lines(centres, frame.lines[frame.line_labels == kind], half_cell_m) for kind in range(3)]
    vehicle = torch.isin(frame.labels, torch.tensor(VEHICLES))
    inside = [_in_boxes(centres, frame.boxes[chosen], half_cell_m) for chosen in (vehicle, ~vehicle)]
    targets = torch.stack([drivable > 0.5, *near_lines, *inside], -1).float()
    known = torch.ones_like(targets, dtype=torch.bool)
    known[:, 1 : 1 + len(MAP_CLASSES)] = (centres.abs() < torch.tensor(LINES_WITHIN_M)).all(-1, keepdim=True)
    return targets, known


def dense_loss(bev: Tensor, frame: TrainingFrame, grid: BEVGrid, weight: float) -> Tensor:
    """Cross entropy of the first channels of a bird's-eye view; the mean over what is known."""
    targets, known = dense_targets(frame, grid)
    entropy = F.binary_cross_entropy_with_logits(DENSE_GAIN * bev[:, :CHANNELS], targets, reduction="none")
    # Cells of lines and agents are few.
    weights = known * (1 + 2 * targets)
    return weight * (entropy * weights).sum() / weights.sum()


def offset_loss(found: Tensor, frame: TrainingFrame, grid: BEVGrid) -> Tensor:
    """L1 of sub-cell line offsets (`OFFSET_UNIT_M`) per known number; `found` are (cells, `OFFSETS`) of the view."""
    low, high = torch.tensor(grid.range_m[:2]), torch.tensor(grid.range_m[3:5])
    centres = low + grid.centres() * (high - low)
    inside = (centres.abs() < torch.tensor(LINES_WITHIN_M)).all(-1)
    losses, count = [found.sum() * 0], 0
    for place, kind in enumerate(OFFSET_KINDS):
        lines = frame.lines[frame.line_labels == kind]
        if not len(lines):
            continue
        offsets = offsets_to_lines(centres[inside], lines)
        near = offsets.norm(dim=-1) < OFFSET_WITHIN_M
        error = found[inside, 2 * place : 2 * place + 2] - offsets / OFFSET_UNIT_M
        losses.append(error[near].abs().sum())
        count += 2 * int(near.sum())
    return torch.stack(losses).sum() / max(count, 1)


def lane_offsets(frame: TrainingFrame) -> tuple[Tensor, Tensor]:
    """(`LANE_NUMBERS`,) metres rightward to lines at places ahead, left (negative) ones first, and if one is near."""
    driven_along = torch.isin(frame.line_labels, torch.tensor(OFFSET_KINDS))
    lines = frame.lines[driven_along]
    starts, ends = lines[:, :-1].flatten(0, 1), lines[:, 1:].flatten(0, 1)
    ahead = torch.tensor(LANE_AHEAD_M)[:, None]
    rise = ends[:, 1] - starts[:, 1]
    share = (ahead - starts[:, 1]) / torch.where(rise == 0, 1.0, rise)
    crossed = (share >= 0) & (share <= 1) & (rise != 0)
    aside = starts[:, 0] + share * (ends[:, 0] - starts[:, 0])
    far = torch.full((len(LANE_AHEAD_M), 1), 2 * LANE_WITHIN_M)
    left = torch.cat([torch.where(crossed & (aside < 0), aside, -far), -far], 1).amax(1)
    right = torch.cat([torch.where(crossed & (aside >= 0), aside, far), far], 1).amin(1)
    offsets = torch.cat([left, right])
    return offsets, offsets.abs() < LANE_WITHIN_M


def lane_loss(found: Tensor, frame: TrainingFrame) -> Tensor:
    """L1 of the offsets of lines ahead, (`LANE_NUMBERS`,) as `lane_offsets`, metres, per known number."""
    wanted, known = lane_offsets(frame)
    return (found - wanted)[known].abs().sum() / max(int(known.sum()), 1)


def offsets_to_lines(points: Tensor, lines: Tensor) -> Tensor:
    """Offsets, (N, 2) metres, from each of (N, 2) points to the nearest one of any of (M, P, 2) lines, at least one."""
    offsets, _ = offsets_to_pieces(points, lines)
    nearest = offsets.square().sum(-1).argmin(1)
    return offsets[torch.arange(len(points)), nearest]


def offsets_to_pieces(points: Tensor, lines: Tensor) -> tuple[Tensor, Tensor]:
    """Offsets (N, M (P - 1), 2) from (N, 2) points to each piece of (M, P, 2) lines, metres, and these pieces."""
    starts, ends = lines[:, :-1].flatten(0, 1), lines[:, 1:].flatten(0, 1)
    along = ends - starts
    to_points = points[:, None] - starts
    shares = (to_points * along).sum(-1) / along.square().sum(-1).clamp(min=1e-9)
    return shares.clamp(0, 1)[..., None] * along - to_points, along


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
