"""The protocols written sample by sample, polygon by polygon and cell by cell, from their definitions.

Nothing is shared with the fast side but `SampleTruth` and plain numbers: whole rasters are drawn for every step, every
polygon is a shapely polygon, and averages are sums in loops. The built-in golden set is made with these functions
(`tests/benchmark/extensions/golden_sets/golden_protocols.py`), and `python -m bench.speed protocols` times them.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.truth import SampleTruth

UNIAD_NAMES = {
    "vehicle.car": "car", "vehicle.bus.bendy": "bus", "vehicle.bus.rigid": "bus",
    "vehicle.construction": "construction_vehicle", "vehicle.bicycle": "bicycle", "vehicle.motorcycle": "motorcycle",
    "vehicle.truck": "truck", "vehicle.trailer": "trailer",
}  # fmt: skip
TEN_CLASS_NAMES = UNIAD_NAMES | {
    "human.pedestrian.adult": "pedestrian", "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian", "human.pedestrian.police_officer": "pedestrian",
    "movable_object.barrier": "barrier", "movable_object.trafficcone": "traffic_cone",
}  # fmt: skip
TABLE_32 = (
    "noise", "animal", "human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker",
    "human.pedestrian.personal_mobility", "human.pedestrian.police_officer", "human.pedestrian.stroller",
    "human.pedestrian.wheelchair", "movable_object.barrier", "movable_object.debris",
    "movable_object.pushable_pullable", "movable_object.trafficcone", "static_object.bicycle_rack", "vehicle.bicycle",
    "vehicle.bus.bendy", "vehicle.bus.rigid", "vehicle.car", "vehicle.construction", "vehicle.emergency.ambulance",
    "vehicle.emergency.police", "vehicle.motorcycle", "vehicle.trailer", "vehicle.truck",
)  # fmt: skip
"""The first 24 of the 32 entries: what VAD's indices 2..8 and 14..23 point at."""
COUNTED_BY_VAD = {TABLE_32[index] for index in (*range(2, 9), *range(14, 24))} & set(TEN_CLASS_NAMES)
COUNTED_BY_VAD_23 = {
    "human.pedestrian.wheelchair", "human.pedestrian.stroller", "human.pedestrian.personal_mobility",
    "human.pedestrian.police_officer", "human.pedestrian.construction_worker", "animal", "vehicle.car",
    "vehicle.construction", "vehicle.emergency.ambulance", "vehicle.emergency.police", "vehicle.trailer",
    "movable_object.barrier", "movable_object.trafficcone", "movable_object.pushable_pullable",
    "movable_object.debris", "static_object.bicycle_rack",
} & set(TEN_CLASS_NAMES)  # fmt: skip


@dataclass
class SlowVerdicts:
    """What a protocol says about one plan: six steps each, and its three published values."""

    before_mask: list[bool]
    recorded: list[bool]
    collision: list[bool]
    obj_col: list[bool]
    l2: list[float]
    counted: bool
    values: dict[str, list[float]]
    rasters: NDArray[np.uint8] | None = None


def slow_uniad(sample: SampleTruth, plan: Floats) -> SlowVerdicts:
    """UniAD: rasters of the vehicles of each future keyframe; past the end of the scene everything is occupied."""
    rasters = np.zeros((6, 200, 200), np.uint8)
    for step in range(6):
        if not sample.ego_future_valid[step]:
            rasters[step] = 1
            continue
        for row, name in enumerate(sample.categories):
            if name in UNIAD_NAMES and sample.annotated[row, step + 1]:
                fill(rasters[step], [uniad_node(x, y) for x, y in single_corners(sample.boxes[row, step + 1])])
    recorded = [covers(rasters[step], uniad_block(sample.ego_future[step, :2])) for step in range(6)]
    before = [covers(rasters[step], uniad_block(plan[step])) for step in range(6)]
    collision = [hit and not own for hit, own in zip(before, recorded)]
    obj_col = []
    for step in range(6):
        row, column = (math.trunc((float(plan[step, axis]) + 49.75) / 0.5) for axis in (1, 0))
        # Python truncates -0.3 to 0, which is in range, as the C cast does.
        inside = 0 <= row < 200 and 0 <= column < 200
        obj_col.append(inside and bool(rasters[step, row, column]) and not recorded[step])
    l2 = displacements(sample, plan)
    at = (1, 3, 5)
    values = {
        "collision": [float(collision[step]) for step in at],
        "obj_col": [float(obj_col[step]) for step in at],
        "l2": [l2[step] for step in at],
    }
    return SlowVerdicts(before, recorded, collision, obj_col, l2, True, values, rasters)


def slow_vad(sample: SampleTruth, plan: Floats, names: Collection[str] = COUNTED_BY_VAD) -> SlowVerdicts:
    """VAD: rasters of what is near now, followed until its first gap."""
    rasters = np.zeros((6, 200, 200), np.uint8)
    for row, name in enumerate(sample.categories):
        x, y, length, width, _ = sample.boxes[row, 0]
        seen = sample.annotated[row, 0] and sample.has_lidar_points[row, 0] and abs(x) < 15.0 and abs(y) < 30.0
        if name not in names or not seen:
            continue
        for step in range(6):
            if not sample.annotated[row, step + 1]:
                break
            box = [*sample.boxes[row, step + 1, :2], length, width, sample.boxes[row, step + 1, 4]]
            fill(rasters[step], [vad_node(*corner) for corner in corners(box)])
    recorded = [covers(rasters[step], vad_block(sample.ego_future[step, :2])) for step in range(6)]
    before = [covers(rasters[step], vad_block(plan[step])) for step in range(6)]
    collision = [hit and not own for hit, own in zip(before, recorded)]
    obj_col = []
    for step in range(6):
        row, column = math.trunc((24.875 - plan[step, 1]) / 0.5), math.trunc((24.875 + plan[step, 0]) / 0.5)
        inside = 0 <= row < 200 and 0 <= column < 200
        obj_col.append(inside and bool(rasters[step, row, column]) and not recorded[step])
    l2 = displacements(sample, plan)
    values = {
        "collision": [single_share(collision[:count]) for count in (2, 4, 6)],
        "obj_col": [single_share(obj_col[:count]) for count in (2, 4, 6)],
        "l2": [sum(l2[:count]) / count for count in (2, 4, 6)],
    }
    return SlowVerdicts(before, recorded, collision, obj_col, l2, all(sample.ego_future_valid), values, rasters)


def slow_sparsedrive(sample: SampleTruth, plan: Floats) -> SlowVerdicts:
    """SparseDrive and DiffusionDrive: polygons of everything with lidar points, the ego turned along the plan."""

    def touches(path: Floats) -> list[bool]:
        found = []
        for step, yaw in enumerate(sparsedrive_headings(path)):
            ego = shapely.Polygon(corners(ego_box(float(path[step, 0]), float(path[step, 1]), yaw)))
            there = sample.annotated[:, step + 1] & sample.has_lidar_points[:, step + 1]
            others = [shapely.Polygon(corners(box)) for box in sample.boxes[there, step + 1]]
            found.append(bool(sample.ego_future_valid[step]) and any(ego.intersects(other) for other in others))
        return found

    before, recorded = touches(plan), touches(sample.ego_future[:, :2])
    collision = [hit and not own for hit, own in zip(before, recorded)]
    l2 = displacements(sample, plan)
    values = {
        "collision": [sum(collision[:count]) / count for count in (2, 4, 6)],
        "l2": [sum(l2[:count]) / count for count in (2, 4, 6)],
    }
    return SlowVerdicts(before, recorded, collision, recorded, l2, all(sample.ego_future_valid), values)


def slow_contacts(sample: SampleTruth, poses: list[Floats]) -> Bools:
    """(M, 30) contact of the ego with each object every 0.1 s, wherever it is annotated at both keyframes.

    ``poses`` are seven, x, y, yaw, the first one now.
    """
    found = np.zeros((len(sample.instances), 30), dtype=np.bool_)
    for instant in range(30):
        step, share = instant // 5, (instant % 5 + 1) / 5
        mine = ego_box(*between(poses[step].tolist(), poses[step + 1].tolist(), share))
        ego = shapely.Polygon(corners(mine))
        for row, boxes in enumerate(sample.boxes):
            first, second = boxes[step].tolist(), boxes[step + 1].tolist()
            if not sample.annotated[row, step + 1] or not (sample.annotated[row, step] or share == 1.0):
                continue
            x, y, yaw = between([*first[:2], first[4]], [*second[:2], second[4]], share)
            if share == 1.0:
                x, y, yaw = second[0], second[1], second[4]
            length, width = ((1 - share) * first[axis] + share * second[axis] for axis in (2, 3))
            # Circles around the two that stay a centimetre apart save the polygons.
            if math.dist((x, y), mine[:2]) > 0.5 * (math.hypot(length, width) + math.hypot(4.084, 1.85)) + 0.01:
                continue
            found[row, instant] = ego.intersects(shapely.Polygon(corners([x, y, length, width, yaw])))
    return found


def slow_exact(sample: SampleTruth, plan: Floats) -> Bools:
    """(30,) contact with anything every 0.1 s."""
    return np.asarray(slow_contacts(sample, exact_poses(plan)).any(axis=0))


def exact_poses(plan: Floats) -> list[Floats]:
    """Now and the six waypoints with the heading of chords of at least 0.3 m, else the one before."""
    points = [np.zeros(2), *plan, plan[-1]]
    poses = [np.array([0.0, 0.0, math.pi / 2])]
    for step in range(1, 7):
        dx, dy = points[step + 1] - points[step - 1]
        yaw = math.atan2(dy, dx) if math.hypot(dx, dy) >= 0.3 else poses[-1][2]
        poses.append(np.array([*points[step], yaw]))
    return poses


def between(first: list[float], second: list[float], share: float) -> tuple[float, float, float]:
    """A pose part of the way; the heading takes the shorter arc."""
    turn = (second[2] - first[2] + math.pi) % (2 * math.pi) - math.pi
    return (
        first[0] + share * (second[0] - first[0]),
        first[1] + share * (second[1] - first[1]),
        first[2] + share * turn,
    )


def sparsedrive_headings(path: Floats) -> list[float]:
    """Central differences, or straight ahead where the ends are close; waypoints are single precision there."""
    points = [(float(np.float32(x)), float(np.float32(y))) for x, y in path]
    apart = [np.float32(points[5][axis]) - np.float32(points[0][axis]) for axis in (0, 1)]
    if np.sqrt(apart[0] * apart[0] + apart[1] * apart[1]) < np.float32(0.5):
        return [math.pi / 2] * 6
    points = [(0.0, 0.0), *points]
    ends = [(points[step - 1], points[step + 1]) for step in range(1, 6)] + [(points[5], points[6])]
    return [math.atan2(after[1] - before[1], after[0] - before[0]) for before, after in ends]


def ego_box(x: float, y: float, yaw: float) -> list[float]:
    """The ego's rectangle, its centre half a metre ahead."""
    return [x + 0.5 * math.cos(yaw), y + 0.5 * math.sin(yaw), 4.084, 1.85, yaw]


def corners(box: Floats | list[float]) -> list[tuple[float, float]]:
    """Corners of x, y, length, width, yaw."""
    x, y, length, width, yaw = (float(value) for value in box)
    # numpy's own cosine: where a corner is to be rounded, the last bit counts.
    cos, sin = float(np.cos(yaw)), float(np.sin(yaw))
    halves = [(0.5 * length * along, 0.5 * width * across) for along, across in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    return [(x + (along * cos - across * sin), y + (along * sin + across * cos)) for along, across in halves]


def single_corners(box: Floats) -> list[tuple[np.float32, np.float32]]:
    """The same in single precision throughout."""
    x, y, length, width, yaw = (np.float32(value) for value in box)
    cos, sin, found = np.cos(yaw), np.sin(yaw), []
    for front, left in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        along, across = np.float32(front) * (length / np.float32(2)), np.float32(left) * (width / np.float32(2))
        found.append((along * cos - across * sin + x, along * sin + across * cos + y))
    return found


def uniad_node(x: np.float32, y: np.float32) -> tuple[int, int]:
    """Column and row of a corner; Python rounds half to even."""
    half, edge = np.float32(0.5), np.float32(50)
    return round(float((x + edge) / half)), round(float((y + edge) / half))


def vad_node(x: float, y: float) -> tuple[int, int]:
    """Column and row of a corner, the first row far ahead."""
    return round((x + 50.0) / 0.5), round((-y + 50.0) / 0.5)


def fill(raster: NDArray[np.uint8], nodes: list[tuple[int, int]]) -> None:
    """Draw one polygon."""
    cv2.fillPoly(raster, [np.array(nodes, np.int32)], (1,))


def block() -> list[tuple[int, int]]:
    """Rows and columns whose centres lie in the ego's rectangle at the origin."""
    (low_row, high_row), (low_column, high_column) = (
        ((center - half + 49.75) / 0.5, (center + half + 49.75) / 0.5)
        for center, half in ((0.5, 0.5 * 4.084), (0.0, 0.5 * 1.85))
    )
    return [
        (row, column)
        for row in range(200)
        for column in range(200)
        if low_row < row < high_row and low_column < column < high_column
    ]


BLOCK = block()


def uniad_block(place: Floats) -> list[tuple[int, int]]:
    """Cells of the ego at a waypoint, pushed back onto the grid."""
    right, ahead = (float(np.float32(value) / np.float32(0.5)) for value in place)
    return [(onto_grid(math.trunc(ahead + row)), onto_grid(math.trunc(right + column))) for row, column in BLOCK]


def vad_block(place: Floats) -> list[tuple[int, int]]:
    """The same with the first row far ahead."""
    right, ahead = (float(np.float32(value) / np.float32(0.5)) for value in place)
    return [
        (onto_grid(math.trunc(200 - (ahead + row))), onto_grid(math.trunc(right + column))) for row, column in BLOCK
    ]


def onto_grid(index: int) -> int:
    return min(max(index, 0), 199)


def covers(raster: NDArray[np.uint8], cells: list[tuple[int, int]]) -> bool:
    return any(raster[row, column] for row, column in cells)


def single_share(flags: list[bool]) -> float:
    """Mean of flags in single precision."""
    return float(np.float32(sum(flags)) / np.float32(len(flags)))


def displacements(sample: SampleTruth, plan: Floats) -> list[float]:
    """Distance from the recorded ego, 0 past the end of the scene."""
    return [
        math.dist(plan[step], sample.ego_future[step, :2]) if sample.ego_future_valid[step] else 0.0
        for step in range(6)
    ]
