"""Where a verdict hangs on the last bits, so that two right implementations may differ.

Written for single points and boxes, apart from the kernels that are verified.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.verification.checks import Comparison
from generation.search.hyperparameters import CollisionReading

TIE: Final = 1e-9
"""Cells from a half-integer raster coordinate, or metres from touching."""
RANK_TIE: Final = 1e-9
"""Final scores nearer than this may change places."""


def on_raster_tie(points: Floats, global_to_index: Floats, tie: float = TIE) -> Bools:
    """Whether points lie on the border between two cells, so that rounding decides which one they are in.

    ``points`` are (..., 2) global metres, ``global_to_index`` a (2, 3) affine map to raster coordinates, which are
    rounded to the nearest integer; ``tie`` is in cells.
    """
    coordinate = points @ global_to_index[:, :2].T + global_to_index[:, 2]
    from_border = np.abs(coordinate - np.floor(coordinate) - 0.5)
    return np.asarray((from_border <= tie).any(axis=-1))


def touching_tie(box: Floats, others: Floats, reading: CollisionReading) -> bool:
    """Whether the verdict on one (5,) box with all limits `TIE` wider differs from the one with them `TIE` narrower.

    ``others`` are the (M, 5) boxes that are present.
    """
    return _collides(box, others, reading, TIE) and not _collides(box, others, reading, -TIE)


def _collides(box: Floats, others: Floats, reading: CollisionReading, slack_m: float) -> bool:
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


def out_of_order(ours: Floats, golden: Floats, tie: float) -> NDArray[np.bool_]:
    """Candidates, (B,), that stand behind one that they should be ahead of.

    True where some candidate whose golden score is lower by more than ``tie`` does not score lower.
    """
    order = np.argsort(golden, kind="stable")
    ours, golden = ours[order], golden[order]
    highest_so_far = np.concatenate([[-np.inf], np.maximum.accumulate(ours)])
    clearly_lower = np.searchsorted(golden, golden - tie)
    wrong = np.zeros(len(order), np.bool_)
    wrong[order] = ~(highest_so_far[clearly_lower] < ours)
    return wrong


def compare_but_ties(
    comparison: Comparison, quantity: str, differs: Bools, tie: Bools, excused: dict[str, int]
) -> None:
    """Count the verdicts that differ and have no tie to excuse it; ``excused`` counts the others, by quantity."""
    comparison.verdicts(quantity, (differs & ~tie)[~tie])
    excused[quantity] = excused.get(quantity, 0) + int(np.count_nonzero(tie))
