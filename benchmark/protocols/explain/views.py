"""What a protocol compares at one step, as shapes from above: cells, boxes and paths on a matplotlib plane."""

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from benchmark.drawing import palette
from benchmark.drawing.palette import hexadecimal
from benchmark.geometry import Bools, Floats
from benchmark.protocols import CollisionProtocol
from benchmark.protocols.raster import CELL_M, CELLS, EXTENT_M, RasterProtocol, full_rasters
from benchmark.protocols.stacked import stack
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

EGO, HIT, INK = (hexadecimal(colour) for colour in (palette.EGO, palette.CONTACT, palette.INK))
OBJECT, IGNORED, CELL, GHOST = "#7a8ba6", "#8a8f99", "#a9bcd8", "#8e5bb5"


@dataclass(frozen=True, slots=True)
class RasterView:
    """What a raster protocol compares at one step.

    Attributes:
        occupied: (200, 200) cells of counted objects; rows from rear to front, columns from left to right.
        ego: (200, 200) cells of the ego.
        first_cell_m: x and y of the middle of cell (0, 0), as the protocol places its objects.
    """

    occupied: Bools
    ego: Bools
    first_cell_m: tuple[float, float]

    @property
    def ego_middle_m(self) -> Floats:
        """(2,) middle of the ego's cells."""
        rows, columns = np.nonzero(self.ego)
        return np.array([columns.mean(), rows.mean()]) * CELL_M + self.first_cell_m


def raster_view(definition: CollisionProtocol, truth: SampleTruth, waypoint: Floats, step: int) -> RasterView | None:
    """The cells that a protocol compares.

    Args:
        definition: The protocol.
        truth: What really happened.
        waypoint: (2,) where the ego is at the step, metres.
        step: 0 to 5.

    Returns:
        The cells, or ``None`` for a protocol without a raster.
    """
    if not isinstance(definition, RasterProtocol):
        return None
    stacked = stack([truth])
    counted = np.flatnonzero(definition.counted_objects(stacked)[:, step])
    polygons = definition.drawn_polygons(definition.drawn_boxes(stacked, counted, np.full(len(counted), step)))
    occupied = full_rasters(polygons, np.zeros(len(counted), np.int64), 1)[0] > 0
    ego, at = np.zeros((CELLS, CELLS), dtype=np.bool_), definition.ego_block(waypoint)
    ego[at[:, 0], at[:, 1]] = True
    if definition.first_row_ahead:
        return RasterView(occupied[::-1], ego[::-1], (-EXTENT_M, EXTENT_M - CELL_M * (CELLS - 1)))
    return RasterView(occupied, ego, (-EXTENT_M, -EXTENT_M))


def draw_cells(axes: "Axes", view: RasterView, *, alpha: float = 1.0) -> None:
    """Occupied cells, the ego's cells, and those that are both.

    Args:
        axes: Where to draw, metres.
        view: The cells.
        alpha: Their opacity.
    """
    shade_cells(axes, view, view.occupied & ~view.ego, CELL, alpha=alpha)
    shade_cells(axes, view, view.ego & ~view.occupied, EGO, alpha=0.55 * alpha)
    shade_cells(axes, view, view.ego & view.occupied, HIT, alpha=alpha)


def shade_cells(axes: "Axes", view: RasterView, cells: Bools, colour: str, *, alpha: float = 1.0) -> None:
    """Some cells as squares.

    Args:
        axes: Where to draw, metres.
        view: Says where the cells lie.
        cells: (200, 200) which ones.
        colour: Their colour.
        alpha: Their opacity.
    """
    from matplotlib.collections import PolyCollection

    rows, columns = np.nonzero(cells)
    middle = np.column_stack([columns, rows]) * CELL_M + view.first_cell_m
    square = 0.5 * CELL_M * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = list(middle[:, None] + square)
    axes.add_collection(PolyCollection(corners, facecolors=colour, edgecolors="white", linewidths=0.4, alpha=alpha))


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
    """Show a square piece of the plane.

    Args:
        axes: Where to draw, metres.
        centre: (2,) its middle.
        half_view_m: Half its side.
    """
    axes.set_xlim(centre[0] - half_view_m, centre[0] + half_view_m)
    axes.set_ylim(centre[1] - half_view_m, centre[1] + half_view_m)
    axes.set_autoscale_on(False)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7, colors="#777777")
    axes.set_xlabel("metres to the right of the car now", fontsize=7, color="#777777")


def png(figure: "Figure") -> bytes:
    """A figure as a PNG file without a date or a version in it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None}, pil_kwargs={"optimize": True})
    return buffer.getvalue()
