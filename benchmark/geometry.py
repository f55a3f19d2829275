"""Planar boxes, rigid transforms and rotations: the one box convention of the project.

A box is ``(..., 5) = [x, y, length, width, yaw]``: centre in metres, length along the heading, yaw in radians
counter-clockwise from +x. Quaternions are ``[w, x, y, z]``.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.constants import EGO_BOX_FROM_LIDAR_M, EGO_LENGTH_M, EGO_WIDTH_M

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def wrap_angle(angle_rad: Floats) -> Floats:
    """Wrap angles in radians, of any shape, to [-pi, pi)."""
    return np.asarray((np.asarray(angle_rad, np.float64) + np.pi) % (2 * np.pi) - np.pi)


def box_corners(boxes: Floats) -> Floats:
    """(..., 4, 2) corners of (..., 5) boxes in metres, counter-clockwise from front left."""
    boxes = np.asarray(boxes, dtype=np.float64)
    cos, sin = np.cos(boxes[..., 4]), np.sin(boxes[..., 4])
    half_length, half_width = 0.5 * boxes[..., 2], 0.5 * boxes[..., 3]
    corners = np.empty((*boxes.shape[:-1], 4, 2))
    for axis, (ahead, left) in enumerate(
        ((half_length * cos, -half_width * sin), (half_length * sin, half_width * cos))
    ):
        center, diagonal, other = boxes[..., axis], ahead + left, ahead - left
        np.add(center, diagonal, out=corners[..., 0, axis])
        np.subtract(center, other, out=corners[..., 1, axis])
        np.subtract(center, diagonal, out=corners[..., 2, axis])
        np.add(center, other, out=corners[..., 3, axis])
    return corners


def ego_footprints(lidar_poses: Floats) -> Floats:
    """The ego's (..., 5) rectangle in collision checks: its centre is ahead of the lidar along the heading.

    Takes (..., 3) x, y of the lidar origin and heading, in any frame.
    """
    poses = np.asarray(lidar_poses, np.float64)
    yaw = poses[..., 2]
    center = poses[..., :2] + EGO_BOX_FROM_LIDAR_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    size = np.broadcast_to([EGO_LENGTH_M, EGO_WIDTH_M], center.shape)
    return np.concatenate([center, size, yaw[..., None]], axis=-1)


def boxes_overlap(first: Floats, second: Floats) -> Bools:
    """Whether two (..., 5) boxes, broadcast, intersect; touching counts.

    Separating-axis test in half-extent form: two rectangles are disjoint exactly when one of their four edge normals
    separates them.
    """
    first, second = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    turn = second[..., 4] - first[..., 4]
    return axes_overlap(
        second[..., 0] - first[..., 0],
        second[..., 1] - first[..., 1],
        _half_sizes_and_direction(first),
        _half_sizes_and_direction(second),
        np.cos(turn),
        np.sin(turn),
    )


HalfSizesAndDirection = Sequence[Floats] | Floats
"""Half the length, half the width, cosine and sine of the heading; each (...)."""


def _half_sizes_and_direction(boxes: Floats) -> HalfSizesAndDirection:
    return 0.5 * boxes[..., 2], 0.5 * boxes[..., 3], np.cos(boxes[..., 4]), np.sin(boxes[..., 4])


def axes_overlap(
    dx: Floats, dy: Floats, first: HalfSizesAndDirection, second: HalfSizesAndDirection, cos: Floats, sin: Floats
) -> Bools:
    """The test of `boxes_overlap` for callers that test each box many times and know its direction already.

    ``dx`` and ``dy`` go from the centre of the first box to that of the second; ``cos`` and ``sin`` are of the angle
    between their headings, of either sign and of any turn.
    """
    cos, sin = np.abs(cos), np.abs(sin)
    overlap: Bools | None = None
    for own, other in ((first, second), (second, first)):
        half_length, half_width, axis_cos, axis_sin = own
        along = np.abs(dx * axis_cos + dy * axis_sin) <= half_length + other[0] * cos + other[1] * sin
        across = np.abs(dy * axis_cos - dx * axis_sin) <= half_width + other[0] * sin + other[1] * cos
        along &= across
        overlap = along if overlap is None else overlap & along
    assert overlap is not None
    return overlap


def box_gap(first: Floats, second: Floats) -> Floats:
    """Distance in metres between two (..., 5) boxes, broadcast; zero where they overlap."""
    first, second = np.broadcast_arrays(np.asarray(first, np.float64), np.asarray(second, np.float64))
    gaps = np.minimum(_corner_gap(first, second), _corner_gap(second, first))
    return np.where(boxes_overlap(first, second), 0.0, gaps)


def _corner_gap(box: Floats, other: Floats) -> Floats:
    """Smallest distance from a corner of ``other`` to the rectangle ``box``, (...)."""
    offset = box_corners(other) - box[..., None, :2]
    cos, sin = np.cos(box[..., None, 4]), np.sin(box[..., None, 4])
    along = np.abs(offset[..., 0] * cos + offset[..., 1] * sin) - 0.5 * box[..., None, 2]
    across = np.abs(offset[..., 1] * cos - offset[..., 0] * sin) - 0.5 * box[..., None, 3]
    distance: Floats = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return np.asarray(distance.min(axis=-1))


def to_local(points: Floats, pose: Floats) -> Floats:
    """Planar (..., 2) points from the global frame into that of (..., 3) poses: x along the heading, y to its left."""
    offset = np.asarray(points, np.float64) - np.asarray(pose)[..., :2]
    cos, sin = np.cos(np.asarray(pose)[..., 2]), np.sin(np.asarray(pose)[..., 2])
    return np.stack([offset[..., 0] * cos + offset[..., 1] * sin, offset[..., 1] * cos - offset[..., 0] * sin], axis=-1)


def to_global(points: Floats, pose: Floats) -> Floats:
    """Planar (..., 2) points from the frame of (..., 3) poses into the global frame; the inverse of `to_local`."""
    points, pose = np.asarray(points, np.float64), np.asarray(pose, np.float64)
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    x = points[..., 0] * cos - points[..., 1] * sin
    y = points[..., 0] * sin + points[..., 1] * cos
    return np.asarray(np.stack([x, y], axis=-1) + pose[..., :2])


def poses_between(first: Floats, second: Floats, fraction: Floats) -> Floats:
    """(..., 3) poses between two, 0 at the first and 1 at the second: linear, along the shorter arc, not wrapped."""
    first, second = np.asarray(first, np.float64), np.asarray(second, np.float64)
    step = second - first
    step[..., 2] = wrap_angle(step[..., 2])
    return np.asarray(first + np.asarray(fraction)[..., None] * step)


def quaternion_of(rotation: Floats) -> Floats:
    """Quaternion w, x, y, z, of either sign, of a (3, 3) rotation matrix, by its largest component."""
    # Four times the outer product of the quaternion with itself; any row is the quaternion, the largest the safest.
    xx, yy, zz = rotation[0, 0], rotation[1, 1], rotation[2, 2]
    wx, wy, wz = rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]
    xy, xz, yz = rotation[0, 1] + rotation[1, 0], rotation[0, 2] + rotation[2, 0], rotation[1, 2] + rotation[2, 1]
    outer = np.array(
        [
            [1 + xx + yy + zz, wx, wy, wz],
            [wx, 1 + xx - yy - zz, xy, xz],
            [wy, xy, 1 - xx + yy - zz, yz],
            [wz, xz, yz, 1 - xx - yy + zz],
        ]
    )
    row = outer[int(np.argmax(np.diag(outer)))]
    return np.asarray(row / np.linalg.norm(row))


def quaternion_from_yaw(yaw_rad: Floats) -> Floats:
    """Rotations about the vertical by (...) radians: (..., 4) quaternions w, x, y, z."""
    half = 0.5 * np.asarray(yaw_rad, np.float64)
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def directions_of(vectors: Floats) -> Floats:
    """Directions of (..., 2) vectors in radians, [-pi, pi], to the last bit the same for any layout in memory.

    numpy has two ways to an arc tangent, whose last bits differ. Of a view it takes the one or the other by whether the
    result happens to follow it in memory; of what lies together it always takes the same one.
    """
    return np.asarray(np.arctan2(np.ascontiguousarray(vectors[..., 1]), np.ascontiguousarray(vectors[..., 0])))


def yaw_of_quaternion(quaternion: Floats) -> Floats:
    """Heading of the rotated x axis from above, radians in [-pi, pi]; (..., 4) w, x, y, z need not be normalised."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    return np.asarray(np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z))


def rotation_matrix(quaternion: Floats) -> Floats:
    """(..., 3, 3) matrices of quaternions (..., 4) w, x, y, z, normalised here: local to parent frame."""
    quaternion = np.asarray(quaternion, np.float64)
    w, x, y, z = np.moveaxis(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def transform_matrix(rotation: ArrayLike, translation: ArrayLike) -> Floats:
    """Rigid motion as a (4, 4) matrix that takes local points (x, y, z, 1) to the parent frame.

    The rotation is a (4,) quaternion, normalised here; the translation is in metres.
    """
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrix(np.asarray(rotation, np.float64))
    matrix[:3, 3] = translation
    return matrix
