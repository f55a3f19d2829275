"""The protocols ``sparsedrive`` and ``diffusiondrive``: collision and L2 as SparseDrive's own evaluation counts them.

Definition:

* Objects are all that are annotated at the future keyframe of the step with at least one lidar point on them there, of
  every category, at any distance.
* The ego is the 4.084 m x 1.85 m rectangle, centre 0.5 m ahead of the waypoint along the plan's heading: straight ahead
  at all steps if the first and the last waypoint are less than 0.5 m apart, else the direction from the waypoint before
  to the waypoint after (from the last but one to the last at the end). Polygons that touch collide.
* ``before_mask`` is a step at which it collides; ``recorded`` is the same for the recorded waypoints with the same rule
  for their heading; ``collision`` (``obj_box_col``, what papers quote) is the first without the second. The official
  ``obj_col`` is ``recorded`` itself, not a property of the plan.
* A value at 1, 2 or 3 s is the mean over the steps up to there, of collisions and of displacements. Samples without six
  recorded future keyframes do not count.

Known faults: a plan of a nearly standing car that jitters turns the box at will; one that turns back and ends where it
began keeps looking ahead; reversing puts the box 0.5 m behind. Objects without a lidar point vanish, so an adversary
written with a count of 0 cannot be hit. Nothing is checked between the waypoints.

DiffusionDrive's nuScenes branch evaluates in the same way.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_LENGTH_M, EGO_WIDTH_M, PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap, directions_of, ego_footprints
from benchmark.protocols.contract import ProtocolOutcomes, average_up_to
from benchmark.protocols.raster import describe_touched
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.truth import SampleTruth

STANDING_M = 0.5
"""First and last waypoint closer than this: the heading is taken as straight ahead."""


class SparseDriveProtocol:
    """SparseDrive's protocol, ``sparsedrive`` or the name of one that is the same: see the module's docstring."""

    version = 1
    counts_incomplete = False
    uses_categories = False

    def __init__(self, name: str = "sparsedrive") -> None:
        self.name = name

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Objects with a lidar point at the step."""
        return truths.annotated[:, 1:] & truths.has_lidar_points[:, 1:]

    def headings(self, plans_lidar: Floats) -> Floats:
        """Central differences of the waypoints, or straight ahead throughout."""
        # The official code holds waypoints in single precision.
        plans = np.asarray(plans_lidar).astype(np.float32)
        standing = np.linalg.norm(plans[:, -1] - plans[:, 0], axis=-1) < STANDING_M
        path = np.concatenate([np.zeros((len(plans), 1, 2)), plans], axis=1)
        ahead = np.concatenate([path[:, 2:], path[:, -1:]], axis=1)
        step = ahead - path[:, :-1]
        return np.where(standing[:, None], np.pi / 2, directions_of(step))

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans. Verdicts with the columns ``before_mask``, ``recorded`` and ``recorded_adversary``."""
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        objects = self.counted_objects(stacked)
        pairs = find_contact_pairs(stacked, objects, plans, self.headings(plans))
        on_plan = _mark_steps(stacked, pairs) & stacked.ego_future_valid
        on_recorded = self.recorded_contacts(stacked, np.ones_like(stacked.adversarial))
        collision = on_plan & ~on_recorded
        return ProtocolOutcomes(
            collision=collision,
            l2=compute_displacement(plans, stacked),
            valid=stacked.ego_future_valid,
            counted=stacked.ego_future_valid.all(axis=-1),
            steps={
                "before_mask": on_plan,
                "recorded": on_recorded,
                "recorded_adversary": self.recorded_contacts(stacked, stacked.adversarial),
            },
            facts=describe_touched(stacked, collision, *pairs),
        )

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: whether the rectangle touches any counted object asked about on the recorded way."""
        objects, waypoints = self.counted_objects(truths) & among[:, None], truths.ego_future[..., :2]
        return find_waypoint_contacts(truths, objects, waypoints, self.headings(waypoints)) & truths.ego_future_valid

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Means over the steps up to each horizon: ``collision``, ``collision_before_mask`` and ``l2``."""
        return {
            "collision": average_up_to(outcomes.collision),
            "collision_before_mask": average_up_to(outcomes.step("before_mask")),
            "l2": average_up_to(outcomes.l2),
        }


def find_waypoint_contacts(truths: StackedTruths, objects: Bools, plans_lidar: Floats, heading_rad: Floats) -> Bools:
    """(S, 6) whether the ego's rectangle touches a counted object at each waypoint.

    ``objects`` is (M, 6), which of M objects count; ``plans_lidar`` (S, 6, 2) metres, ``heading_rad`` (S, 6).
    """
    return _mark_steps(truths, find_contact_pairs(truths, objects, plans_lidar, heading_rad))


def find_contact_pairs(
    truths: StackedTruths, objects: Bools, plans_lidar: Floats, heading_rad: Floats
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(N,) objects and (N,) steps of the contacts in `find_waypoint_contacts`, whose arguments it takes."""
    ego = ego_footprints(np.concatenate([plans_lidar, heading_rad[..., None]], axis=-1))
    which, step = np.nonzero(objects)
    mine, theirs = ego[truths.sample_of[which], step], truths.boxes[which, step + 1]
    # Two boxes can only touch if the circles around them do.
    offset = theirs[:, :2] - mine[:, :2]
    reach = 0.5 * (np.hypot(theirs[:, 2], theirs[:, 3]) + np.hypot(EGO_LENGTH_M, EGO_WIDTH_M)) + 1e-6
    near = (offset**2).sum(axis=-1) <= reach**2
    hit = boxes_overlap(mine[near], theirs[near])
    return which[near][hit], step[near][hit]


def _mark_steps(truths: StackedTruths, pairs: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Bools:
    """(S, 6) steps at which any object is touched."""
    contact = np.zeros(truths.ego_future_valid.shape, dtype=np.bool_)
    contact[truths.sample_of[pairs[0]], pairs[1]] = True
    return contact


class DiffusionDriveProtocol(SparseDriveProtocol):
    """The evaluation of DiffusionDrive's nuScenes branch, the same as SparseDrive's."""

    def __init__(self) -> None:
        super().__init__("diffusiondrive")
