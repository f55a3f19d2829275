"""Poses as (..., 7) numbers: x, y, z in metres and a quaternion w, x, y, z, of either sign and normalised here.

The pose of A in B takes points of A into B; `compose` of the pose of B in C and that of A in B is that of A in C.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats, rotation_matrix
from benchmark.scene import EgoTrack

IDENTITY: Final = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def compose(outer: Floats, inner: Floats) -> Floats:
    """(..., 7) poses, the outer one after the inner one."""
    outer, inner = np.broadcast_arrays(normalise(outer), normalise(inner))
    position = outer[..., :3] + np.einsum("...ij,...j->...i", rotation_matrix(outer[..., 3:]), inner[..., :3])
    w, vector = outer[..., 3:4], outer[..., 4:]
    other_w, other = inner[..., 3:4], inner[..., 4:]
    real = w * other_w - (vector * other).sum(axis=-1, keepdims=True)
    return np.concatenate([position, real, w * other + other_w * vector + np.cross(vector, other)], axis=-1)


def invert(pose: Floats) -> Floats:
    """(..., 7) the pose of B in A from that of A in B."""
    pose = normalise(pose)
    rotation = pose[..., 3:] * [1.0, -1.0, -1.0, -1.0]
    position = -np.einsum("...ij,...j->...i", rotation_matrix(rotation), pose[..., :3])
    return np.concatenate([position, rotation], axis=-1)


def normalise(pose: Floats) -> Floats:
    """(..., 7) with quaternions of length one."""
    pose = np.asarray(pose, np.float64)
    return np.concatenate([pose[..., :3], pose[..., 3:] / np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)], -1)


def interpolate(poses: Floats, times_us: NDArray[np.int64], wanted_us: NDArray[np.int64]) -> Floats:
    """(N, 7) poses at (N,) times from (T, 7) at (T,) times that never decrease; before and after, the first and last.

    Positions are linear in time, rotations turn evenly the shorter way. Of equal times the last row counts.
    """
    poses = normalise(poses)
    after = np.clip(np.searchsorted(times_us, wanted_us, side="right"), 1, max(1, len(times_us) - 1))
    before, after = after - 1, np.minimum(after, len(times_us) - 1)
    span = np.maximum(times_us[after] - times_us[before], 1)
    fraction = np.clip((wanted_us - times_us[before]) / span, 0.0, 1.0)[:, None]
    first, second = poses[before], poses[after]
    near = np.sum(first[:, 3:] * second[:, 3:], axis=-1, keepdims=True)
    second_turn = np.where(near < 0, -second[:, 3:], second[:, 3:])
    angle = np.arccos(np.clip(np.abs(near), 0.0, 1.0))
    # Below a microradian the arc is its chord.
    flat = angle < 1e-6
    sine = np.where(flat, 1.0, np.sin(angle))
    shares = [np.where(flat, share, np.sin(share * angle) / sine) for share in (1.0 - fraction, fraction)]
    rotation = shares[0] * first[:, 3:] + shares[1] * second_turn
    position = first[:, :3] + fraction * (second[:, :3] - first[:, :3])
    exact = (fraction == 0.0) | (fraction == 1.0)
    exactly = np.where(fraction == 1.0, second, first)
    return np.where(exact, exactly, normalise(np.concatenate([position, rotation], axis=-1)))


def shift(pose: Floats, by_m: Floats) -> Floats:
    """(..., 7) poses in a world whose origin is moved, by (3,) metres."""
    return np.concatenate([pose[..., :3] + by_m, pose[..., 3:]], axis=-1)


def to_track(pose: Floats) -> EgoTrack:
    """(T, 7) poses of the ego as a track."""
    return EgoTrack(np.ascontiguousarray(pose[:, :3]), np.ascontiguousarray(pose[:, 3:]))
