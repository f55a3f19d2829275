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

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS, PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols import raster
from benchmark.protocols.contract import Outcomes
from benchmark.protocols.raster import CELL_M, CELLS, EXTENT_M, Cells
from benchmark.protocols.stacked import StackedTruths, displacement, stack
from benchmark.truth import SampleTruth

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


class UniAD:
    """See the module's docstring."""

    name = "uniad"
    version = 1
    counts_incomplete = True

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Vehicles that are annotated at the step.

        Args:
            truths: S samples with M objects.

        Returns:
            (M, 6) verdicts.
        """
        recorded = truths.ego_future_valid[truths.sample_of]
        return np.asarray(truths.annotated[:, 1:] & truths.of_categories(VEHICLES)[:, None] & recorded)

    def headings(self, plans_lidar: Floats) -> Floats:
        """Straight ahead at every step.

        Args:
            plans_lidar: (S, 6, 2) waypoints.

        Returns:
            (S, 6) radians.
        """
        return np.full(plans_lidar.shape[:-1], np.pi / 2)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> Outcomes:
        """Judge plans.

        Args:
            truths: S samples.
            plans_lidar: (S, 6, 2) waypoints of the lidar origin, x right, y forward, metres.

        Returns:
            Verdicts with the columns ``before_mask``, ``recorded`` and ``obj_col``.
        """
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        plan, recorded = _block(plans), _block(stacked.ego_future[..., :2])
        point, inside = _point(plans)
        objects, steps = np.nonzero(self.counted_objects(stacked))
        place_of = stacked.sample_of[objects] * PLAN_STEPS + steps
        boxes = stacked.boxes[objects, steps + 1]
        groups = [cells.reshape(-1, cells.shape[-2], 2) for cells in (plan, recorded, point)]
        near = raster.may_reach(boxes, place_of, groups, (boxes[:, 1] + EXTENT_M) / CELL_M)
        found = raster.occupied(polygons(boxes[near]), place_of[near], groups)
        on_plan, on_recorded, at_point = (hit.any(axis=-1).reshape(-1, PLAN_STEPS) for hit in found)
        return Outcomes(
            collision=on_plan & ~on_recorded,
            l2=displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=np.ones(len(truths), dtype=np.bool_),
            steps={"before_mask": on_plan, "recorded": on_recorded, "obj_col": at_point & inside & ~on_recorded},
        )

    def sample_values(self, outcomes: Outcomes) -> dict[str, Floats]:
        """The value at each horizon.

        Args:
            outcomes: S verdicts.

        Returns:
            ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``, each (S, 3).
        """
        at = [count - 1 for count in HORIZON_STEPS.values()]
        return {
            "collision": outcomes.collision[:, at].astype(np.float64),
            "collision_before_mask": outcomes.step("before_mask")[:, at].astype(np.float64),
            "obj_col": outcomes.step("obj_col")[:, at].astype(np.float64),
            "l2": outcomes.l2[:, at],
        }


def polygons(boxes: Floats) -> NDArray[np.int32]:
    """Corners on the grid as the label generation rounds them: in single precision, halves to the even node.

    Args:
        boxes: (N, 5) boxes.

    Returns:
        (N, 4, 2) column and row of each corner.
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


def _block(waypoints: Floats) -> Cells:
    return raster.truncated(raster.ego_cells(waypoints))


def _point(waypoints: Floats) -> tuple[Cells, Bools]:
    """The cell below each waypoint, (S, 6, 1, 2), and whether it is on the grid."""
    cells = np.trunc((waypoints[..., ::-1] + (EXTENT_M - 0.5 * CELL_M)) / CELL_M)
    inside = ((cells >= 0) & (cells < CELLS)).all(axis=-1)
    return raster.truncated(cells)[..., None, :], inside
