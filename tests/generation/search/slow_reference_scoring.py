"""The reference code's score written pose by pose and pair by pair, from its description alone.

Nothing is shared with the fast side. Boxes are x, y, length, width, heading; the last of the others is the ego.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from tests.generation.search.slow_scoring import outline


@dataclass(frozen=True)
class SlowReference:
    """What the reference code makes of B candidates over S poses."""

    off: Bools
    corners: NDArray[np.int64]
    sure: Bools
    collision: Bools
    hits_ego: Bools
    tests: int
    dac: Floats
    cr: Floats
    ac: Floats

    def final(self, *, challenged: bool = True) -> Floats:
        """Scores without their random start."""
        return 0.02 + 5.0 * self.dac + 10.0 * self.cr + (self.ac if challenged else 0.0)


def slow_reference(
    center: Floats, size: Floats, boxes: Floats, present: Bools, rear: Floats, cells: Bools, affine: Floats
) -> SlowReference:
    """Score (B, S, 3) poses of a vehicle of ``size`` length, width; ``affine`` leads to indices of ``cells``."""
    count, poses = center.shape[:2]
    off, corners = np.zeros((count, poses), np.bool_), np.zeros((count, poses), np.int64)
    sure, collision = np.zeros((count, poses), np.bool_), np.zeros((count, poses), np.bool_)
    hits_ego, tests = np.zeros(count, np.bool_), 0
    dac, cr, raw = np.zeros(count), np.zeros(count), np.zeros(count)
    for candidate in range(count):
        for pose in range(poses):
            x, y, heading = (float(value) for value in center[candidate, pose])
            off[candidate, pose] = not on_road(x, y, cells, affine)
            for side, end in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
                corner_x = x + side * 0.5 * float(size[1]) * math.cos(heading)
                corner_y = y + end * 0.5 * float(size[0]) * math.sin(heading)
                corners[candidate, pose] += not on_road(corner_x, corner_y, cells, affine)
            others = [box for box, there in zip(boxes[pose].tolist(), present[pose]) if there]
            found = collides((x, y, heading), size, others, pose)
            sure[candidate, pose], collision[candidate, pose] = found[0], found[0] or bool(found[1])
            hits_ego[candidate] |= pose <= 13 and found[1] == [len(others) - 1]
            tests += found[2]
            penalty = {0: 0.0, 1: 1.0, 2: 1.1, 3: 1.2, 4: 1.3}[int(corners[candidate, pose])]
            dac[candidate] += road_weight(pose, poses) * (off[candidate, pose] + 0.2 * penalty)
            cr[candidate] += collision_weight(pose) * collision[candidate, pose]
            distance = math.hypot(x - rear[pose, 0], y - rear[pose, 1])
            raw[candidate] += (distance * distance_weight(pose)) ** 2
    low, high = min(raw), max(raw)
    shown = np.array([high if hit else value for value, hit in zip(raw, hits_ego, strict=True)])
    return SlowReference(off, corners, sure, collision, hits_ego, tests, dac, cr, (shown - low) / (high - low + 1e-7))


def on_road(x: float, y: float, cells: Bools, affine: Floats) -> bool:
    """One look-up; outside counts as the nearest cell of the border."""
    first, second = (min(max(round(row[0] * x + row[1] * y + row[2]), 0), len(cells) - 1) for row in affine.tolist())
    return bool(cells[first, second])


def road_weight(pose: int, poses: int) -> float:
    """From 1 to 0.5 over the poses that are left, squared; hardly anything from pose 14 on."""
    share = pose / (poses - 1) if poses > 1 else 0.0
    return float((1.0 - 0.5 * share) ** 2 * (0.03 if pose >= 14 else 1.0))


def collision_weight(pose: int) -> float:
    """From 1 to 0.5 over 81 poses, squared; hardly anything from pose 13 on."""
    return float((1.0 - 0.5 * pose / 80) ** 2 * (0.03 if pose >= 13 else 1.0))


def distance_weight(pose: int) -> float:
    """From 0.7 to 1 over 13 poses, then from 0.2 to 0.05 over the other 68, squared."""
    return 0.7 + 0.3 * pose / 12 if pose <= 12 else float((0.2 - 0.15 * (pose - 13) / 67) ** 2)


def collides(
    place: tuple[float, float, float], size: Floats, others: list[list[float]], pose: int
) -> tuple[bool, list[int], int]:
    """Whether something is too near for a test, whose box is met otherwise, and how many boxes that took."""
    x, y, heading = place
    length, width = size.tolist()
    pairs = [(math.hypot(x - other[0], y - other[1]), other) for other in others]
    if any(2 * far < min(length, width) + min(other[2:4]) for far, other in pairs):
        return True, [], 0
    if pose > 13 and pose not in (16, 20, 24):
        return False, [], 0
    own = shapely.Polygon(outline(x, y, 1.2 * length, 1.2 * width, heading))
    asked = [(i, other) for i, (far, other) in enumerate(pairs) if not 2 * far > max(length, width) + max(other[2:4])]
    return False, [i for i, other in asked if own.intersects(shapely.Polygon(outline(*other)))], len(asked)
