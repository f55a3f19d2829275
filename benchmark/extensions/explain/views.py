"""Top view of a protocol's comparison at one step: cells, boxes and paths on matplotlib axes."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from benchmark.geometry import Bools, Floats
from benchmark.protocols import CollisionProtocol, bev_planner, fine_grid, omnidrive, stp3
from benchmark.protocols.bev_planner import BEVPlannerProtocol
from benchmark.protocols.omnidrive import OmniDriveProtocol
from benchmark.protocols.raster import CELL_M, CELLS, EXTENT_M, RasterProtocol, draw_full_rasters
from benchmark.protocols.safemvdrive import SafeMVDriveProtocol
from benchmark.protocols.stacked_truths import stack
from benchmark.protocols.stp3 import STP3Protocol
from benchmark.report import palette
from benchmark.report.palette import format_hexadecimal
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EGO, HIT, INK = (format_hexadecimal(colour) for colour in (palette.EGO, palette.CONTACT, palette.INK))
OBJECT, IGNORED, CELL, GHOST = "#7a8ba6", "#8a8f99", "#a9bcd8", "#8e5bb5"


@dataclass(frozen=True, slots=True)
class RasterView:
    """(R, C) cells that a raster protocol compares at one step; rows from rear to front, columns from left to right.

    `first_cell_m` is x, y of the middle of cell (0, 0), as the protocol places its objects.
    """

    occupied: Bools
    ego: Bools
    first_cell_m: tuple[float, float]
    cell_m: float = CELL_M

    @property
    def ego_middle_m(self) -> Floats:
        """(2,) middle of the ego's cells."""
        rows, columns = np.nonzero(self.ego)
        return np.array([columns.mean(), rows.mean()]) * self.cell_m + self.first_cell_m


def build_raster_view(
    definition: CollisionProtocol, truth: SampleTruth, plan_lidar: Floats, step: int
) -> RasterView | None:
    """Cells that a protocol compares at a step (0 to 5), ``None`` without a raster; ``plan_lidar`` is (6, 2) metres."""
    if isinstance(definition, SafeMVDriveProtocol):
        definition = definition.uniad
    if isinstance(definition, STP3Protocol):
        return _build_warped_view(definition, truth, plan_lidar, step)
    if isinstance(definition, BEVPlannerProtocol | OmniDriveProtocol):
        return _build_fine_view(definition, truth, plan_lidar, step)
    if not isinstance(definition, RasterProtocol):
        return None
    waypoint = plan_lidar[step]
    stacked = stack([truth])
    counted = np.flatnonzero(definition.counted_objects(stacked)[:, step])
    polygons = definition.drawn_polygons(definition.drawn_boxes(stacked, counted, np.full(len(counted), step)))
    occupied = draw_full_rasters(polygons, np.zeros(len(counted), np.int64), 1)[0] > 0
    ego, at = np.zeros((CELLS, CELLS), dtype=np.bool_), definition.ego_block(waypoint)
    ego[at[:, 0], at[:, 1]] = True
    if definition.first_row_ahead:
        return RasterView(occupied[::-1], ego[::-1], (-EXTENT_M, EXTENT_M - CELL_M * (CELLS - 1)))
    return RasterView(occupied, ego, (-EXTENT_M, -EXTENT_M))


def _build_warped_view(definition: STP3Protocol, truth: SampleTruth, plan_lidar: Floats, step: int) -> RasterView:
    """ST-P3's picture of a step as it is warped into the present, around the rear axle as it draws its objects."""
    stacked = stack([truth])
    polygons, place_of = stp3.draw_polygons(definition, stacked)
    drawn = draw_full_rasters(polygons[place_of == step], np.zeros(int((place_of == step).sum()), np.int64), 1)[0] > 0
    rows, columns = np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij")
    motion = (part[0, step] for part in stp3.compute_warps(stacked.axle_poses))
    from_row, from_column = stp3.find_cells_before_warp(rows, columns, *motion)
    there = (from_row >= 0) & (from_row < CELLS) & (from_column >= 0) & (from_column < CELLS)
    occupied = drawn[np.clip(from_row, 0, CELLS - 1), np.clip(from_column, 0, CELLS - 1)] & there
    ego, at = np.zeros((CELLS, CELLS), dtype=np.bool_), stp3.compute_ego_block(plan_lidar[step])
    ego[at[:, 0], at[:, 1]] = True
    # Columns go to the left; row 0 is 50 m behind the rear axle.
    first = (EXTENT_M - CELL_M * (CELLS - 1), -EXTENT_M - truth.lidar_ahead_m)
    return RasterView(occupied[:, ::-1], ego[:, ::-1], first)


def _build_fine_view(
    definition: BEVPlannerProtocol | OmniDriveProtocol, truth: SampleTruth, plan_lidar: Floats, step: int
) -> RasterView:
    """The cells of 0.1 m that BEV-Planner and OmniDrive compare, around the rear axle as both draw their objects."""
    stacked = stack([truth])
    size, place = fine_grid.CELLS, np.array([step])
    occupied = np.zeros((size, size), np.uint8)
    if isinstance(definition, BEVPlannerProtocol):
        polygons, place_of = bev_planner.draw_polygons(definition, stacked)
        cover = bev_planner.build_footprint(bev_planner.to_forward_left(plan_lidar[None]))
    else:
        polygons, place_of = omnidrive.draw_polygons(definition, stacked)
        path = omnidrive.to_axle_path(plan_lidar[None], stacked.ahead_m)
        cover = omnidrive.build_footprint(omnidrive.round_to_text(path))
    cv2.fillPoly(occupied, list(polygons[place_of == step]), (1,))
    ego = np.zeros((size, size), dtype=np.bool_)
    at = cover.cells(place)[0][0]
    ego[at[:, 0], at[:, 1]] = True
    # Rows go to the left and columns ahead: turned, rows go ahead and columns to the right.
    first = (-fine_grid.FIRST_CELL_M - fine_grid.CELL_M * (size - 1), fine_grid.FIRST_CELL_M - truth.lidar_ahead_m)
    return RasterView(occupied.T[:, ::-1] > 0, ego.T[:, ::-1], first, fine_grid.CELL_M)


def draw_cells(axes: "Axes", view: RasterView, *, alpha: float = 1.0) -> None:
    """Draw occupied cells, the ego's cells, and those that are both, in metres."""
    shade_cells(axes, view, view.occupied & ~view.ego, CELL, alpha=alpha)
    shade_cells(axes, view, view.ego & ~view.occupied, EGO, alpha=0.55 * alpha)
    shade_cells(axes, view, view.ego & view.occupied, HIT, alpha=alpha)


def shade_cells(axes: "Axes", view: RasterView, cells: Bools, colour: str, *, alpha: float = 1.0) -> None:
    """Draw some cells, (200, 200) flags, as squares in metres."""
    from matplotlib.collections import PolyCollection

    rows, columns = np.nonzero(cells)
    middle = np.column_stack([columns, rows]) * view.cell_m + view.first_cell_m
    square = 0.5 * view.cell_m * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = list(middle[:, None] + square)
    # Between small cells a line would hide them.
    line = 0.4 * min(1.0, view.cell_m / CELL_M)
    axes.add_collection(PolyCollection(corners, facecolors=colour, edgecolors="white", linewidths=line, alpha=alpha))


def fill(axes: "Axes", corners: Floats, colour: str, *, alpha: float = 0.75) -> None:
    """A filled polygon, (N, 2) metres."""
    axes.fill(corners[:, 0], corners[:, 1], facecolor=colour, edgecolor=INK, linewidth=0.8, alpha=alpha)


def outline(axes: "Axes", corners: Floats, colour: str, style: str) -> None:
    """A polygon's edge, (N, 2) metres."""
    closed = np.concatenate([corners, corners[:1]])
    axes.plot(closed[:, 0], closed[:, 1], style, color=colour, linewidth=1.3)


def draw_path(axes: "Axes", plan_lidar: Floats, colour: str = EGO) -> None:
    """A plan from the present position, a dot at each waypoint."""
    path = np.concatenate([np.zeros((1, 2)), plan_lidar])
    axes.plot(path[:, 0], path[:, 1], "-", color=colour, linewidth=1.0, alpha=0.8)
    axes.plot(plan_lidar[:, 0], plan_lidar[:, 1], "o", color=colour, markersize=3.5, markeredgecolor="white")


def frame_view(axes: "Axes", centre: Floats, half_view_m: float) -> None:
    """Show a square piece of the plane around a (2,) centre in metres."""
    axes.set_xlim(centre[0] - half_view_m, centre[0] + half_view_m)
    axes.set_ylim(centre[1] - half_view_m, centre[1] + half_view_m)
    axes.set_autoscale_on(False)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7, colors="#777777")
    axes.set_xlabel("metres to the right of the car now", fontsize=7, color="#777777")
