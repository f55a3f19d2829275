"""The ``vad`` protocol: collision and L2 as VAD's own evaluation counts them ("ST-P3 metric").

Definition:

* Objects are those annotated *now* with a lidar point on them (``use_valid_flag``, which would count radar points too,
  is set for training alone), less than 15 m to the side and 30 m ahead or behind, of the ten detection classes, and in
  VAD's list of category *indices*; each is followed until the first keyframe at which it is not annotated, with the
  size it has now.
* They are drawn on a grid of 200 x 200 half-metre cells whose first row is far ahead, corners rounded to the nearest
  node. The ego is a block of 8 x 4 cells that is never turned, rounded towards zero and squeezed into the grid.
* ``before_mask``, ``recorded`` and ``collision`` (``obj_box_col``) as for ``uniad``. ``obj_col`` asks for one cell.
* Values at 1, 2 and 3 s are means over the steps up to there (of collisions and of displacements). Samples without six
  recorded future keyframes do not count.

The indices mean what the data set's ``category.json`` lists at them. With the table of 32 entries (alphabetical, since
lidarseg) they are all pedestrians and all vehicles: this is ``vad``. With the first table of 23 entries they are cars,
police officers, construction workers, construction vehicles, trailers, barriers and cones: this is ``vad-23``. The code
does not show which of the two the published numbers used.

Version 1 counted objects with nothing but radar points on them too.

Known faults: a car that is farther than 30 m now, or that appears later, cannot be hit. The ego stands about 0.5 m too
far left of what it is compared with. A turning ego is not turned. ``obj_col`` looks 25 m ahead and 25 m to the left of
the ego because of a wrong offset and means nothing.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import CATEGORIES, HORIZON_STEPS
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.protocols.contract import ProtocolOutcomes, average_up_to
from benchmark.protocols.raster import CELL_M, EXTENT_M, RasterProtocol
from benchmark.protocols.stacked_truths import StackedTruths
from benchmark.protocols.uniad import VEHICLES

SIDE_M, AHEAD_M = 15.0, 30.0
"""Half the range in which an object must be now."""

DETECTED: Final = VEHICLES | {
    "human.pedestrian.adult",
    "human.pedestrian.child",
    "human.pedestrian.construction_worker",
    "human.pedestrian.police_officer",
    "movable_object.barrier",
    "movable_object.trafficcone",
}
"""Categories that become one of the ten detection classes; the others are dropped before the indices are looked at."""

COUNTED_32: Final = frozenset(name for name in DETECTED if name.startswith(("human.", "vehicle.")))
"""Detected categories at the indices 2..8 and 14..23 of the table of 32 entries."""

COUNTED_23: Final = frozenset(
    {
        "human.pedestrian.police_officer",
        "human.pedestrian.construction_worker",
        "vehicle.car",
        "vehicle.construction",
        "vehicle.trailer",
        "movable_object.barrier",
        "movable_object.trafficcone",
    }
)
"""Detected categories at the same indices of the first table of 23 entries."""
assert set(CATEGORIES) >= DETECTED >= COUNTED_23


class VADProtocol(RasterProtocol):
    """VAD's protocol, ``vad`` or ``vad-23``: objects near now and followed from there, with means over the steps."""

    version = 2
    counts_incomplete = False
    uses_categories = True
    first_row_ahead = True

    def __init__(self, name: str, categories: frozenset[str]) -> None:
        self.name, self.categories = name, categories

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Objects near now, of a counted category, until their first gap."""
        now = truths.boxes[:, 0]
        near = (np.abs(now[:, 0]) < SIDE_M) & (np.abs(now[:, 1]) < AHEAD_M) & truths.has_lidar_points[:, 0]
        followed = np.logical_and.accumulate(truths.annotated, axis=1)[:, 1:]
        return np.asarray(followed & (near & truths.of_categories(self.categories))[:, None])

    def drawn_boxes(self, truths: StackedTruths, objects: NDArray[np.int64], steps: NDArray[np.int64]) -> Floats:
        """Objects as they are followed: where they are at the step, with the size they have now, (N, 5)."""
        boxes: Floats = truths.boxes[objects, steps + 1]
        boxes[:, 2:4] = truths.boxes[objects, 0, 2:4]
        return boxes

    def drawn_polygons(self, boxes: Floats) -> NDArray[np.int32]:
        """Corners of (N, 5) boxes on the grid, (N, 4, 2)."""
        return round_polygons(boxes)

    def point_cells(self, waypoints_lidar: Floats) -> Floats:
        """The cell that ``obj_col`` looks at by mistake, (S, 6, 2)."""
        # Half of the intended offset: 24.875 m in place of 49.75 m.
        offset = 0.5 * (EXTENT_M - 0.5 * CELL_M)
        turned = np.stack([-waypoints_lidar[..., 1], waypoints_lidar[..., 0]], axis=-1)
        return np.asarray(np.trunc((offset + turned) / CELL_M))

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Means over steps up to each horizon: ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``."""
        return {
            "collision": _means(outcomes.collision),
            "collision_before_mask": _means(outcomes.step("before_mask")),
            "obj_col": _means(outcomes.step("obj_col")),
            "l2": average_up_to(outcomes.l2),
        }


def round_polygons(boxes: Floats) -> NDArray[np.int32]:
    """(N, 4, 2) column and row of each box's corners on the grid, row 0 far ahead, halves to the even node."""
    nodes = np.round((box_corners(boxes) * [1.0, -1.0] + EXTENT_M) / CELL_M)
    return np.asarray(nodes, np.int32)


def _means(verdicts: Bools) -> Floats:
    """Shares of colliding steps; the official code divides in single precision, which is kept."""
    steps = HORIZON_STEPS.values()
    shares = [verdicts[:, :count].sum(axis=1).astype(np.float32) / np.float32(count) for count in steps]
    return np.asarray(np.stack(shares, axis=1), np.float64)
