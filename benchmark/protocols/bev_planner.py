"""The ``bev-planner`` protocol: collision, contact with the kerb and L2 as BEV-Planner's own evaluation counts them.

Definition:

* Everything is in the ego frame, x forward, y left. A waypoint is the displacement of the *lidar* along these axes.
* Objects are those annotated at the future keyframe of the step with a lidar or radar point on them there, of the seven
  vehicle classes among the ten of detection (`benchmark.protocols.uniad.VEHICLES`). They are drawn on a grid of 1000 x
  1000 cells of 0.1 m, corners cut off to the cell below.
* The kerb is the edge of the union of road segments and lanes of the present map, each edge as 20 points at equal
  distances joined by lines one cell wide; the same at all six steps.
* The ego is a rectangle of 4.084 m x 1.85 m, 1.486 m ahead of the waypoint, turned by the direction of the step that
  ends there, or not at all if that is shorter than 1 m (`benchmark.protocols.fine_grid`).
* ``before_mask``, ``recorded`` and ``collision`` as for ``uniad``, and ``kerb_before_mask``, ``kerb_recorded`` and
  ``kerb`` the same with the kerb. ``obj_col`` and ``kerb_point`` ask for the single cell below the waypoint, and
  exclude by the rectangle of the recorded ego.
* Values at 1, 2 and 3 s: for ``collision``, ``obj_col`` and ``kerb`` the *maximum* over the steps up to there, that is,
  any contact; for ``kerb_point`` and L2 the *mean*. Samples without six recorded future keyframes do not count; nor do
  samples without a map at the kerb. The official tables also split the samples by command, which ours do not.

Known faults: a maximum is not to be compared with the means of ``vad`` or ``stp3``. Displacements of the lidar are
taken for those of the rear axle, so that a turning car is off by up to 0.94 m. A standing car keeps the heading of the
present, one that creeps on in a curve too. The turned cells are rounded one by one, so the footprint has holes. A kerb
is a line 0.1 m wide: a plan that is wholly beyond it at the waypoints is clean. The distance between two of the 20
points can be metres. Pedestrians cannot be hit. The official command says "right" for a recorded path that ends 2 m to
the left.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols.contract import ProtocolOutcomes, any_up_to, average_up_to
from benchmark.protocols.fine_grid import (
    CELL_M,
    CELLS,
    FIRST_CELL_M,
    MOVING_M,
    FootprintCells,
    PointCells,
    compute_step_headings,
    fill,
    find_touched,
    outline,
)
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.protocols.uniad import VEHICLES
from benchmark.truth import Roads, SampleTruth

_SAMPLES_AT_ONCE = 64
"""Samples whose kerbs are held at the same time."""


class BEVPlannerProtocol:
    """Vehicles and kerbs on a fine grid, with maxima over the steps; the module's docstring says all."""

    name = "bev-planner"
    version = 1
    counts_incomplete = False
    uses_categories = True

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Vehicles with a point on them at the step."""
        recorded = truths.ego_future_valid[truths.sample_of]
        there = truths.annotated[:, 1:] & truths.has_points[:, 1:] & recorded
        return np.asarray(there & truths.of_categories(VEHICLES)[:, None])

    def headings(self, plans_lidar: Floats) -> Floats:
        """Direction of each step of at least a metre, else straight ahead."""
        return compute_step_headings(to_forward_left(plans_lidar), moving_m=MOVING_M) + np.pi / 2

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Verdicts of plans, and the fact ``map`` (whether the sample has one).

        Columns are ``before_mask``, ``recorded``, ``recorded_adversary``, ``obj_col``, ``kerb_before_mask``,
        ``kerb_recorded``, ``kerb`` and ``kerb_point``.
        """
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        paths = [to_forward_left(path) for path in (plans, stacked.ego_future[..., :2])]
        plan, recorded, below = (
            build_footprint(paths[0]),
            build_footprint(paths[1]),
            PointCells(paths[0].reshape(-1, 2), np.float32),
        )
        contacts = find_touched((plan, recorded, below), *draw_polygons(self, stacked), fill)
        on_plan, on_recorded, at_point = (hit.reshape(-1, PLAN_STEPS) for hit in contacts)
        kerb, kerb_recorded, kerb_point = find_kerb_contacts(stacked, *paths)
        return ProtocolOutcomes(
            collision=on_plan & ~on_recorded,
            l2=compute_displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=stacked.ego_future_valid.all(axis=-1),
            steps={
                "before_mask": on_plan,
                "recorded": on_recorded,
                "recorded_adversary": self.recorded_contacts(stacked, stacked.adversarial),
                "obj_col": at_point & ~on_recorded,
                "kerb_before_mask": kerb,
                "kerb_recorded": kerb_recorded,
                "kerb": kerb & ~kerb_recorded,
                "kerb_point": kerb_point & ~kerb_recorded,
            },
            facts={"map": tuple(roads is not None and roads.has_kerbs for roads in stacked.roads)},
        )

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: whether the rectangle touches any counted object asked about on the recorded way."""
        if not among.any():
            return np.zeros(truths.ego_future_valid.shape, dtype=np.bool_)
        cover = build_footprint(to_forward_left(truths.ego_future[..., :2]))
        return find_touched((cover,), *draw_polygons(self, truths, among), fill)[0].reshape(-1, PLAN_STEPS)

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Maxima over the steps up to each horizon, means of L2 and of ``kerb_point``.

        ``collision``, ``collision_before_mask``, ``obj_col``, ``l2``, ``kerb``, ``kerb_before_mask`` and
        ``kerb_point``; those of the kerb are NaN for samples without a map.
        """
        mapped = np.array(outcomes.facts.get("map", ()), np.bool_)[:, None]
        return {
            "collision": any_up_to(outcomes.collision),
            "collision_before_mask": any_up_to(outcomes.step("before_mask")),
            "obj_col": any_up_to(outcomes.step("obj_col")),
            "l2": average_up_to(outcomes.l2),
            "kerb": np.where(mapped, any_up_to(outcomes.step("kerb")), np.nan),
            "kerb_before_mask": np.where(mapped, any_up_to(outcomes.step("kerb_before_mask")), np.nan),
            "kerb_point": np.where(mapped, average_up_to(outcomes.step("kerb_point")), np.nan),
        }


def to_forward_left(waypoints_lidar: Floats) -> Floats:
    """(..., 2) x right, y forward as x forward, y left: the axes are turned, the point is not moved."""
    return np.stack([waypoints_lidar[..., 1], -waypoints_lidar[..., 0]], axis=-1)


def build_footprint(path: Floats) -> FootprintCells:
    """The ego along (S, 6, 2) waypoints, x forward, y left, in single precision."""
    heading = compute_step_headings(path, moving_m=MOVING_M)
    return FootprintCells(path.reshape(-1, 2), heading.reshape(-1), np.float32)


def draw_polygons(
    definition: BEVPlannerProtocol, truths: StackedTruths, among: Bools | None = None
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Corners of counted objects on the grid, in single precision throughout.

    (N, 4, 2) column and row of each corner, and (N,) the place of each: sample times 6 plus step.
    """
    selected = np.True_ if among is None else among[:, None]
    objects, steps = np.nonzero(definition.counted_objects(truths) & selected)
    single = truths.boxes_in_ego(objects, steps + 1).astype(np.float32)
    cos, sin = np.cos(single[:, 4]), np.sin(single[:, 4])
    corners = np.empty((len(single), 4, 2), np.float32)
    for index, (ahead, left) in enumerate(((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))):
        along, across = np.float32(ahead) * single[:, 2], np.float32(left) * single[:, 3]
        corners[:, index, 0] = (along * cos - across * sin) + single[:, 0]
        corners[:, index, 1] = (along * sin + across * cos) + single[:, 1]
    cells = np.trunc((corners - np.float32(FIRST_CELL_M)) / np.float32(CELL_M)).astype(np.int32)
    return cells, truths.sample_of[objects] * PLAN_STEPS + steps


def find_kerb_contacts(truths: StackedTruths, plans: Floats, recorded: Floats) -> list[Bools]:
    """(S, 6) contacts with the kerb: of the plan's rectangle, of the recorded ego's, and of points below the waypoints.

    ``plans`` and ``recorded`` are (S, 6, 2) waypoints, x forward, y left; samples without a map have no kerb. Some
    samples are looked at at a time, so that never all lines are held.
    """
    contacts = [np.zeros(plans.shape[:2], dtype=np.bool_) for _ in range(3)]
    for start in range(0, len(plans), _SAMPLES_AT_ONCE):
        some = slice(start, start + _SAMPLES_AT_ONCE)
        path = plans[some]
        looked_at = (
            build_footprint(path),
            build_footprint(recorded[some]),
            PointCells(path.reshape(-1, 2), np.float32),
        )
        lines, place_of = _collect_kerbs(truths.roads[some], looked_at)
        for verdicts, hit in zip(contacts, find_touched(looked_at, lines, place_of, outline)):
            verdicts[some] = hit.reshape(-1, PLAN_STEPS)
    return contacts


def _collect_kerbs(
    roads: Sequence[Roads | None], looked_at: Sequence[FootprintCells | PointCells]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """(N, 2, 2) lines of the kerbs around samples at six steps that anything comes near, and (N,) the place of each."""
    bounds = [tuple(bound.reshape(-1, PLAN_STEPS, 2) for bound in one.bounds()) for one in looked_at]
    low = np.min([first.min(axis=1) for first, _ in bounds], axis=0) - 1
    high = np.max([last.max(axis=1) for _, last in bounds], axis=0) + 1
    none = np.zeros((0, 2, 2), np.int32)
    parts = [none if around is None or not around.has_kerbs else compute_kerb_cells(around) for around in roads]
    lines, sample_of = np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    first, last = (turn(lines[:, 0], lines[:, 1])[:, ::-1] for turn in (np.minimum, np.maximum))
    near = ((first <= high[sample_of]) & (last >= low[sample_of])).all(axis=-1)
    places = sample_of[near] * PLAN_STEPS + np.arange(PLAN_STEPS)[:, None]
    return np.tile(lines[near], (PLAN_STEPS, 1, 1)), places.reshape(-1)


def compute_kerb_cells(roads: Roads) -> NDArray[np.int32]:
    """(N, 2, 2) column and row of both ends of every line of the kerb; what is off the grid is squeezed onto it."""
    points = roads.kerb_lines().astype(np.float32)
    cells = (points - np.float32(FIRST_CELL_M)) / np.float32(CELL_M)
    indices = np.trunc(np.clip(cells, 0, CELLS - 1)).astype(np.int32)
    return np.asarray(np.stack([indices[:, :-1], indices[:, 1:]], axis=2).reshape(-1, 2, 2))
