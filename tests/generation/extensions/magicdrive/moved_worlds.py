"""Scenes for tests of conditions: tilted sensors, moved worlds, recordings whose sensors have clocks of their own."""

from dataclasses import replace

import numpy as np
import shapely
from scipy.spatial.transform import Rotation
from shapely.affinity import affine_transform

from benchmark.geometry import Floats
from benchmark.road_map import RoadMap
from benchmark.scene import Scene, SweepPoses
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from generation.extensions.magicdrive.sensor_frames import SensorFrames
from tests.hand_made import Car, scene_on_straight_road

CARS = (
    Car(80.0, 198.25, 8.0),
    Car(60.0, 194.75, 10.0, category="vehicle.truck", size=(9.0, 2.6, 3.4)),
    Car(120.0, 201.75, 9.0, np.pi),
    Car(52.0, 205.0, 1.2, 0.4, "human.pedestrian.adult", (0.7, 0.7, 1.8)),
    Car(50.0, 201.75, 8.0, np.pi, "vehicle.bicycle", (1.8, 0.6, 1.7)),
)


def busy_scene(seconds: float = 17 / 12) -> Scene:
    """Objects on all sides, the lidar a little tilted as in nuScenes, and a map with all kinds of layers."""
    scene = scene_on_straight_road(CARS, seconds=seconds)
    tilt = Rotation.from_quat(scene.lidar.rotation[[1, 2, 3, 0]]) * Rotation.from_euler("xy", [0.01, -0.02])
    lidar = replace(scene.lidar, rotation=tilt.as_quat()[[3, 0, 1, 2]])
    holed = shapely.Polygon(
        [(20, 180), (110, 180), (110, 191), (20, 191)], [[(50, 183), (70, 183), (70, 188), (50, 188)]]
    )
    road_map = replace(
        scene.road_map,
        ped_crossings={"zebra": shapely.box(70.0, 193.0, 74.0, 207.0)},
        stop_lines={"stop": shapely.box(90.0, 193.0, 92.0, 200.0)},
        carparks={"park": holed},
        road_blocks={"east": shapely.box(0.0, 193.0, 140.0, 200.0), "west": shapely.box(0.0, 200.0, 140.0, 207.0)},
    )
    return replace(scene, lidar=lidar, road_map=road_map)


def moved(scene: Scene, yaw_rad: float, offset: tuple[float, float, float]) -> Scene:
    """The same world elsewhere: turned about the vertical, then shifted."""
    turn = Rotation.from_euler("z", yaw_rad)
    matrix = turn.as_matrix()

    def points(old: Floats) -> Floats:
        return np.asarray(old @ matrix.T + offset)

    def rotations(old: Floats) -> Floats:
        flat = (turn * Rotation.from_quat(old.reshape(-1, 4)[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]
        return np.asarray(flat.reshape(old.shape))

    shift = [matrix[0, 0], matrix[0, 1], matrix[1, 0], matrix[1, 1], offset[0], offset[1]]
    agents, annotations = scene.agents, scene.annotations
    return replace(
        scene,
        ego=replace(scene.ego, position=points(scene.ego.position), rotation=rotations(scene.ego.rotation)),
        agents=replace(agents, position=points(agents.position), yaw=agents.yaw + yaw_rad),
        annotations=replace(
            annotations, position=points(annotations.position), rotation=rotations(annotations.rotation)
        ),
        road_map=_moved_map(scene.road_map, shift, matrix[:2, :2], np.array(offset[:2])),
    )


def _moved_map(road_map: RoadMap, shift: list[float], matrix: Floats, offset: Floats) -> RoadMap:
    def surfaces(layer: dict[str, shapely.Polygon]) -> dict[str, shapely.Polygon]:
        return {name: affine_transform(shape, shift) for name, shape in layer.items()}

    return replace(
        road_map,
        drivable_area=affine_transform(road_map.drivable_area, shift),
        dividers=tuple(replace(row, line=row.line @ matrix.T + offset) for row in road_map.dividers),
        ped_crossings=surfaces(road_map.ped_crossings),
        walkways=surfaces(road_map.walkways),
        stop_lines=surfaces(road_map.stop_lines),
        carparks=surfaces(road_map.carparks),
        road_blocks=surfaces(road_map.road_blocks),
    )


def as_recording(scene: Scene) -> Scene:
    """The scene as a data set with sweeps would give it."""
    frames = np.arange(len(scene.timestamps_us))
    sensors = SensorFrames.of(scene, frames)
    order = [MODEL_CAMERAS.index(camera.name) for camera in scene.cameras]
    return replace(scene, sweep_poses=SweepPoses(sensors.lidar, sensors.cameras[order]))
