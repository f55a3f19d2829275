"""Cameras and lidar of a nuScenes data set: calibration, images and videos on demand, poses at sweeps by own clocks."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M, LIDAR_NAME
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw, rotation_matrix, transform_matrix
from benchmark.planning import CameraView
from benchmark.scene import Camera, LidarMount, SweepPoses
from benchmark.untrusted.http_images import read_picture


def read_sweep_poses(
    nusc: Any, samples: Sequence[Row], keyframes: NDArray[np.int64], cameras: Sequence[str]
) -> SweepPoses | None:
    """Poses of the sensors at the frames of a scene from K samples in time order and the (K,) frame of each.

    The k-th frame after a keyframe takes the sensor's k-th following row. Where there are fewer rows before the next
    keyframe the last one is repeated. ``None`` where a sensor has no sweeps at all or there is no camera.
    """
    if not cameras:
        return None
    poses = []
    for channel in (LIDAR_NAME, *cameras):
        rows = _rows_at_frames(nusc, samples, np.diff(keyframes).tolist(), channel)
        if rows is None:
            return None
        poses.append(_global_T_sensor(nusc, rows))
    return SweepPoses(poses[0], np.stack(poses[1:]))


def _rows_at_frames(nusc: Any, samples: Sequence[Row], frames: Sequence[int], channel: str) -> list[Row] | None:
    """Rows of one channel at every frame; nothing where a keyframe or all sweeps are missing."""
    if any(channel not in sample["data"] for sample in samples):
        return None
    rows: list[Row] = []
    swept = len(samples) == 1
    for sample, count in zip(samples, frames):
        row: Row = nusc.get("sample_data", sample["data"][channel])
        rows.append(row)
        for _ in range(count - 1):
            following: Row | None = nusc.get("sample_data", row["next"]) if row["next"] else None
            if following is not None and not following["is_key_frame"]:
                row, swept = following, True
            rows.append(row)
    rows.append(nusc.get("sample_data", samples[-1]["data"][channel]))
    return rows if swept else None


def _global_T_sensor(nusc: Any, rows: Sequence[Row]) -> Floats:
    """(T, 4, 4) sensor frame to global frame."""
    chain = []
    for table, link in (("ego_pose", "ego_pose_token"), ("calibrated_sensor", "calibrated_sensor_token")):
        records = [nusc.get(table, row[link]) for row in rows]
        matrix = np.tile(np.eye(4), (len(rows), 1, 1))
        matrix[:, :3, :3] = rotation_matrix(np.array([record["rotation"] for record in records], np.float64))
        matrix[:, :3, 3] = [record["translation"] for record in records]
        chain.append(matrix)
    return np.asarray(chain[0] @ chain[1])


def make_standard_lidar() -> LidarMount:
    """LIDAR_TOP as on the nuScenes cars, for data sets that have no lidar calibration: +y forward, 1.84 m high."""
    return LidarMount(np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, 1.84]), quaternion_from_yaw(np.array(-np.pi / 2)))


def read_lidar(nusc: Any, sample: Row, place: str | None = None) -> LidarMount:
    """Mount of LIDAR_TOP at a sample; where the data set has none, at a stated place or as `make_standard_lidar`."""
    if LIDAR_NAME not in sample["data"]:
        standard = make_standard_lidar()
        return standard if place is None else replace(standard, translation=np.array(place.split(), np.float64))
    row = nusc.get("sample_data", sample["data"][LIDAR_NAME])
    mount = nusc.get("calibrated_sensor", row["calibrated_sensor_token"])
    return LidarMount(np.array(mount["translation"], np.float64), np.array(mount["rotation"], np.float64))


def read_cameras(nusc: Any, sample: Row) -> tuple[Camera, ...]:
    """Calibrated cameras at a sample, those of nuScenes first and in its order; possibly none."""
    return tuple(_camera(nusc, row) for row in _camera_rows(nusc, sample))


def read_views(nusc: Any, root: Path, sample: Row) -> dict[str, CameraView]:
    """Images of a sample by camera, in the order of `read_cameras`; files are opened only when a view is loaded."""
    views = (read_view(nusc, root, row, _camera(nusc, row)) for row in _camera_rows(nusc, sample))
    return {view.camera.name: view for view in views}


def read_view(nusc: Any, root: Path, row: Row, camera: Camera) -> CameraView:
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


def read_videos(nusc: Any, root: Path, samples: Sequence[Row], *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
    """Images by camera name in time order; files are opened only when a view is loaded.

    ``sweeps`` adds the images between keyframes. Cameras are in the order of `read_views` of the first sample.
    """
    videos: dict[str, list[CameraView]] = {}
    for index, sample in enumerate(samples):
        for name, view in read_views(nusc, root, sample).items():
            video = videos.setdefault(name, [])
            video.append(view)
            if sweeps and index + 1 < len(samples):
                video += _sweeps(nusc, root, sample["data"][name], view)
    for name, video in videos.items():
        times = [view.timestamp_us for view in video]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise InputError(
                f"the images of {name} of scene {samples[0]['scene_token']} go back in time; correct sample_data.json"
            )
    return {name: tuple(video) for name, video in videos.items()}


def _sweeps(nusc: Any, root: Path, token: str, keyframe: CameraView) -> list[CameraView]:
    """Views after a keyframe up to the next one; the calibration is that of the keyframe."""
    views: list[CameraView] = []
    row, visited = nusc.get("sample_data", token), {token}
    while row["next"] and row["next"] not in visited:
        visited.add(row["next"])
        row = nusc.get("sample_data", row["next"])
        if row["is_key_frame"]:
            return views
        views.append(read_view(nusc, root, row, keyframe.camera))
    # No keyframe follows although there is a later sample: the chain is broken, and its rows belong nowhere.
    return []
