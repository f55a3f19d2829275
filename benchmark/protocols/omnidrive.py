"""The ``omnidrive`` protocol: collision, leaving the drivable area and L2 as OmniDrive's own evaluation counts them.

Definition:

* The ego frame, x forward, y left; waypoints of the *rear axle*. A plan is text there: numbers have two decimals, and
  what is within a hundredth of zero becomes zero. Plans of ours are moved from the lidar to the rear axle along their
  own headings (those of ``exact``) and written so.
* Objects are the vehicles of every kind that are annotated *now*, each followed until the first keyframe at which it is
  not annotated, with the size it has now. They are drawn on a grid of 1000 x 1000 cells of 0.1 m, corners rounded to
  the nearest node. No sensor points are asked for, and there is no range.
* The ego is the rectangle of ``bev-planner`` with its headings. ``before_mask``, ``recorded`` and ``collision`` as for
  ``uniad``.
* ``off_road`` is a step at which a rectangle of 4.08 m x 1.85 m has a cell that is not drivable in the present map. Its
  centre is 1.486 m from the waypoint along the direction of the *present*; it is turned about this centre by the
  direction of the step, however short that is. There is no exclusion by the recorded ego, but samples whose rectangle
  is off the road now do not count as leaving it.
* Values at 1, 2 and 3 s: for ``collision`` and ``off_road`` the *maximum* over the steps up to there, that is, any
  contact; for L2 the mean. Samples without six recorded future keyframes do not count; nor do samples without a map for
  ``off_road``.

Known faults: a maximum is not to be compared with the means of ``vad`` or ``stp3``. The rectangle that may not leave
the road is turned at random by a standing car's jitter of millimetres, unless the rounding of the text hides it:
unrounded, half of the standing plans leave the road. Who appears later, and pedestrians, cannot be hit. The two
rectangles are not equally long and not equally placed. Between two waypoints nothing is looked at.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_WIDTH_M, PLAN_STEPS, VEHICLE_CATEGORIES
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.protocols.contract import ProtocolOutcomes, any_up_to, average_up_to
from benchmark.protocols.fine_grid import (
    CELL_M,
    CELLS,
    CENTER_AHEAD_M,
    MOVING_M,
    FootprintCells,
    compute_step_headings,
    fill,
    find_touched,
)
from benchmark.protocols.stacked_truths import StackedTruths, stack
from benchmark.truth import Roads, SampleTruth
from benchmark.waypoints import chord_headings

HALF_M: Final = 50.0
KERB_LENGTH_M: Final = 4.08
_REACH_M: Final = 2.5
"""The whole rectangle lies within this of its centre, roundings included."""
_SILENT: Final = 0.01
"""Numbers of the text that are no larger are written as zero."""


class OmniDriveProtocol:
    """Vehicles of now on a fine grid and the drivable area, with maxima; the module's docstring says all."""

    name = "omnidrive"
    version = 1
    counts_incomplete = False
    uses_categories = True

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Vehicles that are annotated now, until their first gap."""
        followed = np.logical_and.accumulate(truths.annotated, axis=1)[:, 1:]
        return np.asarray(followed & truths.of_categories(_VEHICLES)[:, None])

    def headings(self, plans_lidar: Floats) -> Floats:
        """Direction of each step of at least a metre, else straight ahead; of the written plan."""
        path = round_to_text(to_axle_path(np.asarray(plans_lidar, np.float64), np.zeros(len(plans_lidar))))
        return compute_step_headings(path, moving_m=MOVING_M) + np.pi / 2

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Verdicts of plans, and the fact ``on_road_now``, null where the sample has no map.

        Columns are ``before_mask``, ``recorded``, ``recorded_adversary`` and ``off_road``. Distances are those of the
        rear axle.
        """
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        return self.judged(stacked, round_to_text(to_axle_path(plans, stacked.ahead_m)), stacked.axle_future)

    def judged(self, truths: StackedTruths, path: Floats, recorded: Floats) -> ProtocolOutcomes:
        """Judge (S, 6, 2) plans and recording of the rear axle, x forward, y left, metres, as `evaluate` does."""
        covers = [build_footprint(path), build_footprint(recorded)]
        contacts = find_touched(covers, *draw_polygons(self, truths), fill)
        on_plan, on_recorded = (hit.reshape(-1, PLAN_STEPS) for hit in contacts)
        offset, valid = path - recorded, truths.ego_future_valid
        off_road, now = find_road_departures(truths, path)
        return ProtocolOutcomes(
            collision=on_plan & ~on_recorded,
            l2=np.where(valid, np.hypot(offset[..., 0], offset[..., 1]), 0.0),
            valid=valid,
            counted=valid.all(axis=-1),
            steps={
                "before_mask": on_plan,
                "recorded": on_recorded,
                "recorded_adversary": self._touched(truths, recorded, truths.adversarial),
                "off_road": off_road,
            },
            facts={"on_road_now": now},
        )

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: whether the rectangle touches any counted object asked about on the recorded way."""
        return self._touched(truths, truths.axle_future, among)

    def _touched(self, truths: StackedTruths, path: Floats, among: Bools) -> Bools:
        """Where (S, 6, 2) waypoints of the rear axle put the ego on some of M objects."""
        if not among.any():
            return np.zeros(truths.ego_future_valid.shape, dtype=np.bool_)
        polygons, place_of = draw_polygons(self, truths, among)
        return find_touched((build_footprint(path),), polygons, place_of, fill)[0].reshape(-1, PLAN_STEPS)

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Maxima over the steps up to each horizon, means of L2.

        Columns are ``collision``, ``collision_before_mask``, ``l2`` and ``off_road``; the last is NaN for samples
        without a map.
        """
        on_road = np.array(outcomes.facts.get("on_road_now", ()), np.float64)[:, None]
        return {
            "collision": any_up_to(outcomes.collision),
            "collision_before_mask": any_up_to(outcomes.step("before_mask")),
            "l2": average_up_to(outcomes.l2),
            "off_road": any_up_to(outcomes.step("off_road")) * on_road,
        }


_VEHICLES: Final = frozenset(VEHICLE_CATEGORIES)


def to_axle_path(plans_lidar: Floats, ahead_m: Floats) -> Floats:
    """Plans of the lidar, x right, y forward, as plans of the rear axle, x forward, y left; all in metres.

    Moved along the heading of each step by the distance of the lidar origin ahead of the rear axle.
    """
    heading = chord_headings(plans_lidar, start_heading_rad=np.pi / 2) - np.pi / 2
    ahead = ahead_m[:, None]
    x = plans_lidar[..., 1] + ahead - ahead * np.cos(heading)
    y = -plans_lidar[..., 0] - ahead * np.sin(heading)
    return np.stack([x, y], axis=-1)


def round_to_text(path: Floats) -> Floats:
    """Waypoints as the text has them: metres in whole hundredths."""
    rounded = np.round(path, 2)
    return np.where(np.abs(rounded) <= _SILENT, 0.0, rounded)


def build_footprint(path: Floats) -> FootprintCells:
    """The ego along (S, 6, 2) waypoints, x forward, y left."""
    heading = compute_step_headings(path, moving_m=MOVING_M)
    return FootprintCells(path.reshape(-1, 2), heading.reshape(-1), np.float64)


def draw_polygons(
    definition: OmniDriveProtocol, truths: StackedTruths, among: Bools | None = None
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """(N, 4, 2) column and row of counted objects' corners on the grid, and (N,) places: sample times 6 plus step."""
    selected = np.True_ if among is None else among[:, None]
    objects, steps = np.nonzero(definition.counted_objects(truths) & selected)
    boxes = truths.boxes_in_ego(objects, steps + 1)
    boxes[:, 2:4] = truths.boxes[objects, 0, 2:4]
    return _round_to_nodes(boxes), truths.sample_of[objects] * PLAN_STEPS + steps


def find_road_departures(truths: StackedTruths, path: Floats) -> tuple[Bools, tuple[float | None, ...]]:
    """(S, 6) whether the ego's rectangle has a cell that is not drivable, and for each sample if it is on the road.

    The latter is of now: 1, 0, or ``None`` without a map. ``path`` are (S, 6, 2) waypoints of the rear axle, x forward,
    y left. One raster exists at a time.
    """
    heading = compute_step_headings(path, moving_m=0.0)
    start = np.zeros((len(path), 1, 3))
    poses = np.concatenate([start, np.concatenate([path, heading[..., None]], axis=-1)], axis=1)
    center = poses[..., :2] + [CENTER_AHEAD_M, 0.0]
    size = np.broadcast_to([KERB_LENGTH_M, EGO_WIDTH_M], center.shape)
    boxes = np.concatenate([center, size, poses[..., 2:]], axis=-1)
    off_road = np.zeros(path.shape[:2], dtype=np.bool_)
    grid = np.zeros((CELLS, CELLS), np.uint8)
    now: list[float | None] = []
    for sample, roads in enumerate(truths.roads):
        if roads is None:
            now.append(None)
            continue
        off = _find_off_road(roads, boxes[sample], grid)
        off_road[sample] = off[1:]
        now.append(float(not off[0]))
    return off_road, tuple(now)


def _find_off_road(roads: Roads, boxes: Floats, grid: NDArray[np.uint8]) -> Bools:
    """(K,) whether boxes in the ego frame have a cell that is not drivable; drawn only where that is in doubt.

    ``grid`` is empty, and is so again afterwards.
    """
    doubt = np.flatnonzero(~roads.surely_drivable(boxes[:, :2], _REACH_M))
    off = np.zeros(len(boxes), dtype=np.bool_)
    if not len(doubt):
        return off
    drivable = roads.drivable_cells()
    for place, corners in zip(doubt.tolist(), _round_to_nodes(boxes[doubt])):
        cv2.fillPoly(grid, [corners], (1,))
        (left, top), (right, bottom) = np.maximum(corners.min(axis=0), 0), np.maximum(corners.max(axis=0) + 1, 0)
        window = (slice(top, bottom), slice(left, right))
        off[place] = (grid[window] > drivable[window]).any()
        grid[window] = 0
    return off


def _round_to_nodes(boxes: Floats) -> NDArray[np.int32]:
    """(N, 4, 2) column and row of the corners, rounded to the nearest node."""
    return np.asarray(np.round((box_corners(boxes) + HALF_M) / CELL_M), np.int32)
