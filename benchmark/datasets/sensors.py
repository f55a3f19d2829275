"""Cameras and lidar of a nuScenes data set: calibration, and images on demand."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M, LIDAR_NAME
from benchmark.datasets.tables import Row
from benchmark.geometry import quaternion_from_yaw, transform_matrix
from benchmark.planning import CameraView
from benchmark.scene import Camera, LidarMount
from benchmark.untrusted.pictures import read_picture


def standard_lidar() -> LidarMount:
    """LIDAR_TOP as on the nuScenes cars, for data sets that have no lidar calibration: +y forward, 1.84 m high."""
    return LidarMount(np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, 1.84]), quaternion_from_yaw(np.array(-np.pi / 2)))


def read_lidar(nusc: Any, sample: Row) -> LidarMount:
    """Mount of LIDAR_TOP at a sample, or `standard_lidar` where the data set has none."""
    if LIDAR_NAME not in sample["data"]:
        return standard_lidar()
    row = nusc.get("sample_data", sample["data"][LIDAR_NAME])
    mount = nusc.get("calibrated_sensor", row["calibrated_sensor_token"])
    return LidarMount(np.array(mount["translation"], np.float64), np.array(mount["rotation"], np.float64))


def read_cameras(nusc: Any, sample: Row) -> tuple[Camera, ...]:
    """Calibrated cameras at a sample, those of nuScenes first and in its order; possibly none."""
    return tuple(_camera(nusc, row) for row in _camera_rows(nusc, sample))


def read_views(nusc: Any, root: Path, sample: Row) -> dict[str, CameraView]:
    """Images of a sample by camera name, in the order of `read_cameras`.

    Files are opened only when a view is loaded.
    """
    views = (view_of(nusc, root, row, _camera(nusc, row)) for row in _camera_rows(nusc, sample))
    return {view.camera.name: view for view in views}


def view_of(nusc: Any, root: Path, row: Row, camera: Camera) -> CameraView:
    """One image, from its row of the sample_data table; its file is opened only when it is loaded."""
    pose = nusc.get("ego_pose", row["ego_pose_token"])
    path = root / row["filename"]
    return CameraView(
        camera=camera,
        path=path,
        timestamp_us=row["timestamp"],
        global_T_ego=transform_matrix(pose["rotation"], pose["translation"]),
        load=partial(read_picture, path),
    )


def _camera_rows(nusc: Any, sample: Row) -> list[Row]:
    rows = [nusc.get("sample_data", token) for token in sample["data"].values()]
    rank = {name: index for index, name in enumerate(CAMERA_NAMES)}
    cameras = [row for row in rows if row["sensor_modality"] == "camera"]
    return sorted(cameras, key=lambda row: (rank.get(row["channel"], len(rank)), row["channel"]))


def _camera(nusc: Any, row: Row) -> Camera:
    calibration = nusc.get("calibrated_sensor", row["calibrated_sensor_token"])
    return Camera(
        name=row["channel"],
        translation=np.array(calibration["translation"], np.float64),
        rotation=np.array(calibration["rotation"], np.float64),
        intrinsic=np.array(calibration["camera_intrinsic"], np.float64),
        width=row["width"],
        height=row["height"],
    )
