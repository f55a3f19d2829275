"""The ``exact`` protocol: oriented boxes, the ego's own heading, every object, between the waypoints too.

Definition:

* The ego is a 4.084 m x 1.85 m rectangle whose centre is 0.5 m ahead of the lidar origin, along its heading. Its
  heading at a waypoint is the direction of the chord between the neighbouring waypoints where that is at least 0.3 m
  long, else the heading before (`benchmark.waypoints.chord_headings`); between waypoints the position is linear and the
  heading takes the shortest arc.
* Every annotated object of every category counts. Between two keyframes it moves linearly and is there only if it is
  annotated at both; at a keyframe it is there if it is annotated there.
* A step collides if the rectangles touch at any of the instants 0.1, 0.2, ... 0.5 s after the step before it.
* A sample collides at a horizon if any step up to it does: contact is not undone by driving on.
* L2 at a horizon is the displacement from the recorded lidar origin at that step; ``ade`` is its mean up to the step.
* Step k is the k-th following keyframe where all of these are 0.4 to 0.6 s apart. Elsewhere it is the time t + 0.5 k,
  at which ego and objects are interpolated; an object is there if it is annotated at the keyframes before and after.
* Samples whose recording ends within 3 s are not counted. A gap of more than 0.75 s between keyframes makes the steps
  in it and beyond it unknown: a sample says nothing at horizons that reach them, and is not counted if that is 1 s.

Version 1 took the k-th following keyframe for step k wherever keyframes were.

Known limits: contact shorter than 0.1 s can be missed; the vertical is ignored; a plan has no heading of its own, so a
car that creeps along a curve in steps of less than 0.3 m keeps its heading.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmark.constants import EGO_LENGTH_M, EGO_WIDTH_M, HORIZON_STEPS, PLAN_STEP_S, PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap, ego_footprints, poses_between, wrap_angle
from benchmark.protocols.contract import ProtocolOutcomes, any_up_to, average_up_to, select_horizons
from benchmark.protocols.raster import ADVERSARY_S, HIT_ADVERSARY
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.truth import SampleTruth
from benchmark.waypoints import chord_headings

INSTANTS_PER_STEP = 5
"""Instants that are checked in each half second; the last one is the waypoint."""
_SAMPLES_AT_ONCE = 256
"""Bounds the memory of one batch: 256 samples of 30 objects need about 40 MB."""


@dataclass(frozen=True, slots=True)
class FirstContact:
    """First contact of a sample.

    Attributes:
        time_s: When, or ``None`` where nothing is touched.
        instance: Touched object; of objects that are touched at the same instant the first by name.
        adversary: Whether that is an adversary.
        adversary_s: When an adversary is first touched, if any is.
    """

    time_s: float | None = None
    instance: str | None = None
    adversary: bool | None = None
    adversary_s: float | None = None


class ExactProtocol:
    """Oriented boxes, every object, between the waypoints too; the module's docstring says all."""

    name = "exact"
    version = 2
    counts_incomplete = False
    goes_by_clock = True
    uses_categories = False

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Everything that is annotated at the step."""
        return truths.annotated[:, 1:]

    def headings(self, plans_lidar: Floats) -> Floats:
        """Chords between the neighbouring waypoints, held where the car hardly moves."""
        return chord_headings(plans_lidar, start_heading_rad=np.pi / 2)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans.

        Returns:
            Verdicts with the column ``waypoint_collision`` (contact at the waypoints alone) and the facts
            ``first_contact_s``, ``hit`` (instance identifier of the object that is touched first), ``hit_adversary``
            (whether that is an adversary) and ``adversary_contact_s`` (when an adversary is first touched, also after
            other objects).
        """
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        truths = [truth.by_clock for truth in truths]
        stacked = stack(truths)
        ego = compute_plan_boxes(plans)
        contact = np.zeros(ego.shape[:2], dtype=np.bool_)
        first: list[FirstContact] = []
        for start in range(0, len(truths), _SAMPLES_AT_ONCE):
            batch = slice(start, start + _SAMPLES_AT_ONCE)
            contact[batch], first_of_batch = find_contacts(ego[batch], truths[batch])
            first.extend(first_of_batch)
        by_step = contact.reshape(-1, PLAN_STEPS, INSTANTS_PER_STEP)
        return ProtocolOutcomes(
            collision=by_step.any(axis=-1),
            l2=compute_displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=stacked.ego_future_valid.all(axis=-1) | _are_cut_short(truths),
            steps={"waypoint_collision": by_step[..., -1]},
            facts={
                "first_contact_s": tuple(first_contact.time_s for first_contact in first),
                "hit": tuple(first_contact.instance for first_contact in first),
                HIT_ADVERSARY: tuple(first_contact.adversary for first_contact in first),
                ADVERSARY_S: tuple(first_contact.adversary_s for first_contact in first),
            },
        )

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Any contact up to the horizon; displacement at the horizon; mean displacement up to it.

        ``collision``, ``l2`` and ``ade``; NaN where a counted sample has unknown steps up to there.
        """
        columns = {
            "collision": any_up_to(outcomes.collision),
            "l2": select_horizons(outcomes.l2),
            "ade": average_up_to(outcomes.l2),
        }
        unknown = any_up_to(np.logical_and(~outcomes.valid, outcomes.counted[:, None])) > 0
        return (
            {name: np.where(unknown, np.nan, values) for name, values in columns.items()} if unknown.any() else columns
        )


def _are_cut_short(truths: Sequence[SampleTruth]) -> Bools:
    """(S,) whether a sample's recording goes on for 3 s, and its first second is known, but not all of the rest is."""
    first = HORIZON_STEPS["1s"]
    return np.array([truth.cut_short and bool(truth.ego_future_valid[:first].all()) for truth in truths], np.bool_)


def evaluate_longer_plans(truths: Sequence[SampleTruth], plans_lidar: Floats) -> tuple[Bools, Floats]:
    """(S, N) contact and (S, N) displacement of plans of N steps, by the same definition.

    ``plans_lidar`` are (S, N, 2) waypoints of the lidar origin, x right, y forward, metres, and the S samples have as
    many steps (`benchmark.datasets.sample_truth.compute_truth`). Displacements are NaN where the recorded ego does not
    exist.
    """
    truths = [truth.by_clock for truth in truths]
    contact, _ = find_contacts(compute_plan_boxes(plans_lidar), truths)
    offset = plans_lidar - np.array([truth.ego_future for truth in truths])[..., :2]
    valid = np.array([truth.ego_future_valid for truth in truths])
    l2 = np.where(valid, np.hypot(offset[..., 0], offset[..., 1]), np.nan)
    return contact.reshape(*plans_lidar.shape[:2], INSTANTS_PER_STEP).any(axis=-1), l2


def compute_plan_boxes(plans_lidar: Floats) -> Floats:
    """(..., 5 N, 5) boxes of the ego at the instants 0.1, 0.2, ... s of a plan: 30 of them for 3 s.

    The (..., N, 2) waypoints are of the lidar origin, x right, y forward, metres.
    """
    plans = np.asarray(plans_lidar, np.float64)
    heading = chord_headings(plans, start_heading_rad=np.pi / 2)
    poses = np.concatenate([plans, heading[..., None]], axis=-1)
    start = np.broadcast_to([0.0, 0.0, np.pi / 2], (*poses.shape[:-2], 1, 3))
    before = np.concatenate([start, poses[..., :-1, :]], axis=-2)
    boxes = interpolate_footprints(before, poses)
    return boxes.reshape(*poses.shape[:-2], poses.shape[-2] * INSTANTS_PER_STEP, 5)


def interpolate_footprints(first: Floats, second: Floats) -> Floats:
    """The ego's rectangle at the five instants of each interval between two poses, the first pose left out.

    (..., 5, 5) instants, then x, y, length, width, yaw. Poses are of the lidar, (..., 3), half a second apart, in any
    frame.
    """
    return ego_footprints(poses_between(first[..., None, :], second[..., None, :], _fractions()))


def interpolate_object_boxes(boxes: Floats, annotated: Bools) -> tuple[Floats, Bools]:
    """(M, 5 (K - 1), 5) boxes of objects at the five instants after each keyframe but the last, and their presence.

    From (M, K, 5) boxes at K keyframes, 7 for a plan, and (M, K) where they are annotated.
    """
    step = np.diff(boxes, axis=1)
    step[..., 4] = wrap_angle(step[..., 4])
    between = boxes[:, :-1, None] + _fractions()[:, None] * step[:, :, None]
    # The keyframe itself is taken as annotated: "start + 1 * difference" need not give it back exactly.
    between[:, :, -1] = boxes[:, 1:]
    present = np.repeat((annotated[:, :-1] & annotated[:, 1:])[..., None], INSTANTS_PER_STEP, axis=-1)
    present[..., -1] = annotated[:, 1:]
    count = (boxes.shape[1] - 1) * INSTANTS_PER_STEP
    return between.reshape(len(boxes), count, 5), present.reshape(len(boxes), count)


def _fractions() -> Floats:
    return np.arange(1, INSTANTS_PER_STEP + 1) / INSTANTS_PER_STEP


def find_contacts(ego: Floats, truths: Sequence[SampleTruth]) -> tuple[Bools, list[FirstContact]]:
    """(S, 30) contacts of any (S, 30, 5) boxes at 0.1 .. 3.0 s with annotated objects, and each sample's first one."""
    boxes = np.concatenate([truth.boxes for truth in truths])
    annotated = np.concatenate([truth.annotated for truth in truths])
    sample_of = np.repeat(np.arange(len(truths)), [len(truth.instances) for truth in truths])
    objects, present = interpolate_object_boxes(boxes, annotated)
    mine = ego[sample_of]
    # Two boxes can only touch if the circles around them do.
    offset = objects[..., :2] - mine[..., :2]
    reach = 0.5 * (np.hypot(objects[..., 2], objects[..., 3]) + np.hypot(EGO_LENGTH_M, EGO_WIDTH_M)) + 1e-6
    near = present & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
    which, instant = np.nonzero(near)
    hit = boxes_overlap(mine[which, instant], objects[which, instant])
    which, instant = which[hit], instant[hit]
    contact = np.zeros(ego.shape[:2], dtype=np.bool_)
    contact[sample_of[which], instant] = True
    names = [name for truth in truths for name in truth.instances]
    first = [FirstContact()] * len(truths)
    # Earliest contact of each sample; ties between objects at one instant are broken by name.
    for sample, at, name in sorted(zip(sample_of[which].tolist(), instant.tolist(), (names[row] for row in which))):
        known, adversary = first[sample], name in truths[sample].adversaries
        if known.time_s is not None and (known.adversary_s is not None or not adversary):
            continue
        time_s = round((at + 1) * PLAN_STEP_S / INSTANTS_PER_STEP, 3)
        if known.time_s is None:
            first[sample] = FirstContact(time_s, name, adversary, time_s if adversary else None)
        else:
            first[sample] = replace(known, adversary_s=time_s)
    return contact, first
