"""The 1000 x 1000 grid of 0.1 m cells on which BEV-Planner and OmniDrive look for contact, in the ego frame.

Row is y (left), column is x (forward). The ego is what drawing its 4.084 m x 1.85 m rectangle gives, 738 cells, turned
about the origin of the waypoints and rounded cell by cell (which leaves holes), then moved to the waypoint.

Only what may be touched is drawn, one place (a sample at a step) at a time into a grid of the full size.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_BOX_FROM_LIDAR_M, EGO_LENGTH_M, EGO_WIDTH_M
from benchmark.geometry import Bools, Floats
from benchmark.protocols.raster import Cells

CELLS: Final = 1000
CELL_M: Final = 0.1
FIRST_CELL_M: Final = -49.95
"""Centre of the first cell."""
CENTER_AHEAD_M: Final = EGO_BOX_FROM_LIDAR_M + 0.985793
"""Centre of the ego's rectangle ahead of the origin of the waypoints, as both repositories have it."""
MOVING_M: Final = 1.0
"""A step shorter than this has the heading of the present."""
_ORIGIN: Final = -FIRST_CELL_M / CELL_M


def _footprint() -> Cells:
    """(738, 2) rows and columns whose centres the rectangle covers at the origin."""
    (low_x, high_x), (low_y, high_y) = (
        ((center - half - FIRST_CELL_M) / CELL_M, (center + half - FIRST_CELL_M) / CELL_M)
        for center, half in ((CENTER_AHEAD_M, 0.5 * EGO_LENGTH_M), (0.0, 0.5 * EGO_WIDTH_M))
    )
    rows, columns = (np.arange(int(np.ceil(low)), int(high) + 1) for low, high in ((low_y, high_y), (low_x, high_x)))
    return np.asarray(np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2))


FOOTPRINT: Final = _footprint()


def step_headings(waypoints: Floats, *, moving_m: float) -> Floats:
    """Direction of the step that ends at each waypoint, straight ahead where the step is short.

    Args:
        waypoints: (..., 6, 2) x forward, y left, metres.
        moving_m: Shortest step that turns the car.

    Returns:
        (..., 6) radians.
    """
    step = np.diff(waypoints, axis=-2, prepend=0.0)
    heading = np.arctan2(step[..., 1], step[..., 0])
    return np.where(np.hypot(step[..., 0], step[..., 1]) < moving_m, 0.0, heading)


class TurnedFootprint:
    """The cells of the ego at P places.

    Attributes:
        waypoints: (P, 2) x forward, y left, metres.
        heading_rad: (P,).
        kind: In what precision cells are moved.
    """

    def __init__(self, waypoints: Floats, heading_rad: Floats, kind: type[np.floating[Any]]) -> None:
        self.waypoints, self.heading_rad, self.kind = waypoints, heading_rad, kind

    def cells(self, place: int) -> Cells:
        """Cells at one place.

        Args:
            place: Which.

        Returns:
            (738, 2) rows and columns, squeezed into the grid.
        """
        cos, sin = (np.float32(turn(self.heading_rad[place])) for turn in (np.cos, np.sin))
        centred = (FOOTPRINT - _ORIGIN).astype(self.kind)
        along = cos * centred[:, 1] - sin * centred[:, 0]
        across = sin * centred[:, 1] + cos * centred[:, 0]
        turned = np.round(np.stack([across, along], axis=-1) + self.kind(_ORIGIN))
        # The official cell size is single precision even where waypoints are not: 18.2 m is a cell less than 182.
        moved = turned + self.waypoints[place, ::-1].astype(self.kind) / self.kind(np.float32(CELL_M))
        return np.asarray(np.clip(np.trunc(moved), 0, CELLS - 1), np.int64)

    def bounds(self) -> tuple[Floats, Floats]:
        """Where the cells of each place lie, at least.

        Returns:
            (P, 2) lowest and highest row and column, squeezed into the grid.
        """
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        center = CENTER_AHEAD_M * np.stack([sin, cos], axis=-1) + self.waypoints[:, ::-1]
        half_x, half_y = 0.5 * EGO_LENGTH_M, 0.5 * EGO_WIDTH_M
        reach = np.abs(np.stack([sin, cos], axis=-1)) * half_x + np.abs(np.stack([cos, sin], axis=-1)) * half_y
        low, high = ((center + side * (reach + 3 * CELL_M) - FIRST_CELL_M) / CELL_M for side in (-1.0, 1.0))
        return np.clip(low, 0, CELLS - 1), np.clip(high, 0, CELLS - 1)


class Points:
    """The single cell below each of P places; none where that lies off the grid.

    Attributes:
        cell: (P, 2) row and column, squeezed into the grid.
        inside: (P,) whether it lies in it.
    """

    def __init__(self, points: Floats, kind: type[np.floating[Any]]) -> None:
        place = np.trunc((points[:, ::-1].astype(kind) - kind(FIRST_CELL_M)) / kind(CELL_M))
        self.inside = ((place >= 0) & (place < CELLS)).all(axis=-1)
        self.cell = np.clip(place, 0, CELLS - 1).astype(np.int64)

    def cells(self, place: int) -> Cells:
        """(1, 2) or (0, 2) rows and columns at one place."""
        return np.asarray(self.cell[place : place + 1] if self.inside[place] else self.cell[:0])

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest row and column of each place, which are the same."""
        return self.cell.astype(np.float64), self.cell.astype(np.float64)


def touched(
    looked_at: Sequence[TurnedFootprint | Points],
    polygons: NDArray[np.int32],
    place_of: NDArray[np.int64],
    draw: Callable[[NDArray[np.uint8], NDArray[np.int32]], None],
) -> list[Bools]:
    """At which places drawn cells are covered.

    Args:
        looked_at: What covers cells, each at the same P places.
        polygons: (N, K, 2) column and row of points.
        place_of: (N,) which place each belongs to.
        draw: Draws some of them: takes a grid and (n, K, 2) points.

    Returns:
        (P,) verdicts for each that covers cells.
    """
    bounds = [one.bounds() for one in looked_at]
    verdicts = [np.zeros(len(low), dtype=np.bool_) for low, _ in bounds]
    first, last = polygons.min(axis=1)[:, ::-1] - 1, polygons.max(axis=1)[:, ::-1] + 1
    reached = [((low[place_of] <= last) & (high[place_of] >= first)).all(axis=-1) for low, high in bounds]
    near = np.flatnonzero(np.logical_or.reduce(reached))
    near = near[np.argsort(place_of[near], kind="stable")]
    places, starts = np.unique(place_of[near], return_index=True)
    grid = np.zeros((CELLS, CELLS), np.uint8)
    for place, rows in zip(places.tolist(), np.split(near, starts[1:])):
        draw(grid, polygons[rows])
        for one, found, reach in zip(looked_at, verdicts, reached):
            if reach[rows].any():
                cells = one.cells(place)
                found[place] = grid[cells[:, 0], cells[:, 1]].any()
        (top, left), (bottom, right) = np.maximum(first[rows].min(axis=0), 0), np.maximum(last[rows].max(axis=0), 0)
        grid[top : bottom + 1, left : right + 1] = 0
    return verdicts


def fill(grid: NDArray[np.uint8], polygons: NDArray[np.int32]) -> None:
    """Fill (n, K, 2) polygons, borders included."""
    for polygon in polygons:
        cv2.fillPoly(grid, [polygon], (1,))


def outline(grid: NDArray[np.uint8], lines: NDArray[np.int32]) -> None:
    """Draw (n, 2, 2) lines, one cell wide."""
    for start, end in lines.tolist():
        cv2.line(grid, start, end, (1,), 1)
