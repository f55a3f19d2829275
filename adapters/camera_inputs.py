"""From an `Observation` to what camera networks read: images, camera matrices and the ego motion vector.

All networks were trained on nuScenes images of 1600 x 900. Images of another size are resized to what the network
expects, and the camera matrices with them, so that the geometry stays exact.
"""

from dataclasses import dataclass
from typing import Final, Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import CAMERA_NAMES
from benchmark.errors import InputError
from benchmark.geometry import Floats, transform_matrix, yaw_of_quaternion
from benchmark.planning import CameraView, EgoState, NoViewsError, Observation, SceneInfo
from benchmark.scene import Camera

NUSCENES_IMAGE: Final = (1600, 900)
"""Width and height of the images that the published networks were trained on."""

Pixels = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PixelNormalisation:
    """Normalisation from pixel values of 0 to 255 to network inputs: ``(value - mean) / std`` for each channel.

    `mean` and `std` are in the order of the network's channels: red, green, blue if `rgb`, else blue, green, red.
    """

    name: str
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    rgb: bool


BGR_MEAN: Final = PixelNormalisation("bgr-mean", (103.530, 116.280, 123.675), (1.0, 1.0, 1.0), False)
"""Blue first and the mean subtracted: the published VAD and UniAD weights."""
RGB_MEAN_STD: Final = PixelNormalisation("rgb-mean-std", (123.675, 116.28, 103.53), (58.395, 57.12, 57.375), True)
"""Red first, mean and deviation: VAD's present configuration files, SparseDrive and DiffusionDrive."""
NORMALISATIONS: Final = {variant.name: variant for variant in (BGR_MEAN, RGB_MEAN_STD)}


def find_normalisation(name: str) -> PixelNormalisation:
    """Normalisation of a name, for example ``bgr-mean``."""
    if name not in NORMALISATIONS:
        raise InputError(f"unknown normalisation {name!r}; use one of {', '.join(NORMALISATIONS)}")
    return NORMALISATIONS[name]


@dataclass(frozen=True, slots=True)
class NetworkImageFormat:
    """Image size that a network expects.

    `height` is before `crop_top` rows are cut off; zeros are added at the right and at the bottom up to multiples of
    `divisor`. ``linear`` resizes floating-point pixels bilinearly (mmcv), ``bicubic`` bytes with antialiasing (Pillow).
    """

    width: int
    height: int
    crop_top: int = 0
    divisor: int = 32
    resize: Literal["linear", "bicubic"] = "linear"

    @classmethod
    def scaled(cls, scale: float) -> Self:
        """Images of 1600 x 900 reduced by a factor to whole pixels: VAD 0.4 and 0.8, UniAD 1.0."""
        width, height = NUSCENES_IMAGE
        return cls(int(width * scale), int(height * scale))

    @property
    def padded(self) -> tuple[int, int]:
        """Height and width of the network's input."""
        rows = self.height - self.crop_top
        return -(-rows // self.divisor) * self.divisor, -(-self.width // self.divisor) * self.divisor


SPARSE_DRIVE_IMAGE: Final = NetworkImageFormat(704, 396, crop_top=140, resize="bicubic")
"""Images of SparseDrive and DiffusionDrive: 704 x 256."""
MINIATURE_IMAGE: Final = NetworkImageFormat(224, 128)
"""Images of the miniatures of all four models."""


def camera_images(
    observation: Observation, image_format: NetworkImageFormat, normalisation: PixelNormalisation
) -> Pixels:
    """Network images of the six cameras, (6, 3, H, W) in the order of `CAMERA_NAMES`, padded with 0.

    One that is missing, broken, or not of the size that the data set's tables say is an `InputError`.
    """
    images = np.zeros((len(CAMERA_NAMES), 3, *image_format.padded), np.float32)
    rows = image_format.height - image_format.crop_top
    for image, view in zip(images, _six_views(observation), strict=True):
        unpadded = image[:, :rows, : image_format.width]
        _write_network_image(unpadded, _load_image(view), image_format, normalisation)
    return images


def lidar_to_image(observation: Observation, image_format: NetworkImageFormat) -> Floats:
    """Projections from the lidar frame of the sample into the network's images.

    A camera is exposed up to 50 ms before or after the lidar's time stamp; the ego's motion in between is part of
    the matrix: ``image affine @ K @ camera_T_ego @ ego_T_global(exposure) @ global_T_ego(sample) @ ego_T_lidar``.

    Returns:
        (6, 4, 4): (x, y, z, 1) in metres to (u d, v d, d, 1), u and v in pixels of the network's image, d the depth.
    """
    global_T_lidar = lidar_pose(observation)
    matrices = []
    for view in _six_views(observation):
        global_T_camera = view.global_T_ego @ transform_matrix(view.camera.rotation, view.camera.translation)
        intrinsic = np.eye(4)
        intrinsic[:3, :3] = view.camera.intrinsic
        camera_T_lidar = np.linalg.inv(global_T_camera) @ global_T_lidar
        matrices.append(image_affine(view.camera, image_format) @ intrinsic @ camera_T_lidar)
    return np.stack(matrices)


def image_affine(camera: Camera, image_format: NetworkImageFormat) -> Floats:
    """Matrix, (4, 4) on (u d, v d, d, 1), from pixels of the recorded image to pixels of the network's image."""
    affine = np.diag([image_format.width / camera.width, image_format.height / camera.height, 1.0, 1.0])
    affine[1, 2] = -image_format.crop_top
    return affine


def lidar_pose(observation: Observation) -> Floats:
    """Pose of LIDAR_TOP at the sample: (4, 4) lidar frame (x right, y forward) to global frame."""
    global_T_ego = transform_matrix(observation.ego.rotation, observation.ego.position)
    return global_T_ego @ transform_matrix(observation.lidar.rotation, observation.lidar.translation)


def can_bus_vector(ego: EgoState, *, repeat_w: bool = True, after: bool = False) -> Floats:
    """The 18 numbers that VAD and UniAD call ``can_bus``, as their data-set code gives them.

    Position; quaternion; acceleration, rotation rate and velocity of the last CAN message, zeros where there is none;
    heading in radians and in degrees, from 0 to a full turn. `repeat_w` puts the scalar part of the rotation into all
    four places of the quaternion: a mistake of the published code, and all that the published weights have seen.
    `after` takes the message after the sample instead of the one before it, a slip of the published code.
    """
    vector = np.zeros(18)
    vector[0:3] = ego.position
    vector[3:7] = ego.rotation[0] if repeat_w else ego.rotation
    motion = ego.can_motion_after if after else ego.can_motion
    if motion is not None:
        velocity, acceleration, rotation_rate = motion.reshape(3, 3)
        vector[7:16] = np.concatenate([acceleration, rotation_rate, velocity])
    heading_deg = float(np.degrees(yaw_of_quaternion(ego.rotation)))
    vector[17] = heading_deg + 360 if heading_deg < 0 else heading_deg
    vector[16] = np.radians(vector[17])
    return vector


def require_views(planner: str, scene: SceneInfo) -> None:
    """Refuse a rig that has cameras, but none for some views, which no sample could then be planned of."""
    there = [camera.name for camera in scene.cameras]
    missing = [name for name in CAMERA_NAMES if name not in there]
    if there and missing:
        raise NoViewsError(
            f"{planner} needs {', '.join(CAMERA_NAMES)}, and the rig of scene {scene.name} has no camera for "
            f"{', '.join(missing)} (it has {', '.join(there)}); say with --cameras which camera is which view, or "
            "choose a planner that needs fewer"
        )


def _six_views(observation: Observation) -> list[CameraView]:
    missing = [name for name in CAMERA_NAMES if name not in observation.views]
    if missing:
        raise InputError(
            f"sample {observation.sample_token} of scene {observation.scene} has no image of {missing[0]}; this model "
            f"needs all of {', '.join(CAMERA_NAMES)}; choose a data set that has them or a model without cameras"
        )
    return [observation.views[name] for name in CAMERA_NAMES]


def _load_image(view: CameraView) -> NDArray[np.uint8]:
    image = view.load()
    height, width = image.shape[:2]
    if (width, height) != (view.camera.width, view.camera.height):
        raise InputError(
            f"image {view.path} is {width} x {height} pixels, but in sample_data {view.camera.width} x "
            f"{view.camera.height}, so its calibration cannot be trusted; correct the table or the image"
        )
    return image


def _write_network_image(
    image: Pixels, rgb: NDArray[np.uint8], image_format: NetworkImageFormat, normalisation: PixelNormalisation
) -> None:
    """Fill ``image`` (3, rows, width), cropped and not padded.

    Resizing is linear in the pixels, so normalising afterwards gives the same and touches fewer of them.
    """
    size = (image_format.width, image_format.height)
    if image_format.resize == "bicubic":
        resized = _resize_bytes(rgb, size).astype(np.float32)
    else:
        resized = np.asarray(cv2.resize(rgb.astype(np.float32), size, interpolation=cv2.INTER_LINEAR), np.float32)
    cropped = resized[image_format.crop_top :]
    # One plane at a time: ten times faster than arithmetic on the transposed image.
    for channel, (mean, std) in enumerate(zip(normalisation.mean, normalisation.std, strict=True)):
        plane = cropped[:, :, channel if normalisation.rgb else 2 - channel]
        np.subtract(plane, np.float32(mean), out=image[channel])
        image[channel] /= np.float32(std)


def _resize_bytes(rgb: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    from PIL import Image

    return np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BICUBIC))
