"""The 200 x 200 grid of half-metre cells on which UniAD and VAD look for collisions, and whom each is with.

Objects are drawn as OpenCV fills polygons: every cell that an edge passes is occupied, so boxes grow by up to half a
cell on each side. The ego is a block of 8 x 4 cells that is never turned. Both protocols place the two with different
roundings; each says in its own module where it puts them. `RasterProtocol` is what the two share.

Only polygons near the cells that are asked for are drawn, one at a time into a grid of the full size: the clipping at
the grid's border decides some cells inside it, so a smaller grid would not do. `draw_full_rasters` draws everything,
for comparison with stored rasters and for pictures.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols.contract import ProtocolOutcomes
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.truth import SampleTruth

TOUCHED, TOUCHED_ADVERSARY = "touched", "touched_adversary"
"""Facts of protocols that look at the steps alone."""
HIT_ADVERSARY, ADVERSARY_S = "hit_adversary", "adversary_contact_s"
"""Facts of ``exact``, beside ``hit`` and ``first_contact_s``."""


def touches_adversary(collision: Sequence[bool], facts: Mapping[str, Any]) -> bool | None:
    """Whether the first contact of a plan is with an adversary.

    ``None`` where there is no contact, or the verdict does not say whom it is with: it is older, or of a protocol that
    never does.
    """
    if not any(collision):
        return None
    touched_flags = facts.get(TOUCHED_ADVERSARY)
    first = facts.get(HIT_ADVERSARY) if touched_flags is None else touched_flags[list(collision).index(True)]
    return None if first is None else bool(first)


def describe_touched(
    truths: StackedTruths, collision: Bools, objects: NDArray[np.int64], steps: NDArray[np.int64]
) -> dict[str, tuple[Any, ...]]:
    """Facts on which objects are touched at each colliding step, null for a sample without a collision.

    ``touched`` has the instance at each of the six steps, the first by name of several, null at a step without a
    collision; ``touched_adversary`` says whether any of them there is an adversary. ``collision`` is (S, 6), after the
    protocol's own exclusions; ``objects`` are (N,) that the ego touches, in any order, at (N,) ``steps``, 0 to 5.
    """
    names: list[list[str | None]] = [[None] * PLAN_STEPS for _ in collision]
    adversaries = [[False] * PLAN_STEPS for _ in collision]
    samples = truths.sample_of[objects]
    counts = collision[samples, steps]
    for sample, step, row in zip(samples[counts].tolist(), steps[counts].tolist(), objects[counts].tolist()):
        name, known = truths.instances[row], names[sample][step]
        names[sample][step] = name if known is None else min(known, name)
        adversaries[sample][step] |= bool(truths.adversarial[row])
    collides = collision.any(axis=1).tolist()
    return {
        TOUCHED: tuple(own if any_step else None for own, any_step in zip(names, collides)),
        TOUCHED_ADVERSARY: tuple(own if any_step else None for own, any_step in zip(adversaries, collides)),
    }


CELLS = 200
"""Cells along each side."""
CELL_M = 0.5
EXTENT_M = 50.0
"""The grid spans 50 m to each side of the lidar origin."""

Cells = NDArray[np.int64]

EGO_BLOCK: Cells = np.stack(np.meshgrid(np.arange(97, 105), np.arange(98, 102), indexing="ij"), axis=-1).reshape(-1, 2)
"""(32, 2) rows and columns that the ego covers at the origin: what drawing its 4.084 m x 1.85 m rectangle gives."""


def compute_ego_cells(waypoints_lidar: Floats) -> Floats:
    """Row and column of the ego's block before rounding: cell counts from the grid's left and rear edge.

    (..., 32, 2) row (forward) and column (right) for (..., 2) waypoints, x right, y forward, metres. The official code
    divides in single precision.
    """
    single = np.asarray(waypoints_lidar)[..., ::-1].astype(np.float32) / np.float32(CELL_M)
    return np.asarray(single.astype(np.float64)[..., None, :] + EGO_BLOCK)


def truncate_cells(cells: Floats) -> Cells:
    """Cell indices rounded towards zero and squeezed into the grid, 0 to 199, as both official codes do it.

    A block that leaves the grid is squashed on its border.
    """
    return np.clip(np.trunc(cells), 0, CELLS - 1).astype(np.int64)


def compute_bounds(cells: Cells) -> tuple[Cells, Cells]:
    """First and last row and column, (P, 2) each, of (P, C, 2) cells: C at a time, not two."""
    apart = np.ascontiguousarray(np.moveaxis(cells, 1, 0))
    return apart.min(axis=0), apart.max(axis=0)


def find_occupied_cells(
    polygons: NDArray[np.int32],
    place_of: NDArray[np.int64],
    cells: Sequence[Cells],
    bounds: Sequence[tuple[Cells, Cells]] | None = None,
) -> list[Bools]:
    """(P, C) which cells are covered by the polygons of their place, for each (P, C, 2) group of cells, row first.

    ``polygons`` are (N, 4, 2) corners, column first, ``place_of`` (N,) the place (a sample at a step) of each;
    ``bounds`` are `compute_bounds` of each group, where at hand.
    """
    covered = [np.zeros(group.shape[:2], dtype=np.bool_) for group in cells]
    low, high = polygons.min(axis=1)[:, ::-1], polygons.max(axis=1)[:, ::-1]
    near = np.zeros(len(polygons), dtype=np.bool_)
    for first, last in map(compute_bounds, cells) if bounds is None else bounds:
        near |= ((low <= last[place_of]) & (high >= first[place_of])).all(axis=-1)
    grid = np.zeros((CELLS, CELLS), np.uint8)
    for index in np.flatnonzero(near).tolist():
        place = place_of[index]
        cv2.fillPoly(grid, [polygons[index]], (1,))
        for group, verdicts in zip(cells, covered):
            at = group[place]
            verdicts[place] |= grid[at[:, 0], at[:, 1]] > 0
        (top, left), (bottom, right) = np.maximum(low[index], 0), high[index]
        grid[top : bottom + 1, left : right + 1] = 0
    return covered


def find_covering_polygons(
    polygons: NDArray[np.int32], place_of: NDArray[np.int64], cells: Cells, counts: Bools | None = None
) -> Bools:
    """(N,) which polygons cover a cell of their place: `find_occupied_cells`, asked of each polygon.

    ``polygons`` are (N, 4, 2) corners, column first, ``place_of`` (N,) the place of each; ``cells`` are (P, C, 2), row
    first, and ``counts`` is (P, C), which of them count, if not all.
    """
    covers = np.zeros(len(polygons), dtype=np.bool_)
    grid = np.zeros((CELLS, CELLS), np.uint8)
    for index, place in enumerate(place_of.tolist()):
        cv2.fillPoly(grid, [polygons[index]], (1,))
        at = cells[place] if counts is None else cells[place][counts[place]]
        covers[index] = grid[at[:, 0], at[:, 1]].any()
        grid[:] = 0
    return covers


def _may_reach(
    boxes: Floats, place_of: NDArray[np.int64], bounds: Sequence[tuple[Cells, Cells]], rows: Floats
) -> Bools:
    """A cheap test that leaves few polygons to compute: whether each of (N, 5) boxes could cover any of the cells.

    ``bounds`` are those of the cells (`compute_bounds`), ``rows`` are those on which the boxes' centres lie, not
    rounded. True too often, but never False where `find_occupied_cells` finds a cell.
    """
    # Half the diagonal, and a cell for the roundings of corner and outline.
    reach = 0.5 * np.hypot(boxes[:, 2], boxes[:, 3]) / CELL_M + 1.0
    center = np.stack([rows, (boxes[:, 0] + EXTENT_M) / CELL_M], axis=-1)
    near = np.zeros(len(boxes), dtype=np.bool_)
    for first, last in bounds:
        near |= ((center - reach[:, None] <= last[place_of]) & (center + reach[:, None] >= first[place_of])).all(
            axis=-1
        )
    return near


def draw_full_rasters(polygons: NDArray[np.int32], place_of: NDArray[np.int64], places: int) -> NDArray[np.uint8]:
    """(places, 200, 200) ones where polygons, (N, 4, 2) corners with the column first, are drawn."""
    grids = np.zeros((places, CELLS, CELLS), np.uint8)
    for polygon, place in zip(list(polygons), place_of.tolist()):
        cv2.fillPoly(grids[place], [polygon], (1,))
    return grids


class RasterProtocol(ABC):
    """Raster protocol of UniAD and VAD: the ego's block against the drawn objects, and the mask of the recorded ego.

    ``first_row_ahead`` says whether row 0 of the grid lies far ahead, not far behind.
    """

    counts_incomplete: bool
    uses_categories: bool
    first_row_ahead: bool

    @abstractmethod
    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Which objects are drawn at which step: (M, 6) verdicts for S samples with M objects."""

    @abstractmethod
    def drawn_boxes(self, truths: StackedTruths, objects: NDArray[np.int64], steps: NDArray[np.int64]) -> Floats:
        """(N, 5) boxes as which objects are drawn at steps 0 to 5."""

    @abstractmethod
    def drawn_polygons(self, boxes: Floats) -> NDArray[np.int32]:
        """Corners of (N, 5) boxes on the grid: (N, 4, 2) column and row of each."""

    @abstractmethod
    def point_cells(self, waypoints_lidar: Floats) -> Floats:
        """Row and column of the cell that ``obj_col`` asks for, for (S, 6, 2) waypoints; rounded towards zero."""

    def headings(self, plans_lidar: Floats) -> Floats:
        """Straight ahead at every step."""
        return np.full(plans_lidar.shape[:-1], np.pi / 2)

    @property
    def mean_ends_m(self) -> Floats:
        """How far the ego's block reaches, on average over where the waypoint lies in its cell.

        A cell stands for a quarter of a metre around its node, and rounding down moves the block by half a cell.
        (4,) rear, front, right and left end, metres ahead of the waypoint and to the left of it. Corners of objects
        are rounded to the nearest node: contact begins up to 0.25 m farther away, or as much nearer.
        """
        rounded_to = np.array([0.5 if self.first_row_ahead else -0.5, -0.5])
        nodes = np.stack([EGO_BLOCK.min(axis=0) - 0.5, EGO_BLOCK.max(axis=0) + 0.5]) + rounded_to
        (rear, left), (front, right) = nodes * CELL_M - EXTENT_M
        return np.array([rear, front, -right, -left])

    def ego_block(self, waypoints_lidar: Floats) -> Cells:
        """(..., 32, 2) rows and columns that the ego covers at each waypoint (x right, y forward, metres)."""
        cells = compute_ego_cells(waypoints_lidar)
        if self.first_row_ahead:
            cells[..., 0] = CELLS - cells[..., 0]
        return truncate_cells(cells)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Verdicts of plans: ``before_mask``, ``recorded``, ``recorded_adversary`` and ``obj_col``."""
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        plan, recorded = self.ego_block(plans), self.ego_block(stacked.ego_future[..., :2])
        point = self.point_cells(plans)
        inside = ((point >= 0) & (point < CELLS)).all(axis=-1)
        groups = (plan, recorded, truncate_cells(point)[..., None, :])
        on_plan, on_recorded, at_point = self._find_covered(stacked, self.counted_objects(stacked), groups)
        collision = on_plan & ~on_recorded
        return ProtocolOutcomes(
            collision=collision,
            l2=compute_displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=stacked.ego_future_valid.all(axis=-1) | self.counts_incomplete,
            steps={
                "before_mask": on_plan,
                "recorded": on_recorded,
                "recorded_adversary": self.recorded_contacts(stacked, stacked.adversarial),
                "obj_col": at_point & inside & ~on_recorded,
            },
            facts=self._touched(stacked, collision, plan),
        )

    def _touched(self, truths: StackedTruths, collision: Bools, cells: Cells) -> dict[str, tuple[Any, ...]]:
        """Objects whose polygons cover (S, 6, C, 2) cells at (S, 6) colliding steps."""
        objects, steps = np.nonzero(self.counted_objects(truths) & collision[truths.sample_of])
        places = truths.sample_of[objects] * PLAN_STEPS + steps
        flat = cells.reshape(-1, cells.shape[-2], 2)
        hit = find_covering_polygons(self.drawn_polygons(self.drawn_boxes(truths, objects, steps)), places, flat)
        return describe_touched(truths, collision, objects[hit], steps[hit])

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: whether the recorded ego's block covers a cell of any counted object asked about."""
        block = self.ego_block(truths.ego_future[..., :2])
        return self._find_covered(truths, self.counted_objects(truths) & among[:, None], (block,))[0]

    def _find_covered(self, truths: StackedTruths, drawn: Bools, groups: Sequence[Cells]) -> list[Bools]:
        """For each group of (S, 6, C, 2) cells whether (S, 6) any is covered by those of M objects that are drawn."""
        objects, steps = np.nonzero(drawn)
        place_of = truths.sample_of[objects] * PLAN_STEPS + steps
        boxes = self.drawn_boxes(truths, objects, steps)
        flat = [cells.reshape(-1, cells.shape[-2], 2) for cells in groups]
        rows = (EXTENT_M - boxes[:, 1] if self.first_row_ahead else boxes[:, 1] + EXTENT_M) / CELL_M
        bounds = [compute_bounds(cells) for cells in flat]
        near = _may_reach(boxes, place_of, bounds, rows)
        covered = find_occupied_cells(self.drawn_polygons(boxes[near]), place_of[near], flat, bounds)
        return [hit.any(axis=-1).reshape(-1, PLAN_STEPS) for hit in covered]
