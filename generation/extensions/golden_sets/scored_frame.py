"""Inputs of one golden scoring file: candidates, what is around them, and the drivable raster."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from benchmark.verification.golden import GoldenArrays
from generation.search.scoring import Surroundings

SCORED: Final = slice(1, 13)
"""Frames after the planning frame that the paper scores."""


@dataclass(frozen=True, slots=True)
class ScoredFrame:
    """Inputs of the score of a file's candidates; B candidates, S frames.

    Attributes:
        center: (B, S, 3) poses of the candidates' box centres.
        size: (2,) length and width.
        boxes: (B, S, 5) the candidates as boxes.
        affine: (2, 3) from global metres to raster coordinates, as the file has it.
    """

    center: Floats
    size: Floats
    boxes: Floats
    around: Surroundings
    affine: Floats


def read_scored_frame(stored: GoldenArrays) -> ScoredFrame:
    """Inputs of the score of one file, at the scored frames only."""
    center, valid = stored.floats("candidates", None, None, 3)[:, SCORED], stored.verdicts("valid", None, None)
    width, length = stored.floats("adv_width_length", 2)
    boxes = stored.floats("boxes_x_y_heading_width_length", *valid.shape, 5)[SCORED][..., [0, 1, 4, 3, 2]]
    ego = boxes[:, int(stored.integers("ego_index")), :2]
    affine = stored.floats("raster_affine_global_to_index", 2, 3)
    around = Surroundings(boxes, valid[SCORED], ego, golden_raster(stored, affine))
    size = np.array([length, width])
    own = np.concatenate([center[..., :2], np.broadcast_to(size, (*center.shape[:2], 2)), center[..., 2:]], axis=-1)
    return ScoredFrame(center, size, own, around, affine)


def golden_raster(stored: GoldenArrays, affine: Floats) -> DrivableRaster:
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
