"""Poses between poses as NeuroNCAP's code has them: quaternions, normalised linear where they nearly agree."""

from typing import Final

import numpy as np

from benchmark.geometry import Floats, quaternion_of, rotation_matrix

_NEARLY_EQUAL: Final = 0.999
"""Cosine of two quaternions above which the arc is not worth a sine."""


def heading_of(pose: Floats) -> float:
    """Direction of a (4, 4) pose's x axis seen from above, radians."""
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def pose_between(first: Floats, second: Floats, fraction: float) -> Floats:
    """(4, 4) pose between two, 0 at the first and 1 at the second: linear in position, the shorter arc in rotation."""
    pose = np.eye(4)
    pose[:3, 3] = first[:3, 3] + fraction * (second[:3, 3] - first[:3, 3])
    start, end = quaternion_of(first[:3, :3]), quaternion_of(second[:3, :3])
    cosine = float(start @ end)
    end, cosine = (-end, -cosine) if cosine < 0 else (end, cosine)
    if cosine > _NEARLY_EQUAL:
        turned = start + fraction * (end - start)
    else:
        angle = np.arccos(cosine)
        turned = np.sin((1 - fraction) * angle) * start + np.sin(fraction * angle) * end
    pose[:3, :3] = rotation_matrix(turned)
    return pose
