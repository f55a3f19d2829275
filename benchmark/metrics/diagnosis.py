"""Why a plan collides: was the other not seen, expected elsewhere, or driven into where it was expected?

The rule, for a sample that collides under ``exact``, about the object that is touched first:

1. *no forecasts*: the planner gives none. The collision is **not attributable**.
2. The object's forecast is looked for. Objects and forecasts are matched one to one, nearest centres first, where the
   object is first annotated: objects annotated now with the forecasts' present boxes, then those that appear at a
   later keyframe with where the forecasts left over expect to be at that time. A forecast is near if its centre lies
   within `MATCH_WITHIN_M` of the object's centre (of a long object: of its axis, `MATCH_WITHIN_M` away from its
   ends) and the areas of the two boxes differ by no more than a factor of `LARGEST_AREA_RATIO`.
   *no forecast near*: **unseen**. The planner did not know of the object.
3. *plan hits forecast*: at any time up to the end of the plan, in the most likely mode. The planner drove into what it
   expected: **misplanned**.
4. *plan clear of forecast*: **misforecast**. Where another mode with a probability of at least `LIKELY` would have
   been hit, the reason says so.

Contact is that of ``exact``: the same ego rectangle, the same instants. The forecast is a box of its own size; its
heading is that of its path (`benchmark.waypoints.chord_headings`), held below 1 m/s, and a box has no front, so one
that backs up is not turned round.
"""

from collections.abc import Sequence
from enum import StrEnum
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.protocols.contract import ProtocolOutcomes
from benchmark.protocols.exact import compute_plan_boxes, interpolate_object_boxes
from benchmark.records import row_schema
from benchmark.records.row_schema import Cause, DiagnosisRow
from benchmark.truth import SampleTruth
from benchmark.waypoints import chord_headings, points_in_lidar

MATCH_WITHIN_M: Final = 2.0
"""Farthest centre of a forecast that may be of an object: where nuScenes matches for its tracking metrics."""
LARGEST_AREA_RATIO: Final = 4.0
"""Between a walker and a car it is about 18, between a car and a rigid bus 3.7."""
LIKELY: Final = 0.2
"""Above the 1/6 that a model with six modes gives each when it knows nothing."""
HOLD_BELOW_M: Final = 1.0
"""Shortest chord (over a second) that turns a forecast box: forecasts of parked cars drift, and to any side."""


class DiagnosisReason(StrEnum):
    """Which case of the rule a collision is."""

    CLEAR = "plan clear of forecast"
    CLEAR_OF_LIKELIEST = "plan clear of forecast, hits another likely mode"
    HITS = "plan hits forecast"
    NOT_NEAR = row_schema.NOT_NEAR
    NONE = "no forecasts"

    @property
    def cause(self) -> Cause:
        """The verdict that follows."""
        return _CAUSE_OF[self]


_CAUSE_OF: Final[dict[DiagnosisReason, Cause]] = {
    DiagnosisReason.CLEAR: "misforecast",
    DiagnosisReason.CLEAR_OF_LIKELIEST: "misforecast",
    DiagnosisReason.HITS: "misplanned",
    DiagnosisReason.NOT_NEAR: "unseen",
    DiagnosisReason.NONE: "not attributable",
}


def diagnose(
    truths: Sequence[SampleTruth], plans: Sequence[Plan], exact: ProtocolOutcomes
) -> list[DiagnosisRow | None]:
    """Say of each colliding sample why it collides; ``None`` where nothing is touched.

    Plans are in their own frame, with their forecasts. Samples whose recording ends early are diagnosed too, though no
    rate counts them.
    """
    if not len(exact):
        return []
    contacts = zip(truths, plans, exact.facts["hit"], exact.facts["first_contact_s"], strict=True)
    return [
        None if hit is None else _diagnose_plan(truth, plan, hit, seconds) for truth, plan, hit, seconds in contacts
    ]


def to_lidar_frame(forecasts: Forecasts, frame: PlanFrame, lidar_ahead_m: float) -> Forecasts:
    """Forecasts in the lidar frame of the sample, x right, y forward, by a rigid motion: a plan moves its own point.

    ``lidar_ahead_m`` is the lidar origin ahead of the rear axle.
    """
    if frame is PlanFrame.LIDAR:
        return forecasts
    boxes = np.asarray(forecasts.boxes, np.float64).reshape(-1, 5).copy()
    boxes[:, :2] = points_in_lidar(boxes[:, :2], lidar_ahead_m)
    boxes[:, 4] += np.pi / 2
    trajectories = points_in_lidar(np.asarray(forecasts.trajectories, np.float64), lidar_ahead_m)
    return Forecasts(boxes, trajectories, forecasts.scores)


def build_forecast_boxes(box: Floats, trajectories: Floats) -> Floats:
    """(M, 30, 5) boxes of a forecast at 0.1, 0.2, ... 3.0 s, of the present size, turned along the path.

    ``trajectories`` are (M, 6, 2) centres at the plan's steps.
    """
    box, trajectories = np.asarray(box, np.float64), np.asarray(trajectories, np.float64)
    chords = chord_headings(trajectories - box[:2], start_heading_rad=box[4], hold_below_m=HOLD_BELOW_M)
    turns = np.diff(chords, axis=-1, prepend=box[4])
    keyframes = np.tile(box, (len(trajectories), PLAN_STEPS + 1, 1))
    keyframes[:, 1:, :2] = trajectories
    # A rectangle is symmetric under half a turn, and a car that reverses must not be flipped.
    keyframes[:, 1:, 4] += np.cumsum(turns - np.pi * np.round(turns / np.pi), axis=-1)
    return interpolate_object_boxes(keyframes, np.ones(keyframes.shape[:2], dtype=np.bool_))[0]


def match_forecasts(truth: SampleTruth, forecasts: Forecasts) -> dict[str, int]:
    """Row of the forecast, in the lidar frame, by instance, by step 2 of the rule; objects without one are left out."""
    if not len(truth.instances) or not len(forecasts.boxes):
        return {}
    first_step = truth.annotated.argmax(axis=1)
    objects = truth.boxes[np.arange(len(first_step)), first_step]
    present, likeliest = forecasts.boxes[:, None, :2], np.argmax(forecasts.scores, axis=1)
    centres = np.concatenate([present, forecasts.trajectories[np.arange(len(likeliest)), likeliest]], axis=1)
    offset = np.swapaxes(centres[:, first_step], 0, 1) - objects[:, None, :2]
    pairs = np.argwhere(_are_near(offset, objects) & _are_alike(objects, forecasts.boxes))
    distance = np.hypot(offset[..., 0], offset[..., 1])
    ranked = sorted(
        (int(first_step[row]), float(distance[row, column]), truth.instances[row], int(column)) for row, column in pairs
    )
    matched: dict[str, int] = {}
    taken: set[int] = set()
    for _, _, instance, column in ranked:
        if instance not in matched and column not in taken:
            matched[instance] = column
            taken.add(column)
    return matched


def _diagnose_plan(truth: SampleTruth, plan: Plan, hit: str, first_contact_s: float) -> DiagnosisRow:
    reason = _find_reason(truth, plan, hit)
    return DiagnosisRow(cause=reason.cause, reason=reason.value, hit=hit, first_contact_s=first_contact_s)


def _find_reason(truth: SampleTruth, plan: Plan, hit: str) -> DiagnosisReason:
    if plan.forecasts is None:
        return DiagnosisReason.NONE
    forecasts = to_lidar_frame(plan.forecasts, plan.frame, truth.lidar_ahead_m)
    row = match_forecasts(truth, forecasts).get(hit)
    if row is None:
        return DiagnosisReason.NOT_NEAR
    ego = compute_plan_boxes(plan.waypoints_in_lidar(truth.lidar_ahead_m))
    hits: Bools = boxes_overlap(ego, build_forecast_boxes(forecasts.boxes[row], forecasts.trajectories[row])).any(
        axis=-1
    )
    scores = forecasts.scores[row]
    if hits[np.argmax(scores)]:
        return DiagnosisReason.HITS
    return DiagnosisReason.CLEAR_OF_LIKELIEST if (hits & (scores >= LIKELY)).any() else DiagnosisReason.CLEAR


def _are_near(offset: Floats, objects: Floats) -> Bools:
    """(M, A) whether offsets (M, A, 2) from the objects' centres are small enough."""
    cos, sin = np.cos(objects[:, None, 4]), np.sin(objects[:, None, 4])
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin)
    across = offset[..., 1] * cos - offset[..., 0] * sin
    half_axis = np.maximum(0.5 * objects[:, None, 2] - MATCH_WITHIN_M, 0.0)
    return np.asarray(np.hypot(np.maximum(along - half_axis, 0.0), across) <= MATCH_WITHIN_M)


def _are_alike(objects: Floats, boxes: Floats) -> Bools:
    """(M, A) whether boxes may be of the same kind of thing."""
    area, other = (objects[:, 2] * objects[:, 3])[:, None], boxes[:, 2] * boxes[:, 3]
    return np.asarray((area <= LARGEST_AREA_RATIO * other) & (other <= LARGEST_AREA_RATIO * area))
