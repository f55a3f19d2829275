"""`challenger-bench verify scoring`, second half: the reference code's score against its own numbers (``ref_*``).

The golden numbers are single precision, and here everything is double. So verdicts may differ where a point lies on a
border of the raster, or a box touches, to within what single precision resolves; these are counted and left out, and
any other difference is an error. Sums are held to what single precision leaves of them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays
from generation.extensions.golden_sets.scored_frame import golden_raster
from generation.extensions.golden_sets.ties import compare_but_ties, on_raster_tie
from generation.search.hyperparameters import HyperParameters
from generation.search.reference_scoring import (
    INFLATION,
    SOON_POSES,
    ReferenceContacts,
    ReferenceTerms,
    corner_points,
    reference_collisions,
    reference_terms,
)
from generation.search.scoring import Surroundings, final_scores

_ROAD, _COLLISION, _CHALLENGE = 2e-6, 1.4e-6, 2e-5
FINAL_TOLERANCE: Final = 5 * _ROAD + 10 * _COLLISION + _CHALLENGE
QUANTITIES: Final = {
    "reference: drivable area term": _ROAD,
    "reference: collision term": _COLLISION,
    "reference: challenge": _CHALLENGE,
    "reference: final score": FINAL_TOLERANCE,
}
SCORE_TIE: Final = 2 * FINAL_TOLERANCE
CELL_TIE: Final = 1e-2
"""Cells from a border: coordinates of some 1,000 m have 6e-5 m in single precision and go through two inverses."""
TOUCH_TIE_M: Final = 1e-3
"""Metres from touching."""
MOST_START: Final = 1e-3 + 1e-6
"""Largest random start of a score."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """Inputs of one file; B candidates, S poses."""

    center: Floats
    size: Floats
    around: Surroundings
    affine: Floats


def has_reference_scores(stored: GoldenArrays) -> bool:
    """Whether a file of a scoring set has the reference code's numbers."""
    return "ref_col" in stored.names


def compare_reference(comparison: Comparison, stored: GoldenArrays, excused: dict[str, int]) -> None:
    """Compare one file with ``ref_*`` arrays. Verdicts on a tie are counted in ``excused``, by quantity."""
    frame = _read(stored)
    count, hyper = len(frame.center), HyperParameters.reference()
    terms = reference_terms(frame.center, frame.size, frame.around)
    contacts = reference_collisions(frame.center, frame.size, frame.around)
    road = _compare_road(comparison, stored, frame, terms, excused)
    free = _compare_contacts(comparison, stored, frame, contacts, excused)
    scores, both = final_scores(terms, np.full(count, hyper.init_least), hyper), road & free
    numbers = {
        "drivable area term": (terms.dac, "ref_dac", road),
        "collision term": (terms.cr, "ref_cr", free),
        "challenge": (terms.challenges([terms])[0], "ref_ac", free),
        "final score": (scores, "ref_final_without_noise", both),
    }
    for quantity, (ours, name, sure) in numbers.items():
        comparison.numbers(quantity, ours[sure], stored.floats(name, count)[sure])
    wanted, ours = stored.floats("ref_final_without_noise", count)[both], scores[both]
    order = np.argsort(wanted, kind="stable")
    comparison.verdicts("ranking", np.maximum.accumulate(ours[order]) > ours[order] + SCORE_TIE)
    start = stored.floats("ref_final_with_noise", count)[both] - wanted
    noise = (start < -FINAL_TOLERANCE) | (start > MOST_START + FINAL_TOLERANCE)
    comparison.verdicts("random start outside 0 to 0.001", noise)


def _read(stored: GoldenArrays) -> _Frame:
    center = stored.floats("candidates", None, None, 3)
    boxes = stored.floats("ref_boxes_x_y_z_w_l_h_yawmm", None, None, 7)
    poses, row = len(boxes), int(stored.integers("ref_adv_row"))
    affine = stored.floats("raster_affine_global_to_index", 2, 3)
    others = np.delete(boxes, row, axis=1)[..., [0, 1, 4, 3, 6]]
    others[..., 4] = -others[..., 4] - 0.5 * np.pi
    # Objects that are absent are boxes without a size, which the reference code tests like any other.
    present = np.ones(others.shape[:2], dtype=np.bool_)
    rear = stored.floats("ref_ego_rear_xy", poses, 2)
    width, length = stored.floats("adv_width_length", 2)
    around = Surroundings(others, present, rear, golden_raster(stored, affine))
    return _Frame(center[:, :poses], np.array([length, width]), around, affine)


def _compare_road(
    comparison: Comparison, stored: GoldenArrays, frame: _Frame, terms: ReferenceTerms, excused: dict[str, int]
) -> Bools:
    """Points off the road; gives back which candidates have no verdict that a tie excuses."""
    shape = frame.center.shape[:2]
    center_off = stored.integers("ref_out_of_road_center", *shape) != 0
    corners_off = stored.integers("ref_corners_out_count", *shape)
    sure = np.ones(len(frame.center), dtype=np.bool_)
    for quantity, differs, points in (
        ("centre off the road", terms.center_off_road != center_off, frame.center[..., None, :2]),
        ("corners off the road", terms.corners_off != corners_off, corner_points(frame.center, frame.size)),
    ):
        tie = differs.copy()
        # Single precision may put a point into the neighbouring cell.
        tie[differs] = on_raster_tie(points[differs], frame.affine, CELL_TIE).any(axis=-1)
        compare_but_ties(comparison, quantity, differs, tie, excused)
        sure &= ~tie.any(axis=1)
    return sure


def _compare_contacts(
    comparison: Comparison, stored: GoldenArrays, frame: _Frame, contacts: ReferenceContacts, excused: dict[str, int]
) -> Bools:
    """Collisions; gives back which candidates have no verdict that a tie excuses."""
    count, poses = frame.center.shape[:2]
    sure = np.ones(count, dtype=np.bool_)
    for quantity, ours, name in (
        ("nearer than half the short edges", contacts.sure, "ref_must_col"),
        ("collision", contacts.collision, "ref_col"),
    ):
        differs = ours != stored.verdicts(name, poses, count).T
        tie = differs.copy()
        for candidate, pose in np.argwhere(differs):
            tie[candidate, pose] = _touches_barely(frame, candidate, pose)
        compare_but_ties(comparison, quantity, differs, tie, excused)
        sure &= ~tie.any(axis=1)
    differs = contacts.hits_ego != stored.verdicts("ref_ego_col", count)
    tie = differs.copy()
    for candidate in np.flatnonzero(differs):
        tie[candidate] = any(_touches_barely(frame, candidate, pose) for pose in range(min(poses, SOON_POSES)))
    compare_but_ties(comparison, "meets the ego", differs, tie, excused)
    comparison.same("how many boxes are intersected", contacts.tests, stored.integers("ref_n_polygon_tests"))
    return np.asarray(sure & ~tie)


def _touches_barely(frame: _Frame, candidate: int, pose: int) -> bool:
    """Whether `TOUCH_TIE_M` more or less air changes any verdict on a candidate at a pose."""
    x, y, yaw = frame.center[candidate, pose]
    others = frame.around.boxes[pose]
    distance = np.hypot(others[:, 0] - x, others[:, 1] - y)
    shorts = 0.5 * (frame.size.min() + others[:, 2:4].min(axis=1))
    longs = 0.5 * (frame.size.max() + others[:, 2:4].max(axis=1))
    if (np.minimum(np.abs(distance - shorts), np.abs(distance - longs)) <= TOUCH_TIE_M).any():
        return True
    wide, narrow = (
        np.array([x, y, *(INFLATION * frame.size + 2.0 * slack), yaw]) for slack in (TOUCH_TIE_M, -TOUCH_TIE_M)
    )
    return bool((boxes_overlap(wide, others) != boxes_overlap(narrow, others)).any())
