"""Rigid frames of sensors, and the three angles that official code reads from rotations."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from benchmark.geometry import Floats, rotation_matrix

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SensorFrame:
    """Pose of a sensor when it measures: (3, 3) and (3,) to the ego frame, and from there to the global one."""

    mount: tuple[Floats, Floats]
    pose: tuple[Floats, Floats]

    @classmethod
    def of(cls, calibrated_sensor: Row, ego_pose: Row) -> Self:
        """From rows of the two tables."""
        return cls(_read_motion(calibrated_sensor), _read_motion(ego_pose))

    @property
    def rotation(self) -> Floats:
        """(3, 3) from the sensor's axes to the global ones."""
        return np.asarray(self.pose[0] @ self.mount[0])

    @property
    def origin(self) -> Floats:
        """(3,) global position of the sensor."""
        return np.asarray(self.pose[0] @ self.mount[1] + self.pose[1])

    def local(self, points: Floats) -> Floats:
        """Global points (..., 3) in the sensor's frame; by way of the ego frame, as boxes are taken there."""
        (mount, offset), (pose, position) = self.mount, self.pose
        return np.asarray(((points - position) @ pose - offset) @ mount)

    def local_rotation(self, rotation: Floats) -> Floats:
        """Global rotations (..., 3, 3) in the sensor's frame."""
        return np.asarray(self.rotation.T @ rotation)

    def transform_to(self, other: "SensorFrame") -> tuple[Floats, Floats]:
        """(3, 3) and (3,) from this sensor's points to another's by the global frame: with the ego's motion."""
        (mount, offset), (pose, position) = self.mount, self.pose
        rotation = other.mount[0].T @ other.pose[0].T @ pose @ mount
        moved = other.pose[0].T @ (pose @ offset + position - other.pose[1])
        return np.asarray(rotation), np.asarray(other.mount[0].T @ (moved - other.mount[1]))


def _read_motion(row: Row) -> tuple[Floats, Floats]:
    return rotation_matrix(np.array(row["rotation"], np.float64)), np.array(row["translation"], np.float64)


def compute_heading(rotation: Floats) -> Floats:
    """Direction of the turned x axis in the plane, radians, of rotations (..., 3, 3)."""
    return np.asarray(np.arctan2(rotation[..., 1, 0], rotation[..., 0, 0]))


def compute_tilted_angle(rotation: Floats) -> Floats:
    """Angle of a box in the info files: the first of pyquaternion's yaw, pitch and roll.

    atan2(2 (wz - xy), 1 - 2 (yy + zz)), with a minus where the heading has a plus: the two are equal only without tilt.
    """
    return np.asarray(np.arctan2(-rotation[..., 0, 1], rotation[..., 0, 0]))


def compute_roll(rotation: Floats) -> Floats:
    """Roll that VAD's converter takes for the heading of the ego, since it reads w, x, y, z as x, y, z, w."""
    return np.asarray(np.arctan2(rotation[..., 2, 1], rotation[..., 2, 2]))


def rotate_points(points: Floats, angle_rad: Floats) -> Floats:
    """(..., 2) points of a plane turned counter-clockwise, by radians that go with the leading axes."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
