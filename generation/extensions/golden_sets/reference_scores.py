"""`challenger-bench verify scoring`, second half: the reference code's score against its own numbers (``ref_*``).

The golden numbers are single precision, everything here is double: verdicts may differ where a point lies on a border
of the raster, or a box touches, within what single precision resolves. These are counted and left out; any other
difference is an error. Sums are held to what single precision leaves of them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.road_map import DrivableRaster
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.reference_scoring import (
    INFLATION,
    SOON_POSES,
    ReferenceContacts,
    ReferenceTerms,
    compute_corner_points,
    compute_reference_terms,
    find_reference_collisions,
)
from generation.search.scoring import ScoringSurroundings, compute_final_scores

TIE: Final = 1e-9
"""Cells from a half-integer raster coordinate, or metres from touching."""
RANK_TIE: Final = 1e-9
"""Final scores nearer than this may change places."""


def is_on_raster_tie(points: Floats, global_to_index: Floats, tie: float = TIE) -> Bools:
    """Whether (..., 2) global points are within ``tie`` cells of a border of raster cells, where rounding decides."""
    coordinate = points @ global_to_index[:, :2].T + global_to_index[:, 2]
    from_border = np.abs(coordinate - np.floor(coordinate) - 0.5)
    return np.asarray((from_border <= tie).any(axis=-1))


def is_touching_tie(box: Floats, others: Floats, reading: CollisionReading) -> bool:
    """Whether limits `TIE` wider or narrower change the verdict on a (5,) box against the (M, 5) that are present."""
    return _is_colliding(box, others, reading, TIE) and not _is_colliding(box, others, reading, -TIE)


def _is_colliding(box: Floats, others: Floats, reading: CollisionReading, slack_m: float) -> bool:
    """The verdict on one box, every limit moved by ``slack_m``."""
    own = box.copy()
    own[2:4] += 2.0 * slack_m
    overlap = boxes_overlap(own, others)
    if reading is CollisionReading.GEOMETRY:
        return bool(overlap.any())
    share = 1.0 if reading is CollisionReading.LITERAL else 0.5
    distance = np.hypot(others[:, 0] - box[0], others[:, 1] - box[1])
    near = share * (box[2:4].min() + others[:, 2:4].min(axis=1)) + slack_m
    far = share * (box[2:4].max() + others[:, 2:4].max(axis=1)) + slack_m
    return bool(((distance < near) | ((distance <= far) & overlap)).any())


def find_out_of_order(ours: Floats, golden: Floats, tie: float) -> NDArray[np.bool_]:
    """Candidates, (B,), that do not score above one whose golden score is lower by more than ``tie``."""
    order = np.argsort(golden, kind="stable")
    ours, golden = ours[order], golden[order]
    highest_so_far = np.concatenate([[-np.inf], np.maximum.accumulate(ours)])
    clearly_lower = np.searchsorted(golden, golden - tie)
    wrong = np.zeros(len(order), np.bool_)
    wrong[order] = ~(highest_so_far[clearly_lower] < ours)
    return wrong


def compare_except_ties(
    comparison: Comparison, quantity: str, differs: Bools, tie: Bools, excused: dict[str, int]
) -> None:
    """Count the verdicts that differ and have no tie to excuse it; ``excused`` counts the others, by quantity."""
    comparison.verdicts(quantity, (differs & ~tie)[~tie])
    excused[quantity] = excused.get(quantity, 0) + int(np.count_nonzero(tie))


SCORED: Final = slice(1, 13)
"""Frames after the planning frame that the paper scores."""


@dataclass(frozen=True, slots=True)
class ScoredFrame:
    """Inputs of the score of B candidates over S frames: (B, S, 3) poses of box centres, and (B, S, 5) boxes.

    `size` is length and width; `affine` (2, 3) goes from global metres to raster coordinates, as the file has it.
    """

    center: Floats
    size: Floats
    boxes: Floats
    around: ScoringSurroundings
    affine: Floats


def read_scored_frame(stored: GoldenArrays) -> ScoredFrame:
    """Inputs of the score of one file, at the scored frames only."""
    center, valid = stored.floats("candidates", None, None, 3)[:, SCORED], stored.verdicts("valid", None, None)
    width, length = stored.floats("adv_width_length", 2)
    boxes = stored.floats("boxes_x_y_heading_width_length", *valid.shape, 5)[SCORED][..., [0, 1, 4, 3, 2]]
    ego = boxes[:, int(stored.integers("ego_index")), :2]
    affine = stored.floats("raster_affine_global_to_index", 2, 3)
    around = ScoringSurroundings(boxes, valid[SCORED], ego, build_golden_raster(stored, affine))
    size = np.array([length, width])
    own = np.concatenate([center[..., :2], np.broadcast_to(size, (*center.shape[:2], 2)), center[..., 2:]], axis=-1)
    return ScoredFrame(center, size, own, around, affine)


def build_golden_raster(stored: GoldenArrays, affine: Floats) -> DrivableRaster:
    """The raster of a file, with the pose and the cell size that its (2, 3) affine map from global metres says."""
    cells = stored.verdicts("raster", None, None)
    count = len(cells)
    scale = float(np.hypot(*affine[1, :2]))
    turned = np.array([[affine[1, 1], -affine[1, 0]], affine[1, :2]])
    if cells.shape != (count, count) or np.abs(affine[:, :2] - turned).max() > 1e-9 * scale:
        raise ValueError("its raster is not square, or its map is more than a turn, a shift and one scale")
    origin = np.linalg.solve(affine[:, :2], count / 2 - affine[:, 2])
    yaw = np.arctan2(affine[1, 1], affine[1, 0])
    return DrivableRaster(cells, np.array([*origin, yaw]), 1.0 / scale)


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
class _ReferenceFrame:
    """Inputs of one file; B candidates, S poses."""

    center: Floats
    size: Floats
    around: ScoringSurroundings
    affine: Floats


def has_reference_scores(stored: GoldenArrays) -> bool:
    """Whether a file of a scoring set has the reference code's numbers."""
    return "ref_col" in stored.names


def compare_reference(comparison: Comparison, stored: GoldenArrays, excused: dict[str, int]) -> None:
    """Compare one file with ``ref_*`` arrays. Verdicts on a tie are counted in ``excused``, by quantity."""
    frame = _read_reference_frame(stored)
    count, hyper = len(frame.center), HyperParameters.reference()
    terms = compute_reference_terms(frame.center, frame.size, frame.around)
    contacts = find_reference_collisions(frame.center, frame.size, frame.around)
    road = _compare_road(comparison, stored, frame, terms, excused)
    free = _compare_contacts(comparison, stored, frame, contacts, excused)
    scores, both = compute_final_scores(terms, np.full(count, hyper.init_least), hyper), road & free
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


def _read_reference_frame(stored: GoldenArrays) -> _ReferenceFrame:
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
    around = ScoringSurroundings(others, present, rear, build_golden_raster(stored, affine))
    return _ReferenceFrame(center[:, :poses], np.array([length, width]), around, affine)


def _compare_road(
    comparison: Comparison, stored: GoldenArrays, frame: _ReferenceFrame, terms: ReferenceTerms, excused: dict[str, int]
) -> Bools:
    """Points off the road; gives back which candidates have no verdict that a tie excuses."""
    shape = frame.center.shape[:2]
    center_off = stored.integers("ref_out_of_road_center", *shape) != 0
    corners_off = stored.integers("ref_corners_out_count", *shape)
    sure = np.ones(len(frame.center), dtype=np.bool_)
    for quantity, differs, points in (
        ("centre off the road", terms.center_off_road != center_off, frame.center[..., None, :2]),
        ("corners off the road", terms.corners_off != corners_off, compute_corner_points(frame.center, frame.size)),
    ):
        tie = differs.copy()
        # Single precision may put a point into the neighbouring cell.
        tie[differs] = is_on_raster_tie(points[differs], frame.affine, CELL_TIE).any(axis=-1)
        compare_except_ties(comparison, quantity, differs, tie, excused)
        sure &= ~tie.any(axis=1)
    return sure


def _compare_contacts(
    comparison: Comparison,
    stored: GoldenArrays,
    frame: _ReferenceFrame,
    contacts: ReferenceContacts,
    excused: dict[str, int],
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
            tie[candidate, pose] = _is_touching_barely(frame, candidate, pose)
        compare_except_ties(comparison, quantity, differs, tie, excused)
        sure &= ~tie.any(axis=1)
    differs = contacts.hits_ego != stored.verdicts("ref_ego_col", count)
    tie = differs.copy()
    for candidate in np.flatnonzero(differs):
        tie[candidate] = any(_is_touching_barely(frame, candidate, pose) for pose in range(min(poses, SOON_POSES)))
    compare_except_ties(comparison, "meets the ego", differs, tie, excused)
    comparison.same("how many boxes are intersected", contacts.tests, stored.integers("ref_n_polygon_tests"))
    return np.asarray(sure & ~tie)


def _is_touching_barely(frame: _ReferenceFrame, candidate: int, pose: int) -> bool:
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
