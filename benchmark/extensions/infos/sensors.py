"""Cameras and lidar sweeps of a sample, as all three repositories describe a sensor."""

from typing import Any, Final

import numpy as np

from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.tables import Row
from benchmark.extensions.infos.frames import SensorFrame
from benchmark.extensions.infos.scene_rows import SceneRows

SWEEPS: Final = 10
"""Lidar measurements before a sample that an info names at most, key frames of earlier samples among them."""

SensorInfo = dict[str, Any]


def camera_infos(rows: SceneRows, sample: Row, lidar: SensorFrame, prefix: str) -> dict[str, SensorInfo]:
    """Cameras of a sample by channel, in the order that networks take them.

    Raises:
        KeyError: If a camera has no image; `benchmark.extensions.infos.cures.require_cameras` says so in a sentence.
    """
    found = {}
    for channel in CAMERA_NAMES:
        data = rows.key_frames[sample["token"]][channel]
        intrinsic = rows.mounts[data["calibrated_sensor_token"]]["camera_intrinsic"]
        found[channel] = sensor_info(rows, data, channel, lidar, prefix)
        found[channel]["cam_intrinsic"] = np.array(intrinsic, np.float64)
    return found


def sweep_infos(rows: SceneRows, data: Row, lidar: SensorFrame, prefix: str) -> list[SensorInfo]:
    """Lidar measurements before that of a sample, newest first; arguments as in `camera_infos`."""
    found: list[SensorInfo] = []
    while data["prev"] and len(found) < SWEEPS:
        data = rows.data[data["prev"]]
        found.append(sensor_info(rows, data, "lidar", lidar, prefix))
    return found


def sensor_info(rows: SceneRows, data: Row, kind: str, lidar: SensorFrame, prefix: str) -> SensorInfo:
    """One measurement: its file, where the sensor was, and how its points come to the lidar of the sample."""
    mount = rows.mounts[data["calibrated_sensor_token"]]
    pose = rows.poses[data["ego_pose_token"]]
    rotation, translation = rows.frame(data).seen_from(lidar)
    return {
        "data_path": prefix + data["filename"],
        "type": kind,
        "sample_data_token": data["token"],
        "sensor2ego_translation": mount["translation"],
        "sensor2ego_rotation": mount["rotation"],
        "ego2global_translation": pose["translation"],
        "ego2global_rotation": pose["rotation"],
        "timestamp": data["timestamp"],
        "sensor2lidar_rotation": rotation,
        "sensor2lidar_translation": translation,
    }
