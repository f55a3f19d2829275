"""`SampleTruth` of every sample: recorded futures seen from the keyframe's lidar, and roads, drawn when asked for."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.polygon import orient

from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEPS
from benchmark.datasets.annotated_objects import find_labelled_keyframes, find_nearest_valid
from benchmark.datasets.steps import KeyFrameSteps, TimedSteps, find_irregular_interval_us, interpolate_values
from benchmark.geometry import Bools, Floats, poses_between, to_global, to_local, wrap_angle, yaw_of_quaternion
from benchmark.planning import Command
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

PATCH_M: Final = (102.4, 50.0)
"""Length and width of the patch around the rear axle in which road edges are looked for."""
_TRIM_M: Final = 0.2
"""Edges this close to the border of the patch are the patch's own."""
_NEIGHBOURHOOD_M: Final = 100.0
LINE_POINTS: Final = 20
DRIVABLE_CELLS: Final = 1000
DRIVABLE_HALF_M: Final = 50.0
_CELLS_PER_M: Final = 10.0
_LINE: Final = 1
"""Shapely's number of the type of lines."""


class SceneRoadSurfaces:
    """Surfaces of a scene's map that its samples share, put together once and when they are asked for."""

    def __init__(self, road_map: RoadMap) -> None:
        self.road_map = road_map
        self._near: tuple[Floats, shapely.Geometry, shapely.MultiPolygon] | None = None

    @cached_property
    def road_edges(self) -> shapely.MultiLineString:
        """Outlines (clockwise) and holes (counter-clockwise) of road segments and lanes as one surface, global."""
        lanes = [lane.polygon for lane in self.road_map.lanes.values() if lane.polygon is not None]
        surface = as_multipolygon(shapely.union_all([*self.road_map.road_segments.values(), *lanes]))
        turned = [orient(polygon, -1.0) for polygon in surface.geoms]
        return shapely.MultiLineString([ring for part in turned for ring in (part.exterior, *part.interiors)])

    def near(self, place: Floats) -> tuple[shapely.Geometry, shapely.MultiPolygon]:
        """Road edges and drivable area within 100 m, and more, of a (2,) global place in metres.

        The next samples share the neighbourhood: no city is searched for each.
        """
        if self._near is None or float(np.abs(self._near[0] - place).max()) > _NEIGHBOURHOOD_M:
            (x, y), half = place, 2.0 * _NEIGHBOURHOOD_M
            window = (x - half, y - half, x + half, y + half)
            drivable = as_multipolygon(shapely.intersection(self.road_map.drivable_area, shapely.box(*window)))
            self._near = place, shapely.clip_by_rect(self.road_edges, *window), drivable
        return self._near[1:]

    @cached_property
    def drivable(self) -> shapely.MultiPolygon:
        """The drivable area, prepared for many questions."""
        shapely.prepare(self.road_map.drivable_area)
        return self.road_map.drivable_area

    @cached_property
    def edges(self) -> shapely.Geometry:
        """Borders of the drivable area, prepared for many questions."""
        edges = self.road_map.drivable_area.boundary
        shapely.prepare(edges)
        return edges


@dataclass(frozen=True, slots=True)
class SampleRoads:
    """`benchmark.truth.Roads` of one sample; ``axle_pose`` is (3,), global x, y, yaw of the rear axle."""

    surfaces: SceneRoadSurfaces
    axle_pose: Floats

    @property
    def has_kerbs(self) -> bool:
        """Whether the map has road segments or lanes with a surface."""
        road_map = self.surfaces.road_map
        return bool(road_map.road_segments) or any(lane.polygon is not None for lane in road_map.lanes.values())

    def kerb_lines(self) -> NDArray[np.float32]:
        """Edges of the union of road segments and lanes in a patch of 102.4 m x 50 m around the rear axle.

        (N, 20, 2) points at equal distances along each edge, ego frame, metres.
        """
        # The border of the patch itself is trimmed away, which leaves the edges within.
        half_x, half_y = 0.5 * PATCH_M[0] - _TRIM_M, 0.5 * PATCH_M[1] - _TRIM_M
        edges = self._in_ego(self.surfaces.near(self.axle_pose[:2])[0])
        pieces = shapely.get_parts(shapely.line_merge(shapely.clip_by_rect(edges, -half_x, -half_y, half_x, half_y)))
        lines = pieces[(shapely.get_type_id(pieces) == _LINE) & (shapely.length(pieces) > 0.0)]
        points = shapely.line_interpolate_point(lines[:, None], np.linspace(0.0, 1.0, LINE_POINTS), normalized=True)
        return np.asarray(shapely.get_coordinates(points).reshape(-1, LINE_POINTS, 2), np.float32)

    def drivable_cells(self) -> NDArray[np.uint8]:
        """The drivable area, each polygon's outline filled and then its holes emptied, vertices on the nearest node.

        (1000, 1000) ones where drivable: row is y, column is x, cells of 0.1 m from -50 m.
        """
        half = DRIVABLE_HALF_M
        nearby = shapely.clip_by_rect(self._in_ego(self.surfaces.near(self.axle_pose[:2])[1]), -half, -half, half, half)
        grid = np.zeros((DRIVABLE_CELLS, DRIVABLE_CELLS), np.uint8)
        for polygon in as_multipolygon(nearby).geoms:
            cv2.fillPoly(grid, [_nodes(polygon.exterior)], (1,))
            cv2.fillPoly(grid, [_nodes(hole) for hole in polygon.interiors], (0,))
        return grid

    def surely_drivable(self, points: Floats, margin_m: float) -> Bools:
        """(K,) whether all within a margin of (K, 2) points in the ego frame, metres, is drivable, without drawing it.

        False within the margin of a border, and for what is not on the grid.
        """
        global_points = shapely.points(to_global(points, self.axle_pose))
        clear = shapely.contains(self.surfaces.drivable, global_points) & ~shapely.dwithin(
            self.surfaces.edges, global_points, margin_m
        )
        return np.asarray(clear & (np.abs(points).max(axis=-1) + margin_m < DRIVABLE_HALF_M), np.bool_)

    def _in_ego(self, shape: shapely.Geometry) -> shapely.Geometry:
        x, y, yaw = self.axle_pose
        cos, sin = np.cos(yaw), np.sin(yaw)

        def moved(points: Floats) -> Floats:
            offset = points - [x, y]
            along, across = offset @ [cos, sin], offset @ [-sin, cos]
            return np.stack([along, across], axis=-1)

        return shapely.transform(shape, moved)


def _nodes(ring: shapely.LinearRing) -> NDArray[np.int32]:
    return np.asarray(np.round((shapely.get_coordinates(ring) + DRIVABLE_HALF_M) * _CELLS_PER_M), np.int32)


HIDDEN = 1
"""nuScenes' visibility level of what is visible to 40 % at most."""
KEYFRAMES_BEFORE = 2
"""Keyframes before the present in which an object may have been seen: the last second."""


def compute_truth(scene: Scene, sample_tokens: Sequence[str], steps: int = PLAN_STEPS) -> tuple[SampleTruth, ...]:
    """Recorded truth around each sample in time order, by annotations as they are, never the interpolated tracks."""
    lidar_poses = compute_planar_lidar_poses(scene)
    boxes_yaw = yaw_of_quaternion(scene.annotations.rotation)
    surfaces = None if scene.road_map.drivable_area.is_empty else SceneRoadSurfaces(scene.road_map)
    labelled = find_labelled_keyframes(scene.annotations.valid.sum(axis=0))
    clock = KeyFrameSteps.of(scene)
    truths = (
        _truth(scene, token, index, lidar_poses, boxes_yaw, surfaces, labelled, steps)
        for index, token in enumerate(sample_tokens)
    )
    if find_irregular_interval_us(clock.times_us) is not None:
        truths = (replace(truth, at_two_hz=False) for truth in truths)
    return tuple(
        truth
        if clock.are_key_frames(truth.index, steps)
        else _add_timed_truth(truth, scene, boxes_yaw, clock.at(truth.index, np.arange(steps + 1)))
        for truth in truths
    )


def compute_planar_lidar_poses(scene: Scene) -> Floats:
    """(K, 3) global x, y of LIDAR_TOP at the keyframes, and the heading of the car."""
    pose = scene.ego.pose[scene.keyframes]
    ahead_m = float(scene.lidar.translation[0])
    pose[:, :2] += ahead_m * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])])
    return pose


def compute_command(future: Floats, valid: Bools) -> Command:
    """Driving command from (6, 2+) recorded lidar positions, x right, and (6,) whether each exists.

    Right or left from 2 m of lateral displacement at the last valid waypoint, else straight.
    """
    if not valid.any():
        return Command.STRAIGHT
    lateral_m = float(future[np.flatnonzero(valid)[-1], 0])
    if lateral_m >= COMMAND_LATERAL_M:
        return Command.RIGHT
    return Command.LEFT if lateral_m <= -COMMAND_LATERAL_M else Command.STRAIGHT


def compute_ego_future(lidar_poses: Floats, index: int, count: int = PLAN_STEPS) -> tuple[Floats, Bools]:
    """(K, 3) global lidar poses, at the plan's N steps and in the lidar frame of a keyframe.

    (N, 3) x right, y forward, yaw (held past the end) and (N,) whether the keyframe exists.
    """
    steps = index + 1 + np.arange(count)
    valid = steps < len(lidar_poses)
    return _in_lidar(lidar_poses[np.minimum(steps, len(lidar_poses) - 1)], lidar_poses[index]), valid


def compute_recorded_command(scene: Scene, clock: KeyFrameSteps, lidar_poses: Floats, index: int) -> Command:
    """Driving command by (K, 3) global lidar poses: from key frames ahead, or from equal times where irregular."""
    if clock.are_key_frames(index, PLAN_STEPS):
        return compute_command(*compute_ego_future(lidar_poses, index))
    return _timed_command(scene, lidar_poses[index], clock.at(index, np.arange(1, PLAN_STEPS + 1)))


def _timed_command(scene: Scene, lidar_pose: Floats, steps: TimedSteps) -> Command:
    """The command from where the car was at some times; a gap in between says nothing against where it came to."""
    return compute_command(_timed_future(scene, lidar_pose, steps), steps.recorded)


def _timed_future(scene: Scene, lidar_pose: Floats, steps: TimedSteps) -> Floats:
    """(N, 3) poses of the lidar at some times, in its frame at the sample."""
    axle = interpolate_values(scene.ego.pose, scene.timestamps_us, steps.times_us)
    return _in_lidar(_to_lidar_poses(axle, float(scene.lidar.translation[0])), lidar_pose)


def _to_lidar_poses(axle_poses: Floats, ahead_m: float) -> Floats:
    """Poses (..., 3) of the lidar from those of the rear axle."""
    ahead = ahead_m * np.stack([np.cos(axle_poses[..., 2]), np.sin(axle_poses[..., 2])], axis=-1)
    return np.concatenate([axle_poses[..., :2] + ahead, axle_poses[..., 2:]], axis=-1)


def _in_lidar(poses: Floats, frame: Floats) -> Floats:
    """Poses (..., 3) in the planar lidar frame: x right, y forward, straight ahead is pi/2."""
    local = to_local(poses[..., :2], frame)
    yaw = wrap_angle(poses[..., 2] - frame[2] + np.pi / 2)
    return np.stack([-local[..., 1], local[..., 0], yaw], axis=-1)


def _truth(
    scene: Scene,
    token: str,
    index: int,
    lidar_poses: Floats,
    boxes_yaw: Floats,
    surfaces: SceneRoadSurfaces | None,
    labelled: Bools,
    count: int,
) -> SampleTruth:
    known = scene.annotations
    axle_poses = scene.ego.pose[scene.keyframes]
    steps = index + np.arange(count + 1)
    exists = steps < len(scene.keyframes)
    steps = np.minimum(steps, len(scene.keyframes) - 1)
    visible_rows = np.flatnonzero((known.valid[:, steps] & exists).any(axis=-1))
    annotated: NDArray[np.bool_] = known.valid[visible_rows][:, steps] & exists
    rows, columns = (
        visible_rows[:, None],
        steps[find_nearest_valid(annotated)] if len(visible_rows) else np.zeros((0, count + 1), np.int64),
    )
    poses = np.concatenate([known.position[rows, columns, :2], boxes_yaw[rows, columns][..., None]], axis=-1)
    local = _in_lidar(poses, lidar_poses[index])
    boxes = np.concatenate([local[..., :2], known.size[rows, columns, :2], local[..., 2:]], axis=-1)
    lidar_points, radar_points = known.num_lidar_pts[rows, columns], known.num_radar_pts[rows, columns]
    future, future_valid = compute_ego_future(lidar_poses, index, count)
    past = slice(max(index - KEYFRAMES_BEFORE, 0), index + 1)
    return SampleTruth(
        scene=scene.name,
        sample_token=token,
        index=index,
        timestamp_us=int(scene.timestamps_us[scene.keyframes[index]]),
        lidar_pose=lidar_poses[index],
        lidar_ahead_m=float(scene.lidar.translation[0]),
        ego_future=future,
        ego_future_valid=future_valid,
        command=compute_command(future, future_valid),
        instances=tuple(scene.agents.ids[row] for row in visible_rows),
        categories=tuple(scene.agents.categories[row] for row in visible_rows),
        boxes=boxes,
        annotated=annotated,
        has_points=annotated & (lidar_points + radar_points > 0),
        has_lidar_points=annotated & (lidar_points > 0),
        adversaries=frozenset(scene.adversaries),
        axle_poses=axle_poses[steps],
        seen_before=(known.valid[visible_rows, past] & (known.visibility[visible_rows, past] != HIDDEN)).any(axis=-1),
        roads=None if surfaces is None else SampleRoads(surfaces, axle_poses[index]),
        labelled=bool(labelled[index : index + count + 1].all()),
    )


def _add_timed_truth(truth: SampleTruth, scene: Scene, boxes_yaw: Floats, steps: TimedSteps) -> SampleTruth:
    """A truth whose steps are key frames, and beside it that of the times of steps.

    The ego is interpolated between frames, objects between the key frames around a time: they are there if they are
    annotated at both, have the size and points of the nearer one, and do not exist at times that are not known.
    """
    known = scene.annotations
    is_there = known.valid[:, steps.before] & known.valid[:, steps.after] & steps.known
    visible_rows = np.flatnonzero(is_there.any(axis=-1))
    annotated: NDArray[np.bool_] = is_there[visible_rows]
    nearest_known = find_nearest_valid(annotated) if len(visible_rows) else np.zeros(annotated.shape, np.int64)
    rows, nearest = visible_rows[:, None], steps.nearest[nearest_known]
    poses = np.concatenate([known.position[..., :2], boxes_yaw[..., None]], axis=-1)
    between = poses_between(
        poses[rows, steps.before[nearest_known]], poses[rows, steps.after[nearest_known]], steps.fraction[nearest_known]
    )
    local = _in_lidar(between, truth.lidar_pose)
    lidar_points, radar_points = known.num_lidar_pts[rows, nearest], known.num_radar_pts[rows, nearest]
    # Once a step is unknown all later ones are, so the last known one is held.
    last = np.minimum(np.arange(len(steps.known)), np.count_nonzero(steps.known) - 1)
    future = _timed_future(scene, truth.lidar_pose, steps)
    command = compute_command(future[1:], steps.recorded[1:])
    timed = replace(
        truth,
        command=command,
        ego_future=future[last][1:],
        ego_future_valid=steps.known[1:],
        instances=tuple(scene.agents.ids[row] for row in visible_rows),
        categories=tuple(scene.agents.categories[row] for row in visible_rows),
        boxes=np.concatenate([local[..., :2], known.size[rows, nearest, :2], local[..., 2:]], axis=-1),
        annotated=annotated,
        has_points=annotated & (lidar_points + radar_points > 0),
        has_lidar_points=annotated & (lidar_points > 0),
        axle_poses=interpolate_values(scene.ego.pose, scene.timestamps_us, steps.times_us)[last],
        seen_before=None,
        cut_short=bool(steps.recorded.all() and not steps.known.all()),
    )
    return replace(truth, command=command, timed=timed)
