"""The further protocols sample by sample and raster by raster, from their definitions; as `slow_protocols`.

Whole rasters are drawn for every step, and the warp of ST-P3 is PyTorch's, as in its own code.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import cv2
import numpy as np
import shapely
import torch
from numpy.typing import NDArray
from torch.nn import functional

from benchmark.geometry import Floats
from benchmark.truth import SampleTruth
from tests.benchmark.protocols import slow_protocols as slow

VEHICLES_OF_ALL_KINDS = {name for name in slow.TABLE_32 if name.startswith("vehicle.")}
Grid = NDArray[np.uint8]
Path = Sequence[tuple[float, float]]


@dataclass
class FurtherVerdicts:
    """What a protocol says about one plan: flags of six steps by column, and published values by column."""

    counted: bool
    steps: dict[str, list[bool]]
    values: dict[str, list[float]]
    rasters: list[Grid] = field(default_factory=list)
    l2: list[float] = field(default_factory=list)


def ego_pose(lidar: tuple[float, float, float], ahead: float) -> Floats:
    """x, y, yaw of the rear axle from a pose of the lidar origin."""
    x, y, yaw = lidar
    return np.array([x - ahead * math.cos(yaw), y - ahead * math.sin(yaw), yaw])


def axle_poses(sample: SampleTruth) -> list[Floats]:
    """Now and at the six steps, global."""
    if sample.axle_poses is not None:
        return list(sample.axle_poses)
    x, y, yaw = sample.lidar_pose
    found = [ego_pose((x, y, yaw), sample.lidar_ahead_m)]
    for right, forward, heading in sample.ego_future:
        place = (
            x + forward * math.cos(yaw) + right * math.sin(yaw),
            y + forward * math.sin(yaw) - right * math.cos(yaw),
            heading - math.pi / 2 + yaw,
        )
        found.append(ego_pose(place, sample.lidar_ahead_m))
    return found


def matrix(pose: Floats) -> NDArray[np.float32]:
    x, y, yaw = pose
    found = np.eye(4, dtype=np.float32)
    found[0, :2], found[1, :2] = (math.cos(yaw), -math.sin(yaw)), (math.sin(yaw), math.cos(yaw))
    found[:2, 3] = x, y
    return found


def inverse(motion: NDArray[np.float32]) -> NDArray[np.float32]:
    found = np.eye(4, dtype=np.float32)
    found[:3, :3] = motion[:3, :3].T
    for row in range(3):
        terms = [motion[column, row] * motion[column, 3] for column in range(3)]
        found[row, 3] = -((terms[0] + terms[1]) + terms[2])
    return found


def product(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.float32]:
    """One rounding for each further term, as fused; what a library does for such small ones, the processor decides."""
    found = np.zeros((4, 4), np.float32)
    for row in range(4):
        for column in range(4):
            for term in range(4):
                exact = float(first[row, term]) * float(second[term, column])
                found[row, column] = np.float32(exact + float(found[row, column]))
    return found


def slow_stp3(sample: SampleTruth, plan: Floats) -> FurtherVerdicts:
    poses, rasters = axle_poses(sample), []
    chained = np.eye(4, dtype=np.float32)
    for step in range(6):
        raster = np.zeros((200, 200), np.uint8)
        for row, name in enumerate(sample.categories):
            kind = name.startswith(("human.", "vehicle."))
            seen = sample.annotated[row, 0] if sample.seen_before is None else sample.seen_before[row]
            if kind and seen and sample.annotated[row, step + 1] and sample.ego_future_valid[step]:
                box = moved(in_ego(sample.boxes[row, step + 1], sample.lidar_ahead_m), poses[0], poses[step + 1])
                nodes = [(round((y + 50.0) / 0.5), round((x + 50.0) / 0.5)) for x, y in slow.corners(box)]
                slow.fill(raster, nodes)
        back = product(inverse(matrix(poses[step + 1])), matrix(poses[step]))
        angle = float(torch.atan2(torch.tensor(-back[0, 1]), torch.tensor(back[0, 0])))
        chained = product(chained, inverse(matrix(np.array([back[0, 3], back[1, 3], angle]))))
        rasters.append(warped(raster, chained))
    recorded = [slow.covers(rasters[step], stp3_block(sample.ego_future[step, :2])) for step in range(6)]
    before = [slow.covers(rasters[step], stp3_block(plan[step])) for step in range(6)]
    collision = [hit and not own for hit, own in zip(before, recorded)]
    obj_col = []
    for step in range(6):
        row, column = math.trunc((plan[step, 1] + 49.75) / 0.5), math.trunc((-plan[step, 0] + 49.75) / 0.5)
        inside = 0 <= row < 200 and 0 <= column < 200
        obj_col.append(inside and bool(rasters[step][row, column]) and not recorded[step])
    steps = {"before_mask": before, "recorded": recorded, "collision": collision, "obj_col": obj_col}
    values = {name: means(flags) for name, flags in {"collision": collision, "obj_col": obj_col}.items()}
    values["l2"] = means(slow.displacements(sample, plan))
    apart = slow.displacements(sample, plan)
    return FurtherVerdicts(all(sample.ego_future_valid) and sample.index >= 2, steps, values, rasters, apart)


def warped(raster: Grid, motion: NDArray[np.float32]) -> Grid:
    """The raster of a future frame in the present one."""
    angle = torch.atan2(torch.tensor(-motion[0, 1]), torch.tensor(motion[0, 0]))
    forward, left = torch.tensor(motion[0, 3]), torch.tensor(motion[1, 3])
    rows = [[torch.cos(angle), -torch.sin(angle), left / 50], [torch.sin(angle), torch.cos(angle), -forward / 50]]
    # The centres of the cells are PyTorch's; its product with them is rounded as the processor's library likes.
    centres = functional.affine_grid(torch.eye(2, 3)[None], [1, 1, 200, 200], align_corners=False)[0]
    places = [cos * centres[..., 0] + sin * centres[..., 1] + moved for cos, sin, moved in rows]
    grid = torch.stack(places, -1)[None]
    picture = torch.from_numpy(raster)[None, None].float()
    found = functional.grid_sample(picture, grid, mode="nearest", padding_mode="zeros", align_corners=False)
    return np.asarray(found[0, 0].numpy(), np.uint8)


def stp3_block(place: Floats) -> list[tuple[int, int]]:
    """Rows forward and columns to the left of the ego at a waypoint."""
    right, ahead = (float(np.float32(value) / np.float32(0.5)) for value in place)
    return [
        (slow.onto_grid(math.trunc(ahead + row)), slow.onto_grid(math.trunc(-right + column)))
        for row, column in slow.BLOCK
    ]


def slow_bev_planner(sample: SampleTruth, plan: Floats) -> FurtherVerdicts:
    rasters, kerb = [], np.zeros((1000, 1000), np.uint8)
    for step in range(6):
        raster = np.zeros((1000, 1000), np.uint8)
        for row, name in enumerate(sample.categories):
            there = sample.annotated[row, step + 1] and sample.has_points[row, step + 1]
            if name in slow.UNIAD_NAMES and there and sample.ego_future_valid[step]:
                box = np.array(in_ego(sample.boxes[row, step + 1], sample.lidar_ahead_m))
                slow.fill(raster, [(single_cell(x), single_cell(y)) for x, y in slow.single_corners(box)])
        rasters.append(raster)
    if sample.roads is not None:
        for line in sample.roads.kerb_lines():
            cells = [[min(max(single_cell(value), 0), 999) for value in point] for point in line]
            for start, end in pairwise(cells):
                cv2.line(kerb, start, end, (1,), 1)
    paths = [[(float(y), float(-x)) for x, y in path] for path in (plan, sample.ego_future[:, :2])]
    feet = [[foot(path, step, np.float32) for step in range(6)] for path in paths]
    points = [[(single_cell(np.float32(left)), single_cell(np.float32(ahead)))] for ahead, left in paths[0]]
    inside = [all(0 <= cell < 1000 for cell in point[0]) for point in points]
    before, recorded = ([slow.covers(rasters[step], cells[step]) for step in range(6)] for cells in feet)
    at_kerb, own_kerb = ([slow.covers(kerb, cells[step]) for step in range(6)] for cells in feet)
    steps = {
        "before_mask": before,
        "recorded": recorded,
        "kerb_before_mask": at_kerb,
        "kerb_recorded": own_kerb,
        "collision": [hit and not own for hit, own in zip(before, recorded)],
        "kerb": [hit and not own for hit, own in zip(at_kerb, own_kerb)],
        "obj_col": [inside[at] and slow.covers(rasters[at], points[at]) and not recorded[at] for at in range(6)],
        "kerb_point": [inside[at] and slow.covers(kerb, points[at]) and not own_kerb[at] for at in range(6)],
    }
    values = {name: largest(steps[name]) for name in ("collision", "obj_col", "kerb")}
    values |= {"kerb_point": means(steps["kerb_point"]), "l2": means(slow.displacements(sample, plan))}
    return FurtherVerdicts(all(sample.ego_future_valid), steps, values, [*rasters, kerb])


def slow_omnidrive(sample: SampleTruth, plan: Floats) -> FurtherVerdicts:
    """From a plan of the lidar: moved to the rear axle and written."""
    ahead, path = sample.lidar_ahead_m, []
    for pose in slow.exact_poses(plan)[1:]:
        heading = pose[2] - math.pi / 2
        place = (pose[1] + ahead - ahead * math.cos(heading), -pose[0] - ahead * math.sin(heading))
        path.append((written(place[0]), written(place[1])))
    now, poses = axle_poses(sample)[0], axle_poses(sample)[1:]
    local = [moved([*pose[:2], 0.0, 0.0, 0.0], np.zeros(3), now) for pose in poses]
    return omnidrive_on(sample, path, [(place[0], place[1]) for place in local])


def omnidrive_on(sample: SampleTruth, path: Path, own: Path) -> FurtherVerdicts:
    """Of a plan of the rear axle as it is, beside the recorded one."""
    rasters, ahead = [], sample.lidar_ahead_m
    for step in range(6):
        raster = np.zeros((1000, 1000), np.uint8)
        for row, name in enumerate(sample.categories):
            if name in VEHICLES_OF_ALL_KINDS and sample.annotated[row, : step + 2].all():
                box = in_ego(sample.boxes[row, step + 1], ahead)
                box[2:4] = sample.boxes[row, 0, 2:4]
                nodes = [(round((x + 50.0) / 0.1), round((y + 50.0) / 0.1)) for x, y in slow.corners(box)]
                slow.fill(raster, nodes)
        rasters.append(raster)
    before, recorded = (
        [slow.covers(rasters[step], foot(each, step, np.float64)) for step in range(6)] for each in (path, own)
    )
    steps = {
        "before_mask": before,
        "recorded": recorded,
        "collision": [hit and not itself for hit, itself in zip(before, recorded)],
    }
    values = {"collision": largest(steps["collision"])}
    apart = [math.dist(path[at], own[at]) if sample.ego_future_valid[at] else 0.0 for at in range(6)]
    values["l2"] = means(apart)
    if sample.roads is not None:
        drivable = sample.roads.drivable_cells()
        origin = [(0.0, 0.0), *path]
        turns = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(origin)]
        off = [leaves(drivable, place[0], place[1], turn) for place, turn in zip(path, turns)]
        steps["off_road"] = off
        off_now = leaves(drivable, 0.0, 0.0, 0.0)
        values["off_road"] = [0.0 if off_now else value for value in largest(off)]
    return FurtherVerdicts(all(sample.ego_future_valid), steps, values, rasters)


def mirrored_points(
    sample: SampleTruth, plan: Floats, judge: Callable[..., slow.SlowVerdicts], *, rows: bool
) -> list[bool]:
    """The cell below each waypoint on such a raster."""
    rasters = judge(sample, plan).rasters
    assert rasters is not None
    found = []
    for step, (x, y) in enumerate(plan.tolist()):
        raster = rasters[step][::-1, ::-1] if rows else rasters[step][:, ::-1]
        row, column = math.trunc((y + 49.75) / 0.5), math.trunc((-x + 49.75) / 0.5)
        found.append(0 <= row < 200 and 0 <= column < 200 and bool(raster[row, column]))
    return found


def with_points(sample: SampleTruth) -> SampleTruth:
    """The sample with lidar points on everything that is annotated."""
    return replace(sample, has_lidar_points=sample.annotated)


def touches_now(sample: SampleTruth, *, everything: bool) -> bool:
    """Whether the ego touches a box now."""
    ego = shapely.Polygon(slow.corners(slow.ego_box(0.0, 0.0, math.pi / 2)))
    seen = sample.annotated[:, 0] & (sample.has_lidar_points[:, 0] | everything)
    return any(ego.intersects(shapely.Polygon(slow.corners(box))) for box in sample.boxes[seen, 0])


def slow_mirrored(
    sample: SampleTruth, plan: Floats, judge: Callable[..., slow.SlowVerdicts], *, rows: bool
) -> list[bool]:
    """``before_mask`` on a stored raster that is flipped (rows too, for VAD's), with x negated once."""
    rasters = judge(sample, plan).rasters
    assert rasters is not None
    flipped = [raster[::-1, ::-1] if rows else raster[:, ::-1] for raster in rasters]
    mirrored = plan * [-1.0, 1.0]
    return [slow.covers(flipped[step], slow.uniad_block(mirrored[step])) for step in range(6)]


def in_ego(box: Floats, ahead: float) -> list[float]:
    """A box of the lidar frame, x forward, y left of the rear axle."""
    x, y, length, width, yaw = (float(value) for value in box)
    return [y + ahead, -x, length, width, yaw - math.pi / 2]


def moved(box: list[float], of: Floats, to: Floats) -> list[float]:
    """A box from the frame of one pose to that of another."""
    x = of[0] + box[0] * math.cos(of[2]) - box[1] * math.sin(of[2]) - to[0]
    y = of[1] + box[0] * math.sin(of[2]) + box[1] * math.cos(of[2]) - to[1]
    along, left = x * math.cos(to[2]) + y * math.sin(to[2]), y * math.cos(to[2]) - x * math.sin(to[2])
    return [along, left, *box[2:4], box[4] + of[2] - to[2]]


def single_cell(value: np.float32) -> int:
    return math.trunc(float((value + np.float32(49.95)) / np.float32(0.1)))


def foot(path: Path, step: int, kind: type[np.float32 | np.float64]) -> list[tuple[int, int]]:
    """Cells of the ego on the fine grid, each rounded alone."""
    before = path[step - 1] if step else (0.0, 0.0)
    dx, dy = path[step][0] - before[0], path[step][1] - before[1]
    heading = math.atan2(dy, dx) if math.hypot(dx, dy) >= 1.0 else 0.0
    cos, sin = kind(np.float32(math.cos(heading))), kind(np.float32(math.sin(heading)))
    shift = [kind(value) / kind(np.float32(0.1)) for value in path[step]]
    found = []
    for row in range(491, 509):
        for column in range(494, 535):
            x, y = kind(column - 499.5), kind(row - 499.5)
            along = np.round(cos * x - sin * y + kind(499.5)) + shift[0]
            across = np.round(sin * x + cos * y + kind(499.5)) + shift[1]
            found.append((min(max(math.trunc(float(across)), 0), 999), min(max(math.trunc(float(along)), 0), 999)))
    return found


def written(value: float) -> float:
    """A number as OmniDrive's text has it."""
    return 0.0 if abs(round(value, 2)) <= 0.01 else round(value, 2)


def leaves(drivable: Grid, x: float, y: float, heading: float) -> bool:
    """Whether a cell of the rectangle at the kerb is not drivable."""
    grid = np.zeros_like(drivable)
    box = [x + 1.485793, y, 4.08, 1.85, heading]
    slow.fill(grid, [(round((a + 50.0) / 0.1), round((b + 50.0) / 0.1)) for a, b in slow.corners(box)])
    return bool((grid > drivable).any())


def means(values: list[bool] | list[float]) -> list[float]:
    return [sum(values[:count]) / count for count in (2, 4, 6)]


def largest(values: list[bool]) -> list[float]:
    return [float(any(values[:count])) for count in (2, 4, 6)]
