"""Actors of NeuroNCAP's engine, and their poses in between: quaternions, normalised linear where they nearly agree."""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats, quaternion_of, rotation_matrix

_NEARLY_EQUAL: Final = 0.999
"""Cosine of two quaternions above which the arc is not worth a sine."""


def compute_heading(pose: Floats) -> float:
    """Direction of a (4, 4) pose's x axis seen from above, radians."""
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def interpolate_pose(first: Floats, second: Floats, fraction: float) -> Floats:
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


Integers = NDArray[np.int64]
KEPT_CLASSES: Final = (
    "car",
    "truck",
    "trailer",
    "bus",
    "construction_vehicle",
    "bicycle",
    "motorcycle",
    "pedestrian",
    "barrier",
)
"""Classes of the engine's actors."""
HIT_CLASSES: Final = KEPT_CLASSES[:7]
"""Those that can be hit."""
FURTHER_VEHICLES: Final = ("construction", "emergency")
"""Second words of vehicle categories that are on neither list by a slip."""
_NO_TIME_S: Final = np.float32(1e-6)
"""Keeps the published code from dividing by nothing; so the fraction at a stamp is 0.999998."""


@dataclass(frozen=True)
class Actor:
    """Road user other than the ego; `is_target` of the scenario.

    `kind` is the second word of its category, `size` (3,) width, length, height, metres; `times` (T,) are rising
    microseconds, `poses` (T, 4, 4) box centre to global.
    """

    uuid: str
    kind: str
    size: Floats
    times: Integers
    poses: Floats
    is_target: bool = False

    @cached_property
    def seconds(self) -> NDArray[np.float32]:
        """(T,) since its own first stamp, in single precision as in the published code."""
        return np.asarray((self.times - self.times[0]) / 1e6, np.float32)

    def is_there(self, time_us: int) -> bool:
        """Whether a time lies within its track."""
        return bool(self.times[0] <= time_us <= self.times[-1])

    def neighbours(self, time_us: int) -> tuple[int, int, float]:
        """Stamps around a time and how far between them it lies, 0 to 1."""
        time = (time_us - int(self.times[0])) / 1e6
        right = int(np.searchsorted(self.seconds, time))
        left, right = max(right - 1, 0), min(right, len(self.seconds) - 1)
        span = np.float32(self.seconds[right] - self.seconds[left]) + _NO_TIME_S
        return left, right, float(np.clip((time - float(self.seconds[left])) / float(span), 0.0, 1.0))

    def position_at(self, time_us: int) -> Floats:
        """(3,) where its centre is at a time."""
        left, right, fraction = self.neighbours(time_us)
        first, second = self.poses[left, :3, 3], self.poses[right, :3, 3]
        return np.asarray(first + fraction * (second - first))

    def pose_at(self, time_us: int) -> Floats:
        """(4, 4) its pose at a time."""
        left, right, fraction = self.neighbours(time_us)
        return interpolate_pose(self.poses[left], self.poses[right], fraction)

    def velocity_at(self, time_us: int) -> Floats:
        """(3,) m/s of the step between stamps around a time; 0 with one stamp, where published code fails."""
        if len(self.times) < 2:
            return np.zeros(3)
        after = max(int(np.searchsorted(self.times, time_us)), 1)
        moved = self.poses[after, :3, 3] - self.poses[after - 1, :3, 3]
        # Seconds since 1970 in double precision, whose rounding (2.4e-7 s) is the published code's.
        return np.asarray(moved / (int(self.times[after]) / 1e6 - int(self.times[after - 1]) / 1e6))
