"""Frames of lidar and cameras over a clip, and how the model's pictures lie in the camera's (sections 4.3, 4.4, 9)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmark.errors import InputError
from benchmark.geometry import Floats, rotation_matrix, transform_matrix
from benchmark.scene import Camera, EgoTrack, Scene
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS

CALIBRATION_SIZE: Final = (1600, 900)
"""Image size, pixels, that intrinsic matrices for the model refer to at every output size."""
_NEGLIGIBLE: Final = 1e-6


@dataclass(frozen=True, slots=True)
class SensorFrames:
    """Sensors at the frames of a clip; V cameras in the model's order.

    (T, 4, 4) lidar and (V, T, 4, 4) camera axes (x right, y down, z forward) to global frame, metres; (V, 3, 3) pinhole
    matrices for images of 1600 x 900 pixels.
    """

    lidar: Floats
    cameras: Floats
    intrinsics: Floats

    @classmethod
    def of(cls, scene: Scene, frames: NDArray[np.int64]) -> Self:
        """Place the sensors at (T,) frames; all six cameras have to be there.

        Where the source of the scene has sweeps of its own, each sensor stands where its sweep was taken, as in the
        model's training; otherwise all share the ego pose of the frame.
        """
        order = find_model_order(scene)
        chosen = [scene.cameras[index] for index in order]
        intrinsics = np.stack([camera.resized(*CALIBRATION_SIZE).intrinsic for camera in chosen])
        if scene.sweep_poses is not None:
            swept = scene.sweep_poses
            return cls(swept.lidar[frames], swept.cameras[np.array(order)][:, frames], intrinsics)
        ego = _compute_ego_poses(scene, frames)
        mounts = np.stack([transform_matrix(camera.rotation, camera.translation) for camera in chosen])
        lidar = transform_matrix(scene.lidar.rotation, scene.lidar.translation)
        return cls(ego @ lidar, ego[None] @ mounts[:, None], intrinsics)

    @property
    def lidar_from_camera(self) -> Floats:
        """(V, T, 4, 4) camera axes to the lidar frame of the same frame, by way of the global frame."""
        return np.asarray(np.linalg.inv(self.lidar)[None] @ self.cameras)

    @property
    def camera_from_lidar(self) -> Floats:
        """(V, T, 4, 4) lidar frame to the camera axes of the same frame."""
        return np.asarray(np.linalg.inv(self.cameras) @ self.lidar[None])


def compute_camera_parameters(sensors: SensorFrames) -> NDArray[np.float32]:
    """Parameters of the cameras for the model: (V, T, 3, 7) intrinsic matrix beside the camera->lidar transform."""
    transforms = sensors.lidar_from_camera[:, :, :3]
    intrinsics = np.broadcast_to(sensors.intrinsics[:, None], (*transforms.shape[:2], 3, 3))
    return np.asarray(np.concatenate([intrinsics, transforms], axis=-1), np.float32)


def compute_ego_motion(sensors: SensorFrames) -> NDArray[np.float32]:
    """(T, 4, 4) transforms of points from the first lidar frame to this one; entries below one millionth are zero."""
    motion = np.linalg.inv(sensors.lidar) @ sensors.lidar[0]
    motion[0] = np.eye(4)
    motion[np.abs(motion) < _NEGLIGIBLE] = 0.0
    return np.asarray(motion, np.float32)


def find_model_order(scene: Scene) -> Sequence[int]:
    """Index of each of the model's cameras in the scene; raises `InputError` if one is missing or has no lens."""
    names = [camera.name for camera in scene.cameras]
    missing = [name for name in MODEL_CAMERAS if name not in names]
    if missing:
        available = ", ".join(names) or "none"
        raise InputError(
            f"{scene.name} has no camera {missing[0]} (it has {available}); MagicDriveDiT draws the six views of "
            "nuScenes, add its calibration or import the scene with the standard rig"
        )
    cameras: list[Camera] = [scene.cameras[names.index(name)] for name in MODEL_CAMERAS]
    for camera in cameras:
        focal = camera.intrinsic[[0, 1], [0, 1]]
        if not np.isfinite(camera.intrinsic).all() or not (focal > 0).all():
            raise InputError(
                f"camera {camera.name} of {scene.name} has no positive focal lengths; correct its camera_intrinsic in "
                "calibrated_sensor.json"
            )
    return [names.index(name) for name in MODEL_CAMERAS]


def _compute_ego_poses(scene: Scene, frames: NDArray[np.int64]) -> Floats:
    """(T, 4, 4) ego frame to global frame."""
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, :3] = rotation_matrix(scene.ego.rotation[frames])
    poses[:, :3, 3] = scene.ego.position[frames]
    return poses


def build_camera_tracks(scene: Scene) -> dict[str, EgoTrack]:
    """Ego motion at the times of each camera, by its name; none where all sensors share the ego pose of the frame."""
    if scene.sweep_poses is None:
        return {}
    tracks = {}
    for camera, poses in zip(scene.cameras, scene.sweep_poses.cameras, strict=True):
        ego = poses @ np.linalg.inv(transform_matrix(camera.rotation, camera.translation))
        quaternions = Rotation.from_matrix(ego[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
        tracks[camera.name] = EgoTrack(ego[:, :3, 3], quaternions)
    return tracks


OutputSize = Literal["model", "1600x900"]
_CELL_PX: Final = 8


@dataclass(frozen=True, slots=True)
class ImageGeometry:
    """Sizes of the pictures that are drawn and of those that are written.

    `output` is the camera's full size, which is that of the published data sets and what SparseDrive's crop needs, or
    ``model`` for pictures as drawn. At full size the rows that the model does not draw, 4 of 900 at 224 x 400, repeat
    the first one below.
    """

    height: int = 224
    width: int = 400
    output: OutputSize = "1600x900"

    def __post_init__(self) -> None:
        full_width, full_height = CALIBRATION_SIZE
        if self.width % _CELL_PX or self.height % _CELL_PX or min(self.width, self.height) < _CELL_PX:
            raise InputError(f"MagicDriveDiT draws multiples of 8 pixels, not {self.height}x{self.width}")
        if self.height > self.width * full_height / full_width:
            raise InputError(f"pictures of {self.height}x{self.width} are higher than those of a nuScenes camera")

    @property
    def scale(self) -> float:
        """Pixels of a drawn picture for one of the camera."""
        return self.width / CALIBRATION_SIZE[0]

    @property
    def cut_rows(self) -> float:
        """Rows above the drawn picture that the camera sees, in drawn pixels."""
        return CALIBRATION_SIZE[1] * self.scale - self.height

    def camera(self, camera: Camera) -> Camera:
        """A camera with the calibration of the written picture."""
        full = camera.resized(*CALIBRATION_SIZE)
        if self.output != "model":
            return full
        intrinsic = np.diag([self.scale, self.scale, 1.0]) @ full.intrinsic
        intrinsic[1] -= self.cut_rows * intrinsic[2]
        return replace(full, intrinsic=intrinsic, width=self.width, height=self.height)

    def picture(self, drawn: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Drawn picture, (height, width, 3) RGB, at the size of the output."""
        if self.output == "model":
            return drawn
        width, height = CALIBRATION_SIZE
        large = cv2.resize(drawn, (width, round(self.height / self.scale)), interpolation=cv2.INTER_LINEAR)
        return np.asarray(np.pad(large, ((height - len(large), 0), (0, 0), (0, 0)), mode="edge"), np.uint8)
