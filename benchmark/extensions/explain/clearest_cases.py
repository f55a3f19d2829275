"""Among evaluated samples, the one that shows each cause of disagreement best."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from benchmark.errors import InputError
from benchmark.geometry import Floats, box_corners, box_gap, ego_footprints
from benchmark.metrics.disagreement import CAUSES, COUNTERFACTUALS, EXACT, FALSE_ALARM, MISS, compute_counterfactuals
from benchmark.planning import Plan, PlanFrame
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.exact import INSTANTS_PER_STEP, compute_plan_boxes, interpolate_object_boxes
from benchmark.protocols.stacked_truths import stack
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord
from benchmark.truth import SampleTruth

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

CASES_LOOKED_AT = 60
"""For each protocol and cause; they are spread evenly over the samples that show it."""


@dataclass(frozen=True, slots=True)
class DisagreementCase:
    """One sample on which a protocol and ``exact`` disagree by one of `CAUSES`, at the step, 0 to 5, that makes it.

    `plan_lidar` is (6, 2) metres. `clearness` is square metres of overlap that are missed, or metres of air that are
    taken for a collision or that are left at the waypoints around a contact.
    """

    planner: str
    protocol: str
    cause: str
    truth: SampleTruth
    plan_lidar: Floats
    step: int
    clearness: float


def find_clearest_cases(records: Sequence[RunRecord], data: "DataSet") -> list[DisagreementCase]:
    """Clearest case of each cause with a row for each protocol, in the order of `PROTOCOLS` and `CAUSES`."""
    truths: dict[str, dict[str, SampleTruth]] = {}
    cases = []
    for protocol in PROTOCOLS:
        for cause in CAUSES:
            best: DisagreementCase | None = None
            for planner, row in _find_samples(records, protocol, cause):
                if row.scene not in truths:
                    truths[row.scene] = {truth.sample_token: truth for truth in data.truth(row.scene)}
                if row.sample_token not in truths[row.scene]:
                    raise InputError(
                        f"{data.root} has no sample {row.sample_token} in {row.scene}, but the run of {planner} does; "
                        "name the data set of that run"
                    )
                truth = truths[row.scene][row.sample_token]
                case = build_case(planner, protocol, truth, plan_in_lidar(row, truth))
                if case is not None and case.cause == cause and (best is None or case.clearness > best.clearness):
                    best = case
            cases += [] if best is None else [best]
    return cases


def _find_samples(records: Sequence[RunRecord], protocol: str, cause: str) -> list[tuple[str, SampleRow]]:
    """Planner and row of samples that show a cause, few enough to look at."""
    rows = [
        (record.planner, row)
        for record in sorted(records, key=lambda record: record.planner)
        for row in record.rows
        if row.disagreements.get(protocol) == cause
    ]
    if len(rows) <= CASES_LOOKED_AT:
        return rows
    return [rows[at] for at in np.linspace(0, len(rows) - 1, CASES_LOOKED_AT).round().astype(int).tolist()]


def plan_in_lidar(row: SampleRow, truth: SampleTruth) -> Floats:
    """Plan of a row in the lidar frame, which protocols read: (6, 2) metres."""
    if row.plan is None:
        raise ValueError(f"sample {row.sample_token} has no plan")
    return Plan(np.array(row.plan.waypoints), PlanFrame(row.plan.frame)).waypoints_in_lidar(truth.lidar_ahead_m)


def build_case(planner: str, protocol: str, truth: SampleTruth, plan_lidar: Floats) -> DisagreementCase | None:
    """A sample as a case, at the step that shows the cause best; ``plan_lidar`` is (6, 2) metres.

    ``None`` if the protocol and ``exact`` agree or do not both count the sample.
    """
    definition, plans = PROTOCOLS[protocol], plan_lidar[None]
    exact, official = (
        protocol_definition.evaluate([truth], plans) for protocol_definition in (PROTOCOLS[EXACT], definition)
    )
    if not (exact.counted[0] and official.counted[0]):
        return None
    rungs = compute_counterfactuals(definition, stack([truth]), plans, exact, official)
    (cause,) = rungs.causes()
    if cause is None:
        return None
    steps = np.flatnonzero(rungs.decisive_steps()[0]).tolist()
    if cause.startswith(FALSE_ALARM) and "at_step" in official.steps:
        # A latched flag stays up after its cause is gone.
        steps = [step for step in steps if official.step("at_step")[0, step]] or steps
    clearness = {step: _clearness(cause, protocol, truth, plan_lidar, step) for step in steps}
    step = max(steps, key=lambda step: (clearness[step], -step))
    return DisagreementCase(planner, protocol, cause, truth, plan_lidar, step, clearness[step])


def find_contact_instant(truth: SampleTruth, plan_lidar: Floats, step: int) -> int:
    """Instant of a step (0 to 5) at which the plan overlaps the others most: 0 to 29 for 0.1 s, 0.2 s, ... 3.0 s."""
    instants = range(step * INSTANTS_PER_STEP, (step + 1) * INSTANTS_PER_STEP)
    return max(instants, key=lambda instant: (_overlap_m2(truth, plan_lidar, instant), instant))


def waypoint_instant(step: int) -> int:
    """The instant of a step's waypoint, the last of the step, 0 to 29."""
    return (step + 1) * INSTANTS_PER_STEP - 1


def select_objects(truth: SampleTruth, instant: int) -> tuple[Floats, list[int]]:
    """Objects at an instant (0 to 29, a tenth of a second each): (N, 5) boxes and their numbers in the truth."""
    boxes, present = interpolate_object_boxes(truth.boxes, truth.annotated)
    there = np.flatnonzero(present[:, instant])
    return boxes[there, instant], there.tolist()


def ego_rectangle(waypoint: Floats, heading_rad: float) -> Floats:
    """The ego's (5,) box at one waypoint, a (2,) lidar origin in metres."""
    return ego_footprints(np.array([*waypoint, heading_rad]))


def _clearness(cause: str, protocol: str, truth: SampleTruth, plan_lidar: Floats, step: int) -> float:
    at_waypoint = waypoint_instant(step)
    if cause == f"{MISS}: {COUNTERFACTUALS[0]}":
        hit = _find_overlapped(truth, plan_lidar, find_contact_instant(truth, plan_lidar, step))
        around = [instant for instant in (at_waypoint - INSTANTS_PER_STEP, at_waypoint) if instant >= 0]
        return min(
            (_gap_m(truth, compute_plan_boxes(plan_lidar)[instant], instant, hit) for instant in around), default=0.0
        )
    if cause.startswith(MISS):
        return _overlap_m2(truth, plan_lidar, at_waypoint)
    definition = PROTOCOLS[protocol]
    counted = set(np.flatnonzero(definition.counted_objects(stack([truth]))[:, step]).tolist())
    air = _gap_m(truth, compute_plan_boxes(plan_lidar)[at_waypoint], at_waypoint, counted)
    if cause.endswith("heading"):
        return air
    # Artefacts of the raster alone show best where the ego's heading does not matter.
    turned = ego_rectangle(plan_lidar[step], float(definition.headings(plan_lidar[None])[0, step]))
    return min(air, _gap_m(truth, turned, at_waypoint, counted))


def _find_overlapped(truth: SampleTruth, plan_lidar: Floats, instant: int) -> set[int]:
    boxes, numbers = select_objects(truth, instant)
    ego = compute_plan_boxes(plan_lidar)[instant]
    return {number for number, gap in zip(numbers, box_gap(ego, boxes).tolist()) if gap == 0.0}


def _gap_m(truth: SampleTruth, ego: Floats, instant: int, objects: set[int]) -> float:
    boxes, numbers = select_objects(truth, instant)
    gaps = box_gap(ego, boxes).tolist()
    return min((gap for number, gap in zip(numbers, gaps) if number in objects), default=0.0)


def _overlap_m2(truth: SampleTruth, plan_lidar: Floats, instant: int) -> float:
    boxes, _ = select_objects(truth, instant)
    if not len(boxes):
        return 0.0
    ego = shapely.Polygon(box_corners(compute_plan_boxes(plan_lidar)[instant]))
    return float(shapely.area(shapely.intersection(ego, shapely.polygons(box_corners(boxes)))).max())
