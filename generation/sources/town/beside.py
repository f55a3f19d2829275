"""Driving beside a path: offsets that come and go without a jump, and the poses that they make of a path."""

import numpy as np

from benchmark.geometry import Floats
from generation.sources.town.curves import between_grid
from generation.sources.town.paths import STATION_M, Path


def quintic(
    where: Floats, first: float, last: float, start: tuple[float, float], goal: tuple[float, float]
) -> tuple[Floats, Floats]:
    """(N,) values and (N,) slopes of the quintic between two values and slopes, its second derivatives zero.

    Outside ``first`` to ``last``, which is greater, it is held with the value and without slope: excursions begin
    and end with neither. ``start`` and ``goal`` are value and slope at both ends.
    """
    length = last - first
    u = np.clip((where - first) / length, 0.0, 1.0)
    inside = (where > first) & (where < last)
    (p0, v0), (p1, v1) = start, goal
    v0, v1 = v0 * length, v1 * length
    a = 10 * (p1 - p0) - 6 * v0 - 4 * v1
    b = -15 * (p1 - p0) + 8 * v0 + 7 * v1
    c = 6 * (p1 - p0) - 3 * v0 - 3 * v1
    value = p0 + u * (v0 + u**2 * (a + u * (b + u * c)))
    slope = (v0 + u**2 * (3 * a + u * (4 * b + u * 5 * c))) / length
    return value, np.where(inside, slope, 0.0)


def curvature_at(path: Path, stations: Floats) -> Floats:
    """(N,) curvature of a path, 1/m, at stations (steps of `STATION_M`)."""
    step = 0.5
    yaw = path.rear[:, 2:]
    turn = between_grid(yaw, stations + step) - between_grid(yaw, stations - step)
    return np.asarray(turn[:, 0] / (2 * step * STATION_M))


def beside_path(path: Path, metres: Floats, aside: Floats, slope: Floats) -> Floats:
    """Rear-axle poses, (N, 3), of a drive beside a path without slip: the heading is that of its own motion.

    Args:
        metres: (N,) where along it.
        aside: (N,) metres to the left of it.
        slope: (N,) change of ``aside`` over a metre.
    """
    stations = metres / STATION_M
    pose = between_grid(path.rear, stations)
    heading = pose[:, 2] + np.arctan2(slope, 1 - curvature_at(path, stations) * aside)
    return np.column_stack([pose[:, 0] - aside * np.sin(pose[:, 2]), pose[:, 1] + aside * np.cos(pose[:, 2]), heading])
