"""Inputs of one golden scoring file: candidates, what is around them, and the drivable raster."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from benchmark.verification.golden import GoldenArrays
from generation.search.scoring import Surroundings

SCORED: Final = slice(1, 13)
"""Frames after the planning frame that the paper scores."""


@dataclass(frozen=True, slots=True)
class ScoredFrame:
    """What the score of a file's candidates is made of; B candidates, S frames.

    Attributes:
        center: (B, S, 3) poses of the candidates' box centres.
        size: (2,) length and width.
        boxes: (B, S, 5) the candidates as boxes.
        around: Objects, ego and drivable raster.
        affine: (2, 3) from global metres to raster coordinates, as the file has it.
    """

    center: Floats
    size: Floats
    boxes: Floats
    around: Surroundings
    affine: Floats


def read_scored_frame(stored: GoldenArrays) -> ScoredFrame:
    """Inputs of the score.

    Args:
        stored: One file of a scoring set.

    Returns:
        They, at the scored frames only.

    Raises:
        InputError: If arrays are absent or do not fit each other.
    """
    center = stored.floats("candidates", None, None, 3)
    width, length = stored.floats("adv_width_length", 2)
    valid = stored.verdicts("valid", None, None)
    if center.shape[1] < SCORED.stop or valid.shape[0] < SCORED.stop or not len(center):
        raise InputError(
            f"{stored.path} has {len(center)} candidates over {center.shape[1]} frames and objects over "
            f"{valid.shape[0]}; the score needs the planning frame and the 12 after it"
        )
    center, valid = center[:, SCORED], valid[SCORED]
    boxes = stored.floats("boxes_x_y_heading_width_length", None, valid.shape[1], 5)[SCORED][..., [0, 1, 4, 3, 2]]
    ego = int(stored.integers("ego_index"))
    if boxes.shape[:2] != valid.shape or not 0 <= ego < valid.shape[1] or not valid[:, ego].all():
        raise InputError(f"the objects in {stored.path} do not fit each other, or the ego is absent; make it again")
    affine = stored.floats("raster_affine_global_to_index", 2, 3)
    around = Surroundings(boxes, valid, boxes[:, ego, :2], golden_raster(stored, affine))
    size = np.array([length, width])
    own = np.concatenate([center[..., :2], np.broadcast_to(size, (*center.shape[:2], 2)), center[..., 2:]], axis=-1)
    return ScoredFrame(center, size, own, around, affine)


def golden_raster(stored: GoldenArrays, affine: Floats) -> DrivableRaster:
    """The raster with the pose and the cell size that its affine map says.

    Args:
        stored: One file of a scoring set.
        affine: (2, 3) from global metres to raster coordinates.

    Returns:
        The raster.

    Raises:
        InputError: If it is not square, or the map is more than a turn, a shift and a scale.
    """
    cells = stored.verdicts("raster", None, None)
    count = len(cells)
    scale = float(np.hypot(*affine[1, :2]))
    turned = np.array([[affine[1, 1], -affine[1, 0]], affine[1, :2]])
    if cells.shape != (count, count) or scale == 0.0 or np.abs(affine[:, :2] - turned).max() > 1e-9 * scale:
        raise InputError(
            f"the raster in {stored.path} is not square, or its map is more than a turn, a shift and one scale with "
            "the first index to the right and the second forward; make it again"
        )
    origin = np.linalg.solve(affine[:, :2], count / 2 - affine[:, 2])
    yaw = np.arctan2(affine[1, 1], affine[1, 0])
    return DrivableRaster(cells, np.array([*origin, yaw]), 1.0 / scale)
