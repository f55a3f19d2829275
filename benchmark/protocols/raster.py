"""The 200 x 200 grid of half-metre cells on which UniAD and VAD look for collisions.

Objects are drawn as OpenCV fills polygons: every cell that an edge passes is occupied, so boxes grow by up to half a
cell on each side. The ego is a block of 8 x 4 cells that is never turned. Both protocols place the two with different
roundings; each says in its own module where it puts them.

Only polygons near the cells that are asked for are drawn, one at a time into a grid of the full size: the clipping at
the grid's border decides some cells inside it, so a smaller grid would not do. `full_rasters` draws everything, for
comparison with stored rasters and for pictures.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats

CELLS = 200
"""Cells along each side."""
CELL_M = 0.5
EXTENT_M = 50.0
"""The grid spans 50 m to each side of the lidar origin."""

Cells = NDArray[np.int64]

EGO_BLOCK: Cells = np.stack(np.meshgrid(np.arange(97, 105), np.arange(98, 102), indexing="ij"), axis=-1).reshape(-1, 2)
"""(32, 2) rows and columns that the ego covers at the origin: what drawing its 4.084 m x 1.85 m rectangle gives."""


def ego_cells(waypoints_lidar: Floats) -> Floats:
    """Row and column of the ego's block before rounding: cell counts from the grid's left and rear edge.

    Args:
        waypoints_lidar: (..., 2) x right, y forward, metres.

    Returns:
        (..., 32, 2) row (forward) and column (right), not rounded. The official code divides in single precision.
    """
    single = np.asarray(waypoints_lidar)[..., ::-1].astype(np.float32) / np.float32(CELL_M)
    return np.asarray(single.astype(np.float64)[..., None, :] + EGO_BLOCK)


def truncated(cells: Floats) -> Cells:
    """Cell indices rounded towards zero and squeezed into the grid, as both official codes do it.

    Args:
        cells: (..., 2) rows and columns.

    Returns:
        (..., 2) whole numbers from 0 to 199: a block that leaves the grid is squashed on its border.
    """
    return np.clip(np.trunc(cells), 0, CELLS - 1).astype(np.int64)


def occupied(polygons: NDArray[np.int32], place_of: NDArray[np.int64], cells: Sequence[Cells]) -> list[Bools]:
    """Which cells are covered by the polygons of their place.

    Args:
        polygons: (N, 4, 2) corners, column first.
        place_of: (N,) which of P places (a sample at a step) a polygon belongs to.
        cells: Groups of cells to look at, each (P, C, 2), row first.

    Returns:
        For each group (P, C) verdicts.
    """
    found = [np.zeros(group.shape[:2], dtype=np.bool_) for group in cells]
    low, high = polygons.min(axis=1)[:, ::-1], polygons.max(axis=1)[:, ::-1]
    near = np.zeros(len(polygons), dtype=np.bool_)
    for group in cells:
        first, last = group.min(axis=1), group.max(axis=1)
        near |= ((low <= last[place_of]) & (high >= first[place_of])).all(axis=-1)
    grid = np.zeros((CELLS, CELLS), np.uint8)
    for index in np.flatnonzero(near).tolist():
        place = place_of[index]
        cv2.fillPoly(grid, [polygons[index]], (1,))
        for group, verdicts in zip(cells, found):
            at = group[place]
            verdicts[place] |= grid[at[:, 0], at[:, 1]] > 0
        (top, left), (bottom, right) = np.maximum(low[index], 0), high[index]
        grid[top : bottom + 1, left : right + 1] = 0
    return found


def may_reach(boxes: Floats, place_of: NDArray[np.int64], cells: Sequence[Cells], rows: Floats) -> Bools:
    """A cheap test that leaves few polygons to compute: whether a box could cover any of the cells.

    Args:
        boxes: (N, 5) boxes.
        place_of: (N,) see `occupied`.
        cells: See `occupied`.
        rows: (N,) row on which the box's centre lies, not rounded.

    Returns:
        (N,) verdicts, True too often but never False where `occupied` finds a cell.
    """
    # Half the diagonal, and a cell for the roundings of corner and outline.
    reach = 0.5 * np.hypot(boxes[:, 2], boxes[:, 3]) / CELL_M + 1.0
    center = np.stack([rows, (boxes[:, 0] + EXTENT_M) / CELL_M], axis=-1)
    near = np.zeros(len(boxes), dtype=np.bool_)
    for group in cells:
        first, last = group.min(axis=1), group.max(axis=1)
        near |= ((center - reach[:, None] <= last[place_of]) & (center + reach[:, None] >= first[place_of])).all(
            axis=-1
        )
    return near


def full_rasters(polygons: NDArray[np.int32], place_of: NDArray[np.int64], places: int) -> NDArray[np.uint8]:
    """Everything drawn.

    Args:
        polygons: (N, 4, 2) corners, column first.
        place_of: (N,) which place each belongs to.
        places: How many places there are.

    Returns:
        (places, 200, 200) ones where occupied.
    """
    grids = np.zeros((places, CELLS, CELLS), np.uint8)
    for polygon, place in zip(list(polygons), place_of.tolist()):
        cv2.fillPoly(grids[place], [polygon], (1,))
    return grids
