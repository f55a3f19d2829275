"""One camera at one moment: projection, the ground seen by each pixel, and clipping at the near plane."""

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats, rotation_matrix
from benchmark.scene import Camera

NEAR_M = 0.2


@dataclass(frozen=True, slots=True)
class PlacedCamera:
    """A camera placed in the world; ``eye`` (3,) is its optical centre, global, ``ground_z`` the flat ground's height.

    ``rotation`` (3, 3) turns global vectors into camera axes (x right, y down, z forward).
    """

    camera: Camera
    eye: Floats
    rotation: Floats
    ground_z: float

    @classmethod
    def of(cls, camera: Camera, ego_position: Floats, ego_rotation: Floats) -> "PlacedCamera":
        """Place a camera that is mounted on the ego, at (3,) metres and (4,) quaternion, both global."""
        body, mount = (
            _compute_rotation_matrix(ego_rotation.tobytes()),
            _compute_rotation_matrix(camera.rotation.tobytes()),
        )
        eye = body @ camera.translation + ego_position
        return cls(camera, eye, (body @ mount).T, float(ego_position[2]))

    def to_camera(self, points: Floats) -> Floats:
        """Global points in camera axes, (..., 3) metres each; the last component is the depth."""
        # One product of all points: a stack of small ones takes four times as long and gives the same.
        offset = (points - self.eye).reshape(-1, 3)
        return np.asarray(offset @ self.rotation.T).reshape(np.shape(points))

    def to_pixels(self, in_camera: Floats) -> Floats:
        """Pinhole projection of (..., 3) camera axes, depth positive, to (..., 2) columns and rows.

        Integer values are pixel centres.
        """
        homogeneous = in_camera @ self.camera.intrinsic.T
        return np.asarray(homogeneous[..., :2] / homogeneous[..., 2:3])

    def compute_ground_homography(self) -> Floats:
        """(3, 3) homography from ground coordinates (x, y, 1), metres, global, to homogeneous pixels."""
        columns = np.column_stack(
            [self.rotation[:, 0], self.rotation[:, 1], self.rotation @ (np.array([0.0, 0.0, self.ground_z]) - self.eye)]
        )
        return np.asarray(self.camera.intrinsic @ columns)

    def compute_pixel_rays(self, step: int = 1) -> NDArray[np.float32]:
        """Single-precision directions, (3, h, w) global x, y, z, in which every ``step``-th column and row looks."""
        turn = (self.rotation.T @ np.linalg.inv(self.camera.intrinsic)).astype(np.float32)
        columns = np.arange(0, self.camera.width, step, dtype=np.float32)
        rows = np.arange(0, self.camera.height, step, dtype=np.float32)[:, None]
        return np.stack([axis[0] * columns + (axis[1] * rows + axis[2]) for axis in turn])


@functools.lru_cache(maxsize=64)
def _compute_rotation_matrix(quaternion: bytes) -> Floats:
    """Rotation matrix of a quaternion's bytes: six cameras share the ego's, and all frames each camera's own."""
    matrix = rotation_matrix(np.frombuffer(quaternion, np.float64))
    matrix.flags.writeable = False
    return matrix


def clip_near(polygon: Floats, near_m: float = NEAR_M) -> Floats:
    """Part, possibly empty, of a convex polygon, (M, 3) camera axes, beyond depth ``near_m`` (Sutherland-Hodgman)."""
    clipped: list[Floats] = []
    for index in range(len(polygon)):
        corner, next_corner = polygon[index], polygon[(index + 1) % len(polygon)]
        if corner[2] >= near_m:
            clipped.append(corner)
        if (corner[2] >= near_m) != (next_corner[2] >= near_m):
            share = (near_m - corner[2]) / (next_corner[2] - corner[2])
            clipped.append(corner + share * (next_corner - corner))
    return np.array(clipped).reshape(-1, 3)
