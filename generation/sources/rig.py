"""A six-camera rig with nuScenes' layout, for scenes whose source has no cameras."""

import numpy as np

from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.scene import Camera, LidarMount

_IMAGE_SIZE = (1600, 900)
# name: (x, y, z of the lens in the ego frame, heading in degrees, focal length in pixels at 1600 x 900)
_LENSES = {
    "CAM_FRONT": (1.70, 0.00, 1.51, 0.0, 1266.0),
    "CAM_FRONT_RIGHT": (1.55, -0.50, 1.50, -56.0, 1266.0),
    "CAM_FRONT_LEFT": (1.52, 0.50, 1.51, 55.0, 1266.0),
    "CAM_BACK": (0.03, 0.00, 1.57, 180.0, 809.0),
    "CAM_BACK_LEFT": (1.04, 0.48, 1.57, 108.0, 1260.0),
    "CAM_BACK_RIGHT": (1.02, -0.48, 1.56, -110.0, 1260.0),
}


def build_default_cameras() -> tuple[Camera, ...]:
    """Six cameras at 1600 x 900 with the fields of view and headings of nuScenes' rig (65 degrees; 90 at the back)."""
    return tuple(_build_camera(name) for name in CAMERA_NAMES)


def build_default_lidar() -> LidarMount:
    """LIDAR_TOP above the front seats, +y forward as in nuScenes."""
    return LidarMount(np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, 1.84]), quaternion_from_yaw(np.array(-np.pi / 2)))


def _build_camera(name: str) -> Camera:
    x, y, z, heading_deg, focal_px = _LENSES[name]
    width, height = _IMAGE_SIZE
    intrinsic = np.array([[focal_px, 0.0, width / 2], [0.0, focal_px, 0.54 * height], [0.0, 0.0, 1.0]])
    return Camera(
        name, np.array([x, y, z]), _compute_camera_rotation(np.deg2rad(heading_deg)), intrinsic, width, height
    )


def _compute_camera_rotation(heading_rad: float) -> Floats:
    """Quaternion of camera axes (x right, y down, z forward) looking horizontally along a heading."""
    # Half-angle form of the product of the heading about z with the fixed turn of optical axes into body axes.
    w, z = np.cos(heading_rad / 2), np.sin(heading_rad / 2)
    body = np.array([0.5, -0.5, 0.5, -0.5])
    return np.array(
        [
            w * body[0] - z * body[3],
            w * body[1] - z * body[2],
            w * body[2] + z * body[1],
            w * body[3] + z * body[0],
        ]
    )
