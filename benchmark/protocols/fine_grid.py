"""The 1000 x 1000 grid of 0.1 m cells on which BEV-Planner and OmniDrive look for contact, in the ego frame.

Row is y (left), column is x (forward). The ego is what drawing its 4.084 m x 1.85 m rectangle gives, 738 cells, turned
about the origin of the waypoints and rounded cell by cell (which leaves holes), then moved to the waypoint.

Only what may be touched is drawn, one place (a sample at a step) at a time into a grid of the full size.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_BOX_FROM_LIDAR_M, EGO_LENGTH_M, EGO_WIDTH_M
from benchmark.geometry import Bools, Floats, directions_of
from benchmark.protocols.raster import Cells

CELLS: Final = 1000
CELL_M: Final = 0.1
FIRST_CELL_M: Final = -49.95
"""Centre of the first cell."""
CENTER_AHEAD_M: Final = EGO_BOX_FROM_LIDAR_M + 0.985793
"""Centre of the ego's rectangle ahead of the origin of the waypoints, as both repositories have it."""
MOVING_M: Final = 1.0
"""A step shorter than this has the heading of the present."""
_PLACES_AT_ONCE: Final = 256
"""Bounds the memory of cells."""
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


def compute_step_headings(waypoints: Floats, *, moving_m: float) -> Floats:
    """(..., 6) radians of the step that ends at each waypoint, straight ahead where the step is short.

    Waypoints are x forward, y left, metres; ``moving_m`` is the shortest step that turns the car.
    """
    step = np.diff(waypoints, axis=-2, prepend=0.0)
    heading = directions_of(step)
    return np.where(np.hypot(step[..., 0], step[..., 1]) < moving_m, 0.0, heading)


class FootprintCells:
    """Cells of the ego, moved in one precision, at (P, 2) waypoints, x forward, y left, metres, with (P,) headings."""

    def __init__(self, waypoints: Floats, heading_rad: Floats, kind: type[np.floating[Any]]) -> None:
        self.waypoints, self.heading_rad, self.kind = waypoints, heading_rad, kind

    def cells(self, places: NDArray[np.int64]) -> tuple[Cells, Bools]:
        """(n, 738, 2) rows and columns at n places, squeezed into the grid, and (n, 738) that all of them count."""
        heading = self.heading_rad[places, None]
        cos, sin = (turn(heading).astype(np.float32).astype(self.kind) for turn in (np.cos, np.sin))
        across, along = (FOOTPRINT - _ORIGIN).astype(self.kind).T
        turned = np.stack([sin * along + cos * across, cos * along - sin * across], axis=-1)
        # The official cell size is single precision even where waypoints are not: 18.2 m is a cell less than 182.
        shift = self.waypoints[places, None, ::-1].astype(self.kind) / self.kind(np.float32(CELL_M))
        moved = np.round(turned + self.kind(_ORIGIN)) + shift
        cells = np.clip(np.trunc(moved), 0, CELLS - 1).astype(np.int64)
        return cells, np.ones(cells.shape[:2], dtype=np.bool_)

    def bounds(self) -> tuple[Floats, Floats]:
        """(P, 2) lowest and highest row and column of the cells of each place, at least, squeezed into the grid."""
        cos, sin = np.cos(self.heading_rad), np.sin(self.heading_rad)
        center = CENTER_AHEAD_M * np.stack([sin, cos], axis=-1) + self.waypoints[:, ::-1]
        half_x, half_y = 0.5 * EGO_LENGTH_M, 0.5 * EGO_WIDTH_M
        reach = np.abs(np.stack([sin, cos], axis=-1)) * half_x + np.abs(np.stack([cos, sin], axis=-1)) * half_y
        low, high = ((center + side * (reach + 3 * CELL_M) - FIRST_CELL_M) / CELL_M for side in (-1.0, 1.0))
        return np.clip(low, 0, CELLS - 1), np.clip(high, 0, CELLS - 1)


class PointCells:
    """The single cell below each of P places, (P, 2) row and column squeezed into the grid; none where it lies off."""

    def __init__(self, points: Floats, kind: type[np.floating[Any]]) -> None:
        place = np.trunc((points[:, ::-1].astype(kind) - kind(FIRST_CELL_M)) / kind(CELL_M))
        self.inside = ((place >= 0) & (place < CELLS)).all(axis=-1)
        self.cell = np.clip(place, 0, CELLS - 1).astype(np.int64)

    def cells(self, places: NDArray[np.int64]) -> tuple[Cells, Bools]:
        """(n, 1, 2) rows and columns at some places, and (n, 1) whether they lie in the grid."""
        return self.cell[places, None], self.inside[places, None]

    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest row and column of each place, which are the same."""
        return self.cell.astype(np.float64), self.cell.astype(np.float64)


def find_touched(
    looked_at: Sequence[FootprintCells | PointCells],
    polygons: NDArray[np.int32],
    place_of: NDArray[np.int64],
    draw: Callable[[NDArray[np.uint8], NDArray[np.int32]], None],
) -> list[Bools]:
    """At which places drawn cells are covered: (P,) verdicts for each object of ``looked_at``.

    ``looked_at`` are footprints or points at the same P places. ``polygons`` are (N, K, 2) column and row of points,
    ``place_of`` (N,) the place of each; ``draw`` puts (n, K, 2) points on a grid.
    """
    verdicts = [np.zeros(len(one.bounds()[0]), dtype=np.bool_) for one in looked_at]
    corners = [polygons[:, point, ::-1] for point in range(polygons.shape[1])]
    first, last = reduce(np.minimum, corners) - 1, reduce(np.maximum, corners) + 1
    reached = np.zeros(len(polygons), dtype=np.bool_)
    for one in looked_at:
        low, high = one.bounds()
        reached |= ((low[place_of] <= last) & (high[place_of] >= first)).all(axis=-1)
    near = np.flatnonzero(reached)
    near = near[np.argsort(place_of[near], kind="stable")]
    places, starts = np.unique(place_of[near], return_index=True)
    rows_of = np.split(near, starts[1:])
    grid = np.zeros((CELLS, CELLS), np.uint8)
    for start in range(0, len(places), _PLACES_AT_ONCE):
        some = slice(start, start + _PLACES_AT_ONCE)
        covered = [one.cells(places[some]) for one in looked_at]
        for index, (place, rows) in enumerate(zip(places[some].tolist(), rows_of[some])):
            draw(grid, polygons[rows])
            for verdict, (cells, there) in zip(verdicts, covered):
                verdict[place] = (grid[cells[index, :, 0], cells[index, :, 1]] & there[index]).any()
            (top, left), (bottom, right) = first[rows].min(axis=0), last[rows].max(axis=0)
            grid[max(top, 0) : bottom + 1, max(left, 0) : right + 1] = 0
    return verdicts


def fill(grid: NDArray[np.uint8], polygons: NDArray[np.int32]) -> None:
    """Fill (n, K, 2) polygons, borders included."""
    for polygon in polygons:
        cv2.fillPoly(grid, [polygon], (1,))


def outline(grid: NDArray[np.uint8], lines: NDArray[np.int32]) -> None:
    """Draw (n, 2, 2) lines, one cell wide."""
    for start, end in lines.tolist():
        cv2.line(grid, start, end, (1,), 1)
