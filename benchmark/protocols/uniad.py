"""The ``uniad`` protocol: collision and L2 as UniAD's own evaluation counts them.

Definition:

* Objects are those annotated at the future keyframe of the step, of eight vehicle categories; each counts even if no
  sensor point hit it. They are drawn on a grid of 200 x 200 half-metre cells, corners rounded to the nearest node.
* The ego is a block of 8 x 4 cells at the waypoint, its cells rounded towards zero and squeezed into the grid. It is
  never turned: it always looks in the direction of the present.
* ``before_mask`` is a step at which the block covers an occupied cell; ``recorded`` is the same for the recorded ego;
  ``collision`` (``obj_box_col``, what papers quote) is the first without the second. ``obj_col`` asks for the single
  cell below the waypoint, but excludes by the block of the recorded ego.
* Values at 1, 2 and 3 s are those of that very step. Every sample counts, also where the recording ends before 3 s:
  steps after its end add no collision and no displacement but stay in the denominator.

Known faults: pedestrians, cones, barriers and emergency vehicles cannot be hit. The two roundings differ, so the ego
stands about 0.5 m too far left and to the rear of what it is compared with: false alarms there, misses right and ahead.
An ego that leaves the grid is squashed on its border. A turning ego is not turned. A collision is forgotten at the next
step, and the end of a scene dilutes the rates (by about 15 % at 3 s).
"""

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.protocols.contract import ProtocolOutcomes, average_masked_columns, select_horizons
from benchmark.protocols.raster import CELL_M, EXTENT_M, RasterProtocol
from benchmark.protocols.stacked_truths import StackedTruths

VEHICLES = frozenset(
    {
        "vehicle.car",
        "vehicle.bus.bendy",
        "vehicle.bus.rigid",
        "vehicle.construction",
        "vehicle.bicycle",
        "vehicle.motorcycle",
        "vehicle.truck",
        "vehicle.trailer",
    }
)
"""Categories that become one of the seven vehicle classes among the ten detection classes (`only_vehicle=True`)."""


class UniADProtocol(RasterProtocol):
    """Vehicles alone, with the values at the very steps; the module's docstring says all."""

    name = "uniad"
    version = 1
    counts_incomplete = True
    uses_categories = True
    first_row_ahead = False

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Vehicles that are annotated at the step."""
        recorded = truths.ego_future_valid[truths.sample_of]
        return np.asarray(truths.annotated[:, 1:] & truths.of_categories(VEHICLES)[:, None] & recorded)

    def drawn_boxes(self, truths: StackedTruths, objects: NDArray[np.int64], steps: NDArray[np.int64]) -> Floats:
        """Objects where and as large as they are annotated at the step, (N, 5)."""
        return np.asarray(truths.boxes[objects, steps + 1])

    def drawn_polygons(self, boxes: Floats) -> NDArray[np.int32]:
        """Corners of (N, 5) boxes on the grid, (N, 4, 2)."""
        return round_polygons(boxes)

    def point_cells(self, waypoints_lidar: Floats) -> Floats:
        """The cell below each waypoint, (S, 6, 2)."""
        return np.asarray(np.trunc((waypoints_lidar[..., ::-1] + (EXTENT_M - 0.5 * CELL_M)) / CELL_M))

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Values at each horizon: ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``."""
        return average_masked_columns(outcomes, select_horizons)


def round_polygons(boxes: Floats) -> NDArray[np.int32]:
    """(N, 4, 2) column and row of corners on the grid as label generation rounds them.

    In single precision, halves to the even node.
    """
    single = np.asarray(boxes).astype(np.float32)
    cos, sin = np.cos(single[:, 4]), np.sin(single[:, 4])
    half_length, half_width = np.float32(0.5) * single[:, 2], np.float32(0.5) * single[:, 3]
    corners = np.empty((len(single), 4, 2), np.float32)
    for index, (ahead, left) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        along, across = np.float32(ahead) * half_length, np.float32(left) * half_width
        corners[:, index, 0] = (along * cos - across * sin) + single[:, 0]
        corners[:, index, 1] = (along * sin + across * cos) + single[:, 1]
    return np.asarray(np.round((corners + np.float32(EXTENT_M)) / np.float32(CELL_M)), np.int32)
