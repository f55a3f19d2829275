"""Scenes for tests of conditions: tilted sensors, recordings whose sensors have clocks of their own."""

from dataclasses import replace

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

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


def busy_scene(seconds: float = 17 / 12, name: str = "scene-9901") -> Scene:
    """Objects on all sides, the lidar a little tilted as in nuScenes, and a map with all kinds of layers."""
    scene = scene_on_straight_road(CARS, seconds=seconds, name=name)
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
    later_us = (int(name[-4:]) - 9901) * 60_000_000
    return replace(scene, lidar=lidar, road_map=road_map, timestamps_us=scene.timestamps_us + later_us)


def as_recording(scene: Scene) -> Scene:
    """The scene as a data set with sweeps would give it."""
    frames = np.arange(len(scene.timestamps_us))
    sensors = SensorFrames.of(scene, frames)
    order = [MODEL_CAMERAS.index(camera.name) for camera in scene.cameras]
    return replace(scene, sweep_poses=SweepPoses(sensors.lidar, sensors.cameras[order]))
