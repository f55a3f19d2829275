"""What recorded motion says against a data set: boxes that jump or lie across it, rotations in another order.

All of it is of one scene, and of its keyframes; whoever asks decides how many make a fault.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, wrap_angle, yaw_of_quaternion

FASTEST_M_S: Final = 60.0
"""Nothing on a road is faster."""
MOVING_M_S: Final = 3.0
"""Slower objects, and people, may move to any side of theirs."""
ACROSS_RAD: Final = np.radians(60.0)
"""From here on a box lies across its motion; a car that slides or turns stays far below."""
WIDER: Final = 1.1
"""A moving object is longer than wide; what is nearly square says nothing."""
UPRIGHT: Final = 0.7
"""Least vertical part of a car's own vertical: 45 degrees of roll and pitch together."""
SENSIBLE_SHARE: Final = 0.9
"""Of the rotations of a data set that is read in the right order, at least; in a wrong one it is less than half."""
MISFIT_SHARE: Final = 0.2
"""Of the samples, at which the recorded ego is off the drivable area: more, and the map is of another place."""
LEAST_MOVING: Final = 3
"""Fewer moving objects say nothing of how boxes lie."""


@dataclass(frozen=True, slots=True)
class Steps:
    """S steps of objects from one annotation to the next, over all objects of a scene.

    Attributes:
        row: (S,) annotation at which it begins.
        owner: (S,) the object.
        speed: (S,) m/s.
        direction: (S,) of the motion, radians.
    """

    row: NDArray[np.int64]
    owner: NDArray[np.int64]
    speed: Floats
    direction: Floats

    @classmethod
    def of(cls, owner: NDArray[np.int64], seconds: Floats, position: Floats) -> "Steps":
        """Steps of R annotations; none where time does not go on.

        Args:
            owner: (R,) number of the object; those of an object stand together, in time order.
            seconds: (R,) times.
            position: (R, 2) metres.
        """
        elapsed, moved = np.diff(seconds), np.diff(position[:, :2], axis=0)
        row = np.flatnonzero((owner[1:] == owner[:-1]) & (elapsed > 0.0))
        away = moved[row]
        return cls(row, owner[row], np.hypot(*away.T) / elapsed[row], np.arctan2(away[:, 1], away[:, 0]))

    @property
    def jumps(self) -> Bools:
        """(S,) whether a step is faster than anything on a road."""
        return self.speed > FASTEST_M_S

    @property
    def drives(self) -> Bools:
        """(S,) whether a step tells where an object drives to."""
        return (self.speed > MOVING_M_S) & ~self.jumps

    def directions(self, count: int) -> Floats:
        """(R,) where the owner of each of R annotations drives to from there, radians; NaN where it does not."""
        found = np.full(count, np.nan)
        found[self.row[self.drives]] = self.direction[self.drives]
        return found


def objects_across(steps: Steps, yaw: Floats, size: Floats) -> tuple[int, int]:
    """Number of objects that move, and of those that lie across their motion at most of their moving steps.

    A box lies across its motion if its heading is at right angles to it or it is wider than long.

    Args:
        yaw: (R,) headings, radians.
        size: (R, 2) length and width, metres.
    """
    driving = steps.drives
    row, owner = steps.row[driving], steps.owner[driving]
    # Backwards is along, too.
    turned = np.abs(wrap_angle(2.0 * (steps.direction[driving] - yaw[row]))) / 2.0 > ACROSS_RAD
    across = turned | (size[row, 1] > WIDER * size[row, 0])
    objects, which, count = np.unique(owner, return_inverse=True, return_counts=True)
    most = np.bincount(which, weights=across, minlength=len(objects)) > 0.5 * count
    return len(objects), int(np.count_nonzero(most))


def lie_across(moving: int, across: int) -> bool:
    """Whether boxes have width and length exchanged, or headings of another convention, by `objects_across`."""
    return moving >= LEAST_MOVING and across > 0.5 * moving


def in_another_order(quaternions: Floats, direction: Floats | None = None) -> bool:
    """Whether rotations make sense only if they are read as x, y, z, w.

    Args:
        quaternions: (R, 4) as they are read: w, x, y, z.
        direction: (R,) motion of their objects, NaN where these do not move; not asked without it.

    Returns:
        Whether most are upside down, lie on a side or look away from the motion as they are read, and hardly any does
        in the other order.
    """
    if not len(quaternions):
        return False
    other = np.roll(quaternions, 1, axis=-1)
    return _sensible(quaternions, direction) < 0.5 and _sensible(other, direction) >= SENSIBLE_SHARE


def _sensible(quaternions: Floats, direction: Floats | None) -> float:
    """Share of rotations that stand upright, and look where the motion goes."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        upright = (w * w - x * x - y * y + z * z) / (w * w + x * x + y * y + z * z) > UPRIGHT
    if direction is not None:
        away = np.abs(wrap_angle(yaw_of_quaternion(quaternions) - np.nan_to_num(direction)))
        upright &= np.isnan(direction) | (away < np.pi / 4)
    return float(upright.mean())
