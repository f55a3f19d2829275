"""What a data set holds of the things that queries are for: boxes, map elements, futures and plans."""

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from adapters.networks.sparse.anchors import Sightings
from adapters.networks.sparse.config import SparseConfig
from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES, PLAN_STEPS
from benchmark.datasets.roots import DataSet
from benchmark.datasets.sample_truth import planar_lidar_poses
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global, to_local, transform_matrix, yaw_of_quaternion
from benchmark.planning import Command
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

MAP_ASIDE_M: Final = 15.0
MAP_AHEAD_M: Final = 30.0
"""Half the sides of the rectangle around the lidar in which map elements are looked for."""


def sightings_of(data: DataSet, split: str | None, config: SparseConfig) -> Sightings:
    """Sightings of all key frames of a split, in the order of scenes and time.

    Futures and plans that the recording cuts off are left out. A network that plans other steps than a data set has is
    an `InputError`.
    """
    if config.steps != PLAN_STEPS:
        raise InputError(f"a data set has plans of {PLAN_STEPS} steps, and the network needs {config.steps}")
    boxes: list[Floats] = [np.zeros((0, 3))]
    middles: list[Floats] = [np.zeros((0, 2))]
    futures: list[list[Floats]] = [[np.zeros((0, config.agent_steps, 2))] for _ in DETECTION_CLASSES]
    plans: list[list[Floats]] = [[np.zeros((0, PLAN_STEPS, 2))] for _ in Command]
    for name in data.scene_names(split):
        scene = data.scene(name)
        classes = detected_classes(scene)
        boxes.append(box_centres(scene, classes))
        for pose in planar_lidar_poses(scene) if data.has_map(name) else ():
            middles.append(line_centres(scene.road_map, pose, config.points_per_line))
        for row, kind in enumerate(classes):
            if kind >= 0:
                futures[kind].append(agent_futures(scene, row, config.agent_steps))
        for command, plan in _plans(data.truth(name)):
            plans[command].append(plan[None])
    return Sightings(
        box_centres=np.concatenate(boxes),
        line_centres=np.concatenate(middles),
        futures=[np.concatenate(found) for found in futures],
        plans=[np.concatenate(found) for found in plans],
    )


def box_centres(scene: Scene, classes: Sequence[int]) -> Floats:
    """Centres of annotated boxes at all key frames, (N, 3) metres, lidar frame of the key frame.

    `classes` are those of each agent, negative where it is not detected.
    """
    known, detected = scene.annotations, np.asarray(classes, np.int64) >= 0
    ego_T_lidar = transform_matrix(scene.lidar.rotation, scene.lidar.translation)
    found = [np.zeros((0, 3))]
    for keyframe, frame in enumerate(scene.keyframes):
        global_T_lidar = transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame]) @ ego_T_lidar
        centres = known.position[known.valid[:, keyframe] & detected, keyframe]
        found.append((centres - global_T_lidar[:3, 3]) @ global_T_lidar[:3, :3])
    return np.concatenate(found)


def line_centres(road_map: RoadMap, pose: Floats, points_per_line: int) -> Floats:
    """Means, (L, 2), of the points that `map_lines` gives."""
    return np.asarray(map_lines(road_map, pose, points_per_line)[0].mean(1))


def map_lines(road_map: RoadMap, pose: Floats, points_per_line: int) -> tuple[Floats, NDArray[np.int64]]:
    """Map elements around a planar lidar pose as evenly spaced points: crossings, dividers and the border of the road.

    (L, points_per_line, 2) metres, lidar frame: x right, y forward; (L,) their classes: 0 divider, 1 pedestrian
    crossing, 2 boundary of the road. `pose` is (3,), global.
    """
    corners = np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]]) * [MAP_AHEAD_M, MAP_ASIDE_M]
    window = shapely.Polygon(to_global(corners, pose))
    elements: list[shapely.Geometry] = [
        shapely.boundary(shapely.union_all(list(road_map.ped_crossings.values()))),
        *(shapely.LineString(divider.line) for divider in road_map.dividers),
        shapely.boundary(road_map.drivable_area),
    ]
    kinds = [1, *(0 for _ in road_map.dividers), 2]
    shares = np.linspace(0.0, 1.0, points_per_line)
    found, classes = [np.zeros((0, points_per_line, 2))], []
    for seen, kind in zip(shapely.intersection(elements, window), kinds, strict=True):
        for line in shapely.get_parts(shapely.line_merge(seen)):
            # A line that only touches the rectangle leaves a point.
            if isinstance(line, shapely.LineString) and line.length > 0:
                points = shapely.get_coordinates(shapely.line_interpolate_point(line, shares, normalized=True))
                found.append(points[None])
                classes.append(kind)
    local = to_local(np.concatenate(found), pose)
    return np.stack([-local[..., 1], local[..., 0]], axis=-1), np.array(classes, np.int64)


def agent_futures(scene: Scene, agent: int, steps: int) -> Floats:
    """Recorded futures of an agent from each of its key frames that `steps` others follow without a gap.

    (N, steps, 2) metres in the agent's frame at the start, x forward.
    """
    known = scene.annotations
    yaw = yaw_of_quaternion(known.rotation[agent])
    found = [np.zeros((0, steps, 2))]
    for start in range(len(yaw) - steps):
        if known.valid[agent, start : start + steps + 1].all():
            path = known.position[agent, start : start + steps + 1, :2]
            found.append(to_local(path[1:], np.array([*path[0], yaw[start]]))[None])
    return np.concatenate(found)


def detected_classes(scene: Scene) -> list[int]:
    """Index into `DETECTION_CLASSES` of each agent, -1 where it is not detected."""
    known = (DETECTION_CLASS_OF_CATEGORY.get(category) for category in scene.agents.categories)
    return [-1 if name is None else DETECTION_CLASSES.index(name) for name in known]


def _plans(truths: Sequence[SampleTruth]) -> Iterator[tuple[Command, Floats]]:
    """Command and (6, 2) recorded positions of the lidar, of the samples that have all of them."""
    return ((truth.command, truth.ego_future[:, :2]) for truth in truths if truth.complete)
