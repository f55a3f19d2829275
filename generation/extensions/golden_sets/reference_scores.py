"""`challenger-bench verify scoring`, second half: the reference code's score against its own numbers (``ref_*``).

The golden numbers are single precision, and here everything is double. So verdicts may differ where a point lies on a
border of the raster, or a box touches, to within what single precision resolves; these are counted and left out, and
any other difference is an error. Sums are held to what single precision leaves of them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays
from generation.extensions.golden_sets.scored_frame import golden_raster
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

ROAD_TOLERANCE: Final = 2e-6
COLLISION_TOLERANCE: Final = 1.4e-6
CHALLENGE_TOLERANCE: Final = 2e-5
FINAL_TOLERANCE: Final = 5 * ROAD_TOLERANCE + 10 * COLLISION_TOLERANCE + CHALLENGE_TOLERANCE
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
    """Compare one file.

    Args:
        comparison: Takes the results.
        stored: A file with ``ref_*`` arrays.
        excused: Verdicts on a tie are counted here, by quantity.

    Raises:
        InputError: If arrays are absent or do not fit each other.
    """
    frame, where = _read(stored), stored.path.name
    count = len(frame.center)
    terms = reference_terms(frame.center, frame.size, frame.around)
    contacts = reference_collisions(frame.center, frame.size, frame.around)
    road = _compare_road(comparison, stored, frame, terms, excused)
    free = _compare_contacts(comparison, stored, frame, contacts, excused)
    comparison.numbers(
        "reference: drivable area term",
        terms.dac[road],
        stored.floats("ref_dac", count)[road],
        ROAD_TOLERANCE,
        where=where,
    )
    comparison.numbers(
        "reference: collision term",
        terms.cr[free],
        stored.floats("ref_cr", count)[free],
        COLLISION_TOLERANCE,
        where=where,
    )
    challenge, golden = terms.challenges([terms])[0], stored.floats("ref_ac", count)
    comparison.numbers("reference: challenge", challenge[free], golden[free], CHALLENGE_TOLERANCE, where=where)
    sure, hyper = road & free, HyperParameters.reference()
    ours = final_scores(terms, np.full(count, hyper.init_least), hyper)[sure]
    wanted = stored.floats("ref_final_without_noise", count)[sure]
    comparison.numbers("reference: final score", ours, wanted, FINAL_TOLERANCE, where=where)
    order = np.argsort(wanted, kind="stable")
    behind = np.maximum.accumulate(ours[order]) > ours[order] + SCORE_TIE
    comparison.verdicts("reference: ranking", behind, where=where)
    start = stored.floats("ref_final_with_noise", count)[sure] - wanted
    noise = (start < -FINAL_TOLERANCE) | (start > MOST_START + FINAL_TOLERANCE)
    comparison.verdicts("reference: random start outside 0 to 0.001", noise, where=where)


def _read(stored: GoldenArrays) -> _Frame:
    center = stored.floats("candidates", None, None, 3)
    boxes = stored.floats("ref_boxes_x_y_z_w_l_h_yawmm", None, None, 7)
    poses, row = len(stored.verdicts("ref_col", None, len(center))), int(stored.integers("ref_adv_row"))
    if not (poses <= center.shape[1] and len(boxes) == poses and 0 <= row < boxes.shape[1] - 1):
        raise InputError(
            f"{stored.path} has {center.shape[1]} poses, reference boxes at {len(boxes)}, verdicts at {poses}, or no "
            f"row {row} among {boxes.shape[1]} boxes; make the file again"
        )
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
    count, poses = frame.center.shape[:2]
    center_off = stored.integers("ref_out_of_road_center", count, poses) != 0
    corners_off = stored.integers("ref_corners_out_count", count, poses)
    sure = np.ones(count, dtype=np.bool_)
    for quantity, differs, points in (
        ("reference: centre off the road", terms.center_off_road != center_off, frame.center[..., None, :2]),
        ("reference: corners off the road", terms.corners_off != corners_off, corner_points(frame.center, frame.size)),
    ):
        tie = differs.copy()
        tie[differs] = _near_a_border(points[differs], frame.affine).any(axis=-1)
        _verdicts(comparison, quantity, differs, tie, excused, stored.path.name)
        sure &= ~tie.any(axis=1)
    return sure


def _near_a_border(points: Floats, affine: Floats) -> Bools:
    """(...) whether single precision may put a point into the neighbouring cell."""
    coordinate = points @ affine[:, :2].T + affine[:, 2]
    from_border = np.abs(coordinate - np.floor(coordinate) - 0.5)
    return np.asarray((from_border <= CELL_TIE).any(axis=-1))


def _compare_contacts(
    comparison: Comparison, stored: GoldenArrays, frame: _Frame, contacts: ReferenceContacts, excused: dict[str, int]
) -> Bools:
    """Collisions; gives back which candidates have no verdict that a tie excuses."""
    count, poses = frame.center.shape[:2]
    sure = np.ones(count, dtype=np.bool_)
    for quantity, ours, name in (
        ("reference: nearer than half the short edges", contacts.sure, "ref_must_col"),
        ("reference: collision", contacts.collision, "ref_col"),
    ):
        differs = ours != stored.verdicts(name, poses, count).T
        tie = differs.copy()
        for candidate, pose in np.argwhere(differs):
            tie[candidate, pose] = _touches_barely(frame, candidate, pose)
        _verdicts(comparison, quantity, differs, tie, excused, stored.path.name)
        sure &= ~tie.any(axis=1)
    differs = contacts.hits_ego != stored.verdicts("ref_ego_col", count)
    tie = differs.copy()
    for candidate in np.flatnonzero(differs):
        tie[candidate] = any(_touches_barely(frame, candidate, pose) for pose in range(min(poses, SOON_POSES)))
    _verdicts(comparison, "reference: meets the ego", differs, tie, excused, stored.path.name)
    other_tests = np.array([contacts.tests != int(stored.integers("ref_n_polygon_tests"))])
    comparison.verdicts("reference: how many boxes are intersected", other_tests, where=stored.path.name)
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


def _verdicts(
    comparison: Comparison, quantity: str, differs: Bools, tie: Bools, excused: dict[str, int], where: str
) -> None:
    """Count the verdicts that differ and have no tie to excuse it."""
    comparison.verdicts(quantity, (differs & ~tie)[~tie], where=where)
    excused[quantity] = excused.get(quantity, 0) + int(np.count_nonzero(tie))
