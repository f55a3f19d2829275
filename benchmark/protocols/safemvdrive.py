"""The protocols ``safemvdrive``, ``safemvdrive-box`` and ``safemvdrive-box-all``: SafeMVDrive's evaluations.

``safemvdrive`` is its public snapshot, on UniAD's rasters:

* Objects, cells and block are those of ``uniad``. A sample whose *recorded* ego collides at the first step, or has no
  first step, counts for nothing. In the others nothing is excluded: ``at_step`` is UniAD's flag before the mask, and
  ``collision`` is *latched*: from the first flag on all later steps collide. ``obj_col`` is UniAD's, with its
  exclusion, not latched.
* Values at 1, 2 and 3 s are those of the step, which for the latched flags means any contact up to there. Incomplete
  samples count.

``safemvdrive-box`` is the later metric file:

* Boxes and headings are those of ``sparsedrive``. A sample counts if its recording goes on for 3 s and the ego does not
  touch a box *now*. ``at_step`` and ``collision`` as above. ``safemvdrive-box-all`` takes boxes without lidar points
  too, which is what its own data set comes to, whichever way it does it.
* The official program prints the sum of the latched flags twice: over the samples, which is ``collision`` here, and
  over 41, the number of scenes that it was written for, which is no rate and not computed here.

Known faults: those of ``uniad`` or ``sparsedrive``; without an exclusion every error of annotation counts, and latched
to the end. Latched flags are never to be compared with values at a step or with means. Officially the displacements of
left-out samples stay in the sum of L2 while the samples leave the denominator, so that it comes out a little too large;
here they leave both.
"""

from collections.abc import Sequence

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, boxes_overlap, ego_footprints
from benchmark.protocols.contract import ProtocolOutcomes, select_horizons
from benchmark.protocols.sparsedrive import SparseDriveProtocol, find_waypoint_contacts
from benchmark.protocols.stacked_truths import StackedTruths, compute_displacement, stack
from benchmark.protocols.uniad import UniADProtocol
from benchmark.truth import SampleTruth


class SafeMVDriveProtocol:
    """UniAD's flags, latched; the module's docstring says all. Rasters and flags are those of ``uniad``."""

    name = "safemvdrive"
    version = 1
    counts_incomplete = True
    uses_categories = True

    def __init__(self) -> None:
        self.uniad = UniADProtocol()

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Those of ``uniad``."""
        return self.uniad.counted_objects(truths)

    def headings(self, plans_lidar: Floats) -> Floats:
        """Straight ahead at every step."""
        return self.uniad.headings(plans_lidar)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans. Verdicts with the columns ``at_step``, ``obj_col`` and those of a mask (`_latch_outcomes`)."""
        judged = self.uniad.evaluate(truths, plans_lidar)
        columns = {"at_step": judged.step("before_mask"), "obj_col": judged.step("obj_col")}
        recorded = (judged.step("recorded"), judged.step("recorded_adversary"))
        out, for_adversary = (hit.reshape(-1, PLAN_STEPS)[:, 0] for hit in recorded)
        return _latch_outcomes(columns, judged.l2, judged.valid, judged.valid[:, 0], out, for_adversary)

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: all steps, if the recorded ego touches a counted object asked about at the first."""
        first = self.uniad.recorded_contacts(truths, among)[:, :1]
        return np.asarray(first & truths.ego_future_valid)

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """The latched flag at each horizon. Columns are ``collision``, ``obj_col`` and ``l2``."""
        return {
            "collision": select_horizons(outcomes.collision),
            "obj_col": select_horizons(outcomes.step("obj_col")),
            "l2": select_horizons(outcomes.l2),
        }


class SafeMVDriveBoxProtocol:
    """SparseDrive's polygons without an exclusion, latched.

    ``safemvdrive-box`` leaves out boxes without lidar points, ``safemvdrive-box-all`` does not.
    """

    version = 1
    counts_incomplete = False
    uses_categories = False

    def __init__(self, name: str, *, needs_points: bool) -> None:
        self.name, self.needs_points = name, needs_points
        self._sparsedrive = SparseDriveProtocol()

    def counted_objects(self, truths: StackedTruths) -> Bools:
        """Everything that is annotated at the step, with a lidar point on it where those are asked for."""
        return self._find_present(truths)[:, 1:]

    def headings(self, plans_lidar: Floats) -> Floats:
        """Those of ``sparsedrive``."""
        return self._sparsedrive.headings(plans_lidar)

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans. Verdicts with the column ``at_step`` and those of a mask (`_latch_outcomes`)."""
        plans = np.asarray(plans_lidar, np.float64).reshape(-1, PLAN_STEPS, 2)
        stacked = stack(truths)
        flags = find_waypoint_contacts(stacked, self.counted_objects(stacked), plans, self.headings(plans))
        valid = stacked.ego_future_valid
        out, for_adversary = (
            self._find_touched_now(stacked, among) for among in (np.ones_like(stacked.adversarial), stacked.adversarial)
        )
        columns = {"at_step": flags & valid}
        return _latch_outcomes(
            columns, compute_displacement(plans, stacked), valid, valid.all(axis=-1), out, for_adversary
        )

    def recorded_contacts(self, truths: StackedTruths, among: Bools) -> Bools:
        """Ground-truth check: all steps of samples whose ego touches the box of a counted object asked about now."""
        return np.asarray(self._find_touched_now(truths, among)[:, None] & truths.ego_future_valid)

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """The latched flag at each horizon. Columns are ``collision`` and ``l2``."""
        return {"collision": select_horizons(outcomes.collision), "l2": select_horizons(outcomes.l2)}

    def _find_present(self, truths: StackedTruths) -> Bools:
        """(M, 7) which objects are there now and at the steps."""
        return truths.annotated & truths.has_lidar_points if self.needs_points else truths.annotated

    def _find_touched_now(self, truths: StackedTruths, among: Bools) -> Bools:
        """(S,) whether the ego touches a box of some of M objects now, straight ahead at the origin."""
        ego = ego_footprints(np.array([0.0, 0.0, np.pi / 2]))
        there = np.flatnonzero(self._find_present(truths)[:, 0] & among)
        touched = np.zeros(len(truths.ego_future), dtype=np.bool_)
        touched[truths.sample_of[there[boxes_overlap(ego, truths.boxes[there, 0])]]] = True
        return touched


def _latch_outcomes(
    columns: dict[str, Bools], l2: Floats, valid: Bools, fit: Bools, out: Bools, for_adversary: Bools
) -> ProtocolOutcomes:
    """Verdicts in which every step after the first flag collides; samples that do not count have none.

    What is masked here are whole samples: ``before_mask`` are the latched flags of all, ``recorded`` and
    ``recorded_adversary`` are the steps of those that are left out because of the recorded ego, and the fact
    ``left_out`` says which would count if it were not for that.

    ``columns`` are (S, 6), among them ``at_step``; ``fit`` is (S,), long enough to count; ``out`` (S,) and
    ``for_adversary`` (S,) say whose recorded ego collides where the protocol looks, with anything or an adversary.
    """
    latched = np.logical_or.accumulate(columns["at_step"].reshape(-1, PLAN_STEPS), axis=1)
    counted = fit & ~out
    return ProtocolOutcomes(
        collision=latched & counted[:, None],
        l2=l2,
        valid=valid,
        counted=counted,
        steps={
            **columns,
            "before_mask": latched,
            "recorded": out[:, None] & valid,
            "recorded_adversary": for_adversary[:, None] & valid,
        },
        facts={"left_out": tuple((fit & out).tolist())},
    )
