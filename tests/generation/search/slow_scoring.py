"""The score written point by point and polygon by polygon, as the appendix says it.

Nothing is shared with the fast side but the hyper-parameters.
"""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from benchmark.geometry import Bools, Floats
from benchmark.road_map import DrivableRaster
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.scoring import ScoringSurroundings


@dataclass(frozen=True)
class SlowTerms:
    """The fields of `generation.search.scoring.ScoreTerms`, and polygon tests that were needed."""

    center_off_road: Bools
    corner_off_road: Bools
    collision: Bools
    distance: Floats
    dac: Floats
    cr: Floats
    challenge: Floats
    polygon_tests: int


def slow_score_terms(
    center: Floats, size: Floats, around: ScoringSurroundings, hyper: HyperParameters, speed: Floats | None = None
) -> SlowTerms:
    """Terms of (B, S, 3) poses of finite candidates."""
    shape = center.shape[:2]
    center_off, corner_off, collision = (np.zeros(shape, dtype=np.bool_) for _ in range(3))
    distance, tests = np.zeros(shape), 0
    length, width = float(size[0]), float(size[1])
    for candidate, step in np.ndindex(*shape):
        x, y, yaw = (float(value) for value in center[candidate, step])
        center_off[candidate, step] = not on_road(around.raster, x, y)
        corners = outline(x, y, length, width, yaw)
        corner_off[candidate, step] = not all(on_road(around.raster, *corner) for corner in corners)
        headway = 0.0 if speed is None else hyper.headway_s * float(speed[candidate, step])
        grown = [x, y, length + 2 * hyper.clearance_m + 2 * headway, width + 2 * hyper.clearance_m, yaw]
        hit, count = slow_collision(grown, around.boxes[step][around.present[step]], hyper.collision_reading)
        collision[candidate, step] = hit
        tests += count
        ego_x, ego_y = around.ego_center[step]
        distance[candidate, step] = math.hypot(x - ego_x, y - ego_y)
    safety, challenge = hyper.safety_step_weights(), hyper.challenge_step_weights()
    dac, cr, ac = np.zeros(shape[0]), np.zeros(shape[0]), np.zeros(shape[0])
    for candidate, step in np.ndindex(*shape):
        violation = float(center_off[candidate, step]) + hyper.corner_weight * float(corner_off[candidate, step])
        dac[candidate] += safety[step] * violation
        cr[candidate] += safety[step] * float(collision[candidate, step])
        ac[candidate] += challenge[step] * distance[candidate, step]
    return SlowTerms(center_off, corner_off, collision, distance, dac, cr, ac, tests)


def slow_final_scores(terms: SlowTerms, start: Floats, hyper: HyperParameters) -> list[float]:
    """FinalScore of the appendix, the challenge normalised over the batch."""
    low, high = min(terms.challenge), max(terms.challenge)
    span = high - low
    return [
        float(first + hyper.dac_weight * dac + hyper.cr_weight * cr)
        + (hyper.ac_weight * float((challenge - low) / span) if span > 0.0 else 0.0)
        for first, dac, cr, challenge in zip(start, terms.dac, terms.cr, terms.challenge, strict=True)
    ]


def on_road(raster: DrivableRaster, x: float, y: float) -> bool:
    """Look up one point; outside is off the road."""
    offset_x, offset_y = x - raster.pose[0], y - raster.pose[1]
    cos, sin = math.cos(raster.pose[2]), math.sin(raster.pose[2])
    count = len(raster.cells)
    right = round((offset_x * sin - offset_y * cos) / raster.resolution_m + count / 2)
    forward = round((offset_x * cos + offset_y * sin) / raster.resolution_m + count / 2)
    return 0 <= right < count and 0 <= forward < count and bool(raster.cells[right, forward])


def outline(x: float, y: float, length: float, width: float, yaw: float) -> list[tuple[float, float]]:
    """Corners of a box."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    signs = ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))
    return [
        (x + ahead * length * cos - left * width * sin, y + ahead * length * sin + left * width * cos)
        for ahead, left in signs
    ]


def slow_collision(own: list[float], others: Floats, reading: CollisionReading) -> tuple[bool, int]:
    """Whether a box collides with any other, and how many polygon tests it took to know."""
    tests = 0
    for other in others:
        distance = math.hypot(own[0] - other[0], own[1] - other[1])
        near = min(own[2], own[3]) + min(other[2], other[3])
        far = max(own[2], own[3]) + max(other[2], other[3])
        if reading is CollisionReading.HALF:
            near, far = 0.5 * near, 0.5 * far
        if reading is CollisionReading.GEOMETRY:
            near, far = 0.0, 0.5 * (math.hypot(own[2], own[3]) + math.hypot(other[2], other[3])) + 1e-6
        if distance < near:
            return True, tests
        if distance > far:
            continue
        tests += 1
        mine, theirs = (shapely.Polygon(outline(*(float(value) for value in box))) for box in (own, other))
        if mine.intersects(theirs):
            return True, tests
    return False, tests
