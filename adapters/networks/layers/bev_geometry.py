"""Where the cells of a bird's-eye view are in the world, in camera images, and in the view of half a second ago."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

NEAREST_DEPTH_M = 1e-5
"""Least depth of a visible point; closer to a camera's plane, or behind it, it is hidden."""


@dataclass(frozen=True, slots=True)
class BEVGrid:
    """A grid over the ground; rows along y, columns along x, cells numbered row by row from the least x and y.

    `range_m` are x, y, z of the least corner, then of the greatest.
    """

    rows: int
    columns: int
    range_m: tuple[float, float, float, float, float, float]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.columns

    @property
    def cells(self) -> int:
        """Number of cells."""
        return self.rows * self.columns

    def centres(self) -> Tensor:
        """(cells, 2) x, y of the cells' centres, 0 to 1 over the range."""
        x = (torch.arange(self.columns, dtype=torch.float32) + 0.5) / self.columns
        y = (torch.arange(self.rows, dtype=torch.float32) + 0.5) / self.rows
        shape = (self.rows, self.columns)
        return torch.stack([x[None].expand(shape), y[:, None].expand(shape)], -1).flatten(0, 1)

    def pillars(self, heights: int) -> Tensor:
        """Points above cell centres, (cells, heights, 3) metres, spread evenly half a metre inside the range's ends."""
        x_low, y_low, z_low, x_high, y_high, z_high = self.range_m
        depth = z_high - z_low
        z = torch.linspace(0.5, depth - 0.5, heights) / depth * depth + z_low
        x, y = self.centres().unbind(-1)
        ground = torch.stack([x * (x_high - x_low) + x_low, y * (y_high - y_low) + y_low], -1)
        return torch.cat([ground[:, None].expand(-1, heights, -1), z[None, :, None].expand(self.cells, -1, 1)], -1)


@dataclass(frozen=True, slots=True)
class VisibleCells:
    """Pairs, P of them, of cells and the cameras that see them, camera after camera.

    `camera` (P,) int32; `cell` (P,) int64; `image_points` (P, heights, 2) x, y of the cell's pillar, 0 to 1 over the
    image, also outside; `cell_order` (P,) int64, the pairs cell after cell and then by camera; `cell_starts` (cells,)
    int64, where each cell begins in `cell_order`; `cameras_per_cell` (cells, 1), at least 1.
    """

    camera: Tensor
    cell: Tensor
    image_points: Tensor
    cell_order: Tensor
    cell_starts: Tensor
    cameras_per_cell: Tensor


def find_visible_cells(pillars: Tensor, projections: Tensor, height: int, width: int) -> VisibleCells:
    """Pairs of a camera and a cell of whose pillar a point lies in the image and in front of the camera.

    With the cameras of nuScenes 18 % of all pairs exist: sampling for these alone costs one wait for the device a
    frame, masking all pairs no wait and 5.5 times the work. `pillars` are (cells, heights, 3) metres, `projections`
    (cameras, 4, 4) to pixels.
    """
    # Written out, because matrix products may run in reduced precision: a pixel off is a cell lost.
    x, y, z = pillars.unbind(-1)
    rows = projections.to(pillars.dtype)[:, :3, :, None, None].unbind(1)
    u, v, depth = (row[:, 0] * x + row[:, 1] * y + row[:, 2] * z + row[:, 3] for row in rows)
    visible_depth = depth.clamp(min=NEAREST_DEPTH_M)
    u, v = u / visible_depth / width, v / visible_depth / height
    visible = (depth > NEAREST_DEPTH_M) & (u > 0) & (u < 1) & (v > 0) & (v < 1)
    hits = visible.any(-1)
    camera, cell = hits.nonzero().unbind(-1)
    points = torch.stack([u, v], -1)[camera, cell]
    count = hits.sum(0)
    order, starts = cell.argsort(stable=True), count.cumsum(0) - count
    return VisibleCells(camera.to(torch.int32), cell, points, order, starts, count.clamp(min=1)[:, None])


def previous_cell_matrix(grid: BEVGrid, angle_deg: float, centre: tuple[float, float]) -> Tensor:
    """Matrix, (2, 3) on (column, row, 1) in cells from the middle, from the turned view to the previous one.

    It is on the processor. The previous view is turned by `angle_deg`, counter-clockwise in an image whose rows go
    down, around `centre`: column and row, in cells.
    """
    cosine, sine = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    x, y = centre[0] - 0.5 * grid.columns, centre[1] - 0.5 * grid.rows
    return torch.tensor(
        [[cosine, -sine, x - cosine * x + sine * y], [sine, cosine, y - sine * x - cosine * y]],
        dtype=torch.float32,
        device="cpu",
    )


def rotate_view(view: Tensor, grid: BEVGrid, matrix: Tensor) -> Tensor:
    """A bird's-eye view, (cells, C), turned by `previous_cell_matrix` to the nearest cells; zero outside."""
    rows, columns = grid.shape
    device, exact = view.device, torch.float64
    across = torch.linspace(0.5 - 0.5 * columns, 0.5 * columns - 0.5, columns, device=device)[None].to(exact)
    along = torch.linspace(0.5 - 0.5 * rows, 0.5 * rows - 0.5, rows, device=device)[:, None].to(exact)
    scaled = matrix / torch.stack([matrix.new_full((3,), 0.5 * columns), matrix.new_full((3,), 0.5 * rows)])
    # Places halfway between two cells decide by their last bit. Sums in double precision of factors in single precision
    # are what fused multiply-adds give, on any processor; golden frames have such places.
    x, y = ((across * row[0] + along * row[1] + row[2]).float() for row in scaled.to(exact).unbind(0))
    # Numbers of cells go through the sampler instead of features: one channel, exact in any precision of the features.
    numbers = torch.arange(1, grid.cells + 1, device=device, dtype=torch.float32).view(1, 1, rows, columns)
    places = torch.stack([x, y], -1)[None]
    nearest = F.grid_sample(numbers, places, mode="nearest", padding_mode="zeros", align_corners=False)
    cells = nearest.flatten().long()
    return view[(cells - 1).clamp(min=0)] * (cells > 0)[:, None].to(view.dtype)
