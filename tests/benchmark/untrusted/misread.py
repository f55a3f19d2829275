"""Wrong readings of plans that are right: what each makes of positions of the lidar, x right, y forward."""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats

_STEPS_S: Final = 0.5 * np.arange(PLAN_STEPS + 1)
AHEAD_M: Final = 0.943713


def to_ego(plan: Floats) -> Floats:
    """x forward, y left of the same points."""
    return np.stack([plan[..., 1], -plan[..., 0]], axis=-1)


def to_lidar(plan: Floats) -> Floats:
    """The way back."""
    return np.stack([-plan[..., 1], plan[..., 0]], axis=-1)


def in_global(plan: Floats) -> Floats:
    """Global coordinates, each sample at another place with another heading."""
    count = len(plan)
    heading = np.linspace(0.0, 6.0, count)[:, None]
    x, y = plan[..., 0], plan[..., 1]
    turned = np.stack([np.cos(heading) * x - np.sin(heading) * y, np.sin(heading) * x + np.cos(heading) * y], axis=-1)
    return np.asarray(turned + np.array([410.0, 1180.0]) + np.arange(count)[:, None, None])


def at_10_hz(plan: Floats) -> Floats:
    """The path's points 0.1 s apart."""
    path = np.concatenate([np.zeros_like(plan[:, :1]), plan], axis=1)
    times = 0.1 * np.arange(1, PLAN_STEPS + 1)
    return np.array([[np.interp(times, _STEPS_S, points[:, axis]) for axis in range(2)] for points in path]).transpose(
        0, 2, 1
    )


MISREAD: Final[dict[str, tuple[Callable[[Floats], Floats], str]]] = {
    "mirrored": (lambda plan: plan * [-1.0, 1.0], "left and right look exchanged"),
    "in centimetres": (lambda plan: 100.0 * plan, "centimetres would fit"),
    "in global coordinates": (in_global, "global coordinates would fit"),
    "ego labelled lidar": (to_ego, "axes x forward, y left would fit"),
    "lidar labelled ego": (to_lidar, "axes x right, y forward would fit"),
    "not summed up": (lambda plan: np.diff(plan, axis=1, prepend=0.0), "offsets that were not summed would fit"),
    "one step late": (lambda plan: np.concatenate([0.0 * plan[:, :1], plan[:, :-1]], axis=1), "one step late"),
    "points at 10 Hz": (at_10_hz, "points at 10 Hz would fit"),
}
"""What is done to plans, and what the tests must say."""
FRAMES: Final = {"ego labelled lidar": "ego", "lidar labelled ego": "lidar"}
