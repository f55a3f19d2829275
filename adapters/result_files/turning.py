"""Turning points in the plane."""

import numpy as np
from numpy.typing import ArrayLike

from benchmark.geometry import Floats

_NOTHING_RAD = 1e-12


def turned(points: Floats, angle_rad: ArrayLike) -> Floats:
    """Points, (..., 2), turned counter-clockwise about the origin.

    `angle_rad` is (...), less any axes; an angle that is none but for rounding leaves its points as they are.
    """
    angle = np.asarray(angle_rad, np.float64)
    angle = np.where(np.abs(angle) < _NOTHING_RAD, 0.0, angle)
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)
