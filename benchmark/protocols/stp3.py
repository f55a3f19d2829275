"""The ``stp3`` protocol: collision and L2 as ST-P3's own evaluation counts them.

It is not what other papers call "ST-P3 metric"; that is VAD's (`benchmark.protocols.vad`).

Definition:

* A sample counts if its scene has two keyframes before it and six after it.
* Objects are those annotated at the future keyframe of the step whose category is of people or vehicles (strollers,
  police cars and ambulances too; no cones, barriers, animals), if the same instance was annotated now, half a second or
  a second ago and more than 40 % visible there. No sensor points are asked for, and there is no range.
* Each future keyframe is drawn in its *own* flat ego frame on a grid of 200 x 200 half-metre cells, corners rounded to
  the nearest node, and the picture is then warped into the present (nearest cell, nothing outside) by the motion
  between the two, taken from single-precision poses.
* The ego is a block of 8 x 4 cells at the waypoint of the *lidar*, never turned, rounded towards zero and squeezed into
  the grid. ``before_mask``, ``recorded`` and ``collision`` (``obj_box_col``) as for ``uniad``; ``obj_col`` asks for the
  cell below the waypoint and excludes by the block of the recorded ego.
* Values at 1, 2 and 3 s are means over the steps up to there.

Known faults: objects are drawn relative to the rear axle and the ego relative to the lidar, so that the ego is tested
0.94 m too far back. The warp does not turn its translation and shifts sideways the wrong way, so that in turns objects
lie beside their place (by up to 5.7 m at 3 s). Corners go to nodes, ego cells are cut off: half a cell. A turning ego
is not turned. Who appears later cannot be hit. A collision is forgotten at the next step.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, box_corners, to_global, to_local
from benchmark.protocols.contract import ProtocolOutcomes, average_masked_columns, average_up_to
from benchmark.protocols.raster import (
    CELL_M,
    CELLS,
    EXTENT_M,
    Cells,
    compute_ego_cells,
    describe_touched,
    find_covering_polygons,
    find_occupied_cells,
    truncate_cells,
)
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.truth import SampleTruth

KEYFRAMES_BEFORE: Final = 2
"""Earlier keyframes that a sample needs."""
Singles = NDArray[np.float32]


class STP3Protocol:
    """People and vehicles that were seen before, drawn in their own frames and warped; the module's docstring."""

    name = "stp3"
    version = 1
    counts_incomplete = False
    uses_categories = True

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """People and vehicles of the step that were seen now or in the second before."""
        kind = [name.startswith(("human.", "vehicle.")) for name in truths.categories]
        was_seen = truths.seen_before & np.array(kind, np.bool_)
        recorded = truths.ego_future_valid[truths.sample_of]
        return np.asarray(truths.annotated[:, 1:] & was_seen[:, None] & recorded)

    def headings(self, plans_lidar: Floats) -> Floats:
        """Straight ahead at every step."""
        return np.full(plans_lidar.shape[:-1], np.pi / 2)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Verdicts of plans: ``before_mask``, ``recorded``, ``recorded_adversary`` and ``obj_col``."""
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        point = _compute_point_cells(plans)
        inside = ((point >= 0) & (point < CELLS)).all(axis=-1)
        blocks = [
            compute_ego_block(plans),
            compute_ego_block(stacked.ego_future[..., :2]),
            truncate_cells(point)[..., None, :],
        ]
        on_plan, on_recorded, at_point = _find_covered(stacked, blocks, *draw_polygons(self, stacked))
        collision = on_plan & ~on_recorded
        return ProtocolOutcomes(
            collision=collision,
            l2=compute_displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=stacked.ego_future_valid.all(axis=-1) & (stacked.keyframes_before >= KEYFRAMES_BEFORE),
            steps={
                "before_mask": on_plan,
                "recorded": on_recorded,
                "recorded_adversary": self.recorded_contacts(stacked, stacked.adversarial),
                "obj_col": at_point & inside & ~on_recorded,
            },
            facts=self._touched(stacked, collision, blocks[0]),
        )

    def _touched(self, truths: StackedTruths, collision: Bools, block: Cells) -> dict[str, tuple[Any, ...]]:
        """Objects whose warped polygons cover (S, 6, C, 2) cells at (S, 6) colliding steps."""
        objects, steps = np.nonzero(self.counted_objects(truths) & collision[truths.sample_of])
        polygons, places = _draw_objects(truths, objects, steps)
        cells, on_grid = _cells_before_warp(truths, block)
        hit = find_covering_polygons(
            polygons, places, cells.reshape(-1, cells.shape[-2], 2), on_grid.reshape(-1, cells.shape[-2])
        )
        return describe_touched(truths, collision, objects[hit], steps[hit])

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: whether the block touches any counted object asked about on the recorded way."""
        if not among.any():
            return np.zeros(truths.ego_future_valid.shape, dtype=np.bool_)
        block = compute_ego_block(truths.ego_future[..., :2])
        return _find_covered(truths, [block], *draw_polygons(self, truths, among))[0]

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Means over steps up to each horizon: ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``."""
        return average_masked_columns(outcomes, average_up_to)


def draw_polygons(
    definition: STP3Protocol, truths: StackedTruths, among: Bools | None = None
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Corners of counted objects on the grids of their own frames.

    (N, 4, 2) column (left) and row (forward) of each corner, and (N,) the place of each: sample times 6 plus step.
    """
    selected = np.True_ if among is None else among[:, None]
    return _draw_objects(truths, *np.nonzero(definition.counted_objects(truths) & selected))


def _draw_objects(
    truths: StackedTruths, objects: NDArray[np.int64], steps: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """`draw_polygons` of (N,) objects at (N,) steps."""
    samples = truths.sample_of[objects]
    boxes = truths.boxes_in_ego(objects, steps + 1)
    now, then = truths.axle_poses[samples, 0], truths.axle_poses[samples, steps + 1]
    boxes[:, :2] = to_local(to_global(boxes[:, :2], now), then)
    boxes[:, 4] += now[:, 2] - then[:, 2]
    nodes = np.round((box_corners(boxes) + EXTENT_M) / CELL_M)[..., ::-1]
    return np.ascontiguousarray(nodes, np.int32), samples * PLAN_STEPS + steps


def compute_warps(axle_poses: Floats) -> tuple[Singles, Singles, Singles]:
    """The motion that warps each future picture into the present, in single precision as the official code has it.

    Each step between neighbouring keyframes is a motion backwards, made of two single-precision poses, reduced to
    translation and angle, turned round, and then chained. From (S, 7, 3) global x, y, yaw now and at the steps: (S, 6)
    metres forward, metres to the left, and radians of the motion from each future frame.
    """
    poses = _matrices(axle_poses)
    chained = np.broadcast_to(np.eye(3, dtype=np.float32), (len(poses), 3, 3))
    motions = np.empty((3, len(poses), PLAN_STEPS), np.float32)
    for step in range(PLAN_STEPS):
        back = _product(_inverse(poses[:, step + 1]), poses[:, step])
        reduced = np.stack([back[:, 0, 2], back[:, 1, 2], _angle(back)], axis=-1)
        chained = _product(chained, _inverse(_matrices(reduced)))
        motions[:, :, step] = chained[:, 0, 2], chained[:, 1, 2], _angle(chained)
    return motions[0], motions[1], motions[2]


def find_cells_before_warp(
    rows: Cells, columns: Cells, tx: Singles, ty: Singles, angle: Singles
) -> tuple[Cells, Cells]:
    """Cell of the picture in its own frame that a cell of the warped one is taken from, possibly outside the grid.

    Rows are forward, columns left; metres forward and left and radians broadcast against them.
    """
    cos, sin = _single_trigonometry(angle)
    u, v = _CENTRES[columns], _CENTRES[rows]
    half = np.float32(EXTENT_M)
    across = cos * u - sin * v + ty / half
    along = sin * u + cos * v - tx / half
    row, column = (
        ((place + np.float32(1)) * np.float32(CELLS) - np.float32(1)) / np.float32(2) for place in (along, across)
    )
    return np.rint(row).astype(np.int64), np.rint(column).astype(np.int64)


def _find_covered(
    truths: StackedTruths, blocks: Sequence[Cells], polygons: NDArray[np.int32], place_of: NDArray[np.int64]
) -> list[Bools]:
    """For each of some (S, 6, C, 2) cells of the warped picture whether (S, 6) any is covered by polygons."""
    groups, on_grid = zip(*(_cells_before_warp(truths, cells) for cells in blocks))
    covered = find_occupied_cells(polygons, place_of, [cells.reshape(-1, cells.shape[-2], 2) for cells in groups])
    return [(hit.reshape(there.shape) & there).any(axis=-1) for hit, there in zip(covered, on_grid)]


def _cells_before_warp(truths: StackedTruths, cells: Cells) -> tuple[Cells, Bools]:
    """Where (S, 6, C, 2) cells of the warped picture are taken from, squeezed into the grid, and whether they are."""
    source = _unwarp_cells(cells, *compute_warps(truths.axle_poses))
    return np.clip(source, 0, CELLS - 1), ((source >= 0) & (source < CELLS)).all(axis=-1)


def _unwarp_cells(cells: Cells, tx: Singles, ty: Singles, angle: Singles) -> Cells:
    """`find_cells_before_warp` of (S, 6, C, 2) cells by (S, 6) motions."""
    rows, columns = find_cells_before_warp(cells[..., 0], cells[..., 1], tx[..., None], ty[..., None], angle[..., None])
    return np.stack([rows, columns], axis=-1)


def _centres() -> Singles:
    """Cell centres between -1 and 1 as PyTorch's `affine_grid` makes them: from both ends, in single precision."""
    step = np.float64(np.float32(2) / np.float32(CELLS - 1))
    count = np.arange(CELLS // 2)
    line = np.concatenate([-1.0 + step * count, (1.0 - step * count)[::-1]]).astype(np.float32)
    return np.asarray(line * np.float32(CELLS - 1) / np.float32(CELLS), np.float32)


_CENTRES: Final = _centres()


def _single_trigonometry(angle: Singles) -> tuple[Singles, Singles]:
    """Cosine and sine, rounded once."""
    exact = angle.astype(np.float64)
    return np.cos(exact).astype(np.float32), np.sin(exact).astype(np.float32)


def _matrices(poses: Floats | Singles) -> Singles:
    """(..., 3) x, y, yaw as (..., 3, 3) motions in single precision."""
    matrices = np.zeros((*poses.shape[:-1], 3, 3), np.float32)
    cos, sin = np.cos(poses[..., 2].astype(np.float64)), np.sin(poses[..., 2].astype(np.float64))
    matrices[..., 0, 0], matrices[..., 0, 1], matrices[..., 1, 0], matrices[..., 1, 1] = cos, -sin, sin, cos
    matrices[..., :2, 2], matrices[..., 2, 2] = poses[..., :2], 1.0
    return matrices


def _inverse(motions: Singles) -> Singles:
    """Transposed rotation, and the translation turned by it."""
    inverses = motions.copy()
    turn = np.swapaxes(motions[..., :2, :2], -1, -2)
    inverses[..., :2, :2] = turn
    inverses[..., :2, 2] = -(turn[..., 0] * motions[..., 0, 2, None] + turn[..., 1] * motions[..., 1, 2, None])
    return inverses


def _product(first: Singles, second: Singles) -> Singles:
    """Matrix product with one rounding for each further term, as fused multiplication and addition has it.

    A hundred micrometres decide about a cell somewhere, so the roundings are those of the libraries that the official
    code calls: fused for products of matrices, not for a matrix and a vector.
    """
    left, right = first.astype(np.float64), second.astype(np.float64)
    total = np.zeros((*left.shape[:-1], right.shape[-1]), np.float32)
    for term in range(left.shape[-1]):
        total = (left[..., :, term, None] * right[..., None, term, :] + total).astype(np.float32)
    return total


def _angle(motions: Singles) -> Singles:
    return np.arctan2(-motions[..., 0, 1].astype(np.float64), motions[..., 0, 0].astype(np.float64)).astype(np.float32)


def compute_ego_block(waypoints_lidar: Floats) -> Cells:
    """(..., 32, 2) rows (forward) and columns (left) of the ego's block."""
    return truncate_cells(compute_ego_cells(waypoints_lidar * [-1.0, 1.0]))


def _compute_point_cells(waypoints_lidar: Floats) -> Floats:
    """The cell below each waypoint, rounded towards zero."""
    forward_left = waypoints_lidar[..., ::-1] * [1.0, -1.0]
    return np.asarray(np.trunc((forward_left + (EXTENT_M - 0.5 * CELL_M)) / CELL_M))
