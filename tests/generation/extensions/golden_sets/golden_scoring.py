"""The built-in scoring set: made-up planning frames, and the scores of their candidates written out in loops.

The paper's and the reference code's.

``python -m tests.generation.extensions.golden_sets.golden_scoring`` writes the set; a test compares what is stored with
what this makes.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.road_map import DrivableRaster
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.scoring import ScoringSurroundings
from tests.generation.search.slow_reference_scoring import slow_reference
from tests.generation.search.slow_scoring import slow_final_scores, slow_score_terms

Arrays = dict[str, NDArray[Any]]
FRAMES = 13
EGO_WIDTH_LENGTH = (1.730, 4.084)
EGO_CENTER_AHEAD_M, LIDAR_AHEAD_M = 1.39, 0.94
"""Of the rear axle."""


def straight(x: float, y: float, heading: float, speed: float, turn: float = 0.0) -> Floats:
    """(13, 3) poses of something that moves ``speed`` metres and turns ``turn`` radians a frame."""
    poses = [(x, y, heading)]
    for _ in range(FRAMES - 1):
        x, y, heading = x + speed * math.cos(heading), y + speed * math.sin(heading), heading + turn
        poses.append((x, y, heading))
    return np.array(poses)


def global_to_index(x: float, y: float, heading: float, cell_m: float = 0.5) -> Floats:
    """First index to the right of a pose, second ahead of it, the pose at (100, 100)."""
    cos, sin = math.cos(heading) / cell_m, math.sin(heading) / cell_m
    return np.array([[sin, -cos, 100.0 - sin * x + cos * y], [cos, sin, 100.0 - cos * x - sin * y]])


def crossing() -> Arrays:
    """A curved road, traffic from all sides, one object that leaves and one that comes; lane changes and swerves."""
    x, y, heading = 1250.3, 878.9, 2.31
    rng = np.random.default_rng(content_seed("golden scoring", "crossing"))
    ahead, left = np.array([math.cos(heading), math.sin(heading)]), np.array([-math.sin(heading), math.cos(heading)])

    def at(along: float, across: float, turned: float, speed: float, turn: float = 0.0) -> Floats:
        place = np.array([x, y]) + along * ahead + across * left
        return straight(place[0], place[1], heading + turned, speed, turn)

    others = [
        at(14.0, 6.0, -1.4, 0.62),
        at(9.0, -9.0, 1.2, 0.7, 0.03),
        at(22.0, 0.4, 0.05, 0.2),
        at(21.0, 3.8, 3.1, 0.6),
        at(-6.0, 0.3, 0.0, 0.8),
        at(0.0, 0.0, 0.0, 0.7),
    ]
    sizes = [(1.9, 4.6), (2.6, 8.4), (0.8, 0.9), (2.0, 5.1), (1.8, 4.2), EGO_WIDTH_LENGTH]
    valid = np.ones((FRAMES, len(others)), np.bool_)
    valid[7:, 1] = valid[:4, 2] = False
    candidates = [
        at(4.0, 3.4 + rng.uniform(-0.6, 0.6), rng.normal(0.0, 0.15), rng.uniform(0.1, 1.3), rng.normal(0.0, 0.06))
        for _ in range(48)
    ]
    right, forward = np.meshgrid(np.arange(200) - 100.0, np.arange(200) - 100.0, indexing="ij")
    middle = -6.0 + 0.0009 * (forward - 8.0) ** 2
    road = np.abs(right - middle) < 13.0
    road[110:118, 112:140] = False
    return scored(others, sizes, valid, candidates, (1.95, 4.62), road, global_to_index(x, y, heading))


def parked_row() -> Arrays:
    """A vehicle between parked ones, 12 of them nose to tail on both sides; it pulls out or rams its neighbours."""
    rng = np.random.default_rng(content_seed("golden scoring", "parked row"))
    x, y = 604.0, 1640.0
    row = [straight(x + 5.1 * place, y + side, 0.0, 0.0) for place in range(-3, 4) for side in (2.2, -2.2)]
    others = [*row[:6], *row[7:], straight(x - 7.0, y + 5.6, 0.02, 0.75)]
    sizes = [(1.9, 4.4 + 0.05 * number) for number in range(len(others) - 1)] + [EGO_WIDTH_LENGTH]
    candidates = [
        straight(x, y + 2.2, rng.normal(0.0, 0.1), rng.uniform(-0.05, 0.6), rng.normal(0.05, 0.05)) for _ in range(40)
    ]
    right, _ = np.meshgrid(np.arange(200) - 100.0, np.arange(200) - 100.0, indexing="ij")
    valid = np.ones((FRAMES, len(others)), np.bool_)
    affine = global_to_index(x - 7.0, y + 5.6, 0.02)
    return scored(others, sizes, valid, candidates, (1.9, 4.5), np.abs(right - 4.0) < 11.0, affine)


def standing() -> Arrays:
    """All candidates as far from the ego as each other, one outside the raster's world, boxes that touch exactly."""
    others = [straight(0.0, 2.0, 0.0, 0.0), straight(32.0, 0.0, 0.0, 0.0)]
    candidates = [straight(0.0, 0.0, heading, 0.0) for heading in (0.0, 0.4, 0.8, 1.6, -2.9)]
    raster = np.zeros((120, 120), np.bool_)
    raster[58:62, 55:70] = True
    affine = np.array([[0.0, -1.0, 60.25], [1.0, 0.0, 60.25]])
    valid = np.ones((FRAMES, 2), np.bool_)
    return scored(others, [(2.0, 4.0), EGO_WIDTH_LENGTH], valid, candidates, (2.0, 4.0), raster, affine)


CASES = {"crossing": crossing, "parked_row": parked_row, "standing": standing}


def scored(
    others: list[Floats],
    sizes: list[tuple[float, float]],
    valid: NDArray[np.bool_],
    candidates: list[Floats],
    size: tuple[float, float],
    raster: NDArray[np.bool_],
    affine: Floats,
) -> Arrays:
    """Inputs and what the paper says about them; the last of the others is the ego."""
    boxes = np.stack([np.column_stack([path, np.tile(edges, (FRAMES, 1))]) for path, edges in zip(others, sizes)], 1)
    arrays: Arrays = {
        "candidates": np.stack(candidates),
        "adv_width_length": np.array(size),
        "boxes_x_y_heading_width_length": boxes,
        "valid": valid,
        "ego_index": np.array(len(others) - 1),
        "raster": raster,
        "raster_affine_global_to_index": affine,
    }
    origin = np.linalg.solve(affine[:, :2], 0.5 * len(raster) - affine[:, 2])
    seen = DrivableRaster(
        raster, np.array([*origin, math.atan2(affine[1, 1], affine[1, 0])]), 1 / np.hypot(*affine[0, :2])
    )
    around = ScoringSurroundings(boxes[1:][..., [0, 1, 4, 3, 2]], valid[1:], boxes[1:, -1, :2], seen)
    start = np.random.default_rng(content_seed("golden scoring", "start", len(candidates))).uniform(
        0.0, 1e-3, len(candidates)
    )
    for reading in CollisionReading:
        hyper = HyperParameters(lookahead_frames=0, clearance_m=0.0, headway_s=0.0, collision_reading=reading)
        slow = slow_score_terms(np.stack(candidates)[:, 1:], np.array(size[::-1]), around, hyper)
        arrays |= {
            "paper_center_violation": slow.center_off_road,
            "paper_corner_violation": slow.corner_off_road,
            "paper_dist": slow.distance,
            "paper_dac": slow.dac,
            "paper_ac_raw": slow.challenge,
            "paper_ac": (slow.challenge - slow.challenge.min()) / (np.ptp(slow.challenge) or 1.0),
            f"paper_collision_{reading}": slow.collision,
            f"paper_cr_{reading}": slow.cr,
            f"paper_final_{reading}": np.array(slow_final_scores(slow, np.zeros(len(candidates)), hyper)),
        }
    return reference_scored(arrays | {"paper_init_score_uniform_0_1e-3": start})


def reference_scored(arrays: Arrays) -> Arrays:
    """What the reference code says about the same candidates, all of whose poses count; single precision, as there."""
    boxes, valid = arrays["boxes_x_y_heading_width_length"], arrays["valid"]
    width, length = arrays["adv_width_length"].tolist()
    ego, heading = boxes[:, -1], boxes[:, -1, 2]
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    rear = ego[:, :2] - EGO_CENTER_AHEAD_M * ahead
    lidar = rear + LIDAR_AHEAD_M * ahead
    seen = boxes.copy()
    seen[:, -1] = np.column_stack([lidar, heading, np.full(FRAMES, 3.5), np.full(FRAMES, 7.0)])
    # An absent object is a box without a size at the ego's lidar.
    seen[~valid] = np.concatenate([lidar[:, None].repeat(boxes.shape[1], 1), np.zeros((*valid.shape, 3))], -1)[~valid]
    slow = slow_reference(
        arrays["candidates"],
        np.array([length, width]),
        seen[..., [0, 1, 4, 3, 2]],
        np.ones(valid.shape, np.bool_),
        rear,
        arrays["raster"],
        arrays["raster_affine_global_to_index"],
    )
    own = np.tile([*boxes[0, 0, :2], 0.0, width, length], (FRAMES, 1, 1))
    rows = np.concatenate([own, seen], axis=1)
    flat = np.zeros(rows.shape[:2])
    stored = [rows[..., 0], rows[..., 1], flat, rows[..., 3], rows[..., 4], flat, -rows[..., 2] - 0.5 * np.pi]
    return arrays | {
        "ref_boxes_x_y_z_w_l_h_yawmm": np.stack(stored, axis=-1).astype(np.float32),
        "ref_adv_row": np.array(0),
        "ref_ego_rear_xy": rear.astype(np.float32),
        "ref_out_of_road_center": slow.off.astype(np.uint8),
        "ref_corners_out_count": slow.corners.astype(np.uint8),
        "ref_must_col": slow.sure.T,
        "ref_col": slow.collision.T,
        "ref_ego_col": slow.hits_ego,
        "ref_n_polygon_tests": np.array(slow.tests),
        "ref_dac": slow.dac.astype(np.float32),
        "ref_cr": slow.cr.astype(np.float32),
        "ref_ac": slow.ac.astype(np.float32),
        "ref_final_without_noise": slow.final().astype(np.float32),
        "ref_final_with_noise": (slow.final() + arrays["paper_init_score_uniform_0_1e-3"]).astype(np.float32),
    }


def write(folder: Path) -> None:
    """Write all cases."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, make in CASES.items():
        np.savez_compressed(folder / f"{name}.npz", **make())


if __name__ == "__main__":
    write(BUILT_IN / "scoring")
