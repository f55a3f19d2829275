"""The order in which readers go through exported infos: scene by scene, whatever times variants share."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

_APART_US: Final = 2_000_000
"""Readers of SparseDrive's family keep their memory across no longer time than this."""
_SHIFTED_APART_US: Final = 10_000_000


def shifts_us(scenes: Sequence[tuple[str, int, int]]) -> dict[str, int]:
    """Shifts by name that keep scenes together and apart from each other in time, for those that need one.

    Those are scenes that begin before all earlier ones have ended for 2 s. Of scenes that begin together the first by
    name is the earlier one.

    Args:
        scenes: Name, first and last time of each, microseconds.
    """
    found: dict[str, int] = {}
    ended: int | None = None
    for name, first, last in sorted(scenes, key=lambda scene: (scene[1], scene[0])):
        shift = 0
        if ended is not None and first <= ended + _APART_US:
            shift = found[name] = ended + _SHIFTED_APART_US - first
        ended = last + shift
    return found


def exported_order(scenes: Sequence[str], times_us: NDArray[np.int64]) -> NDArray[np.int64]:
    """Places of samples in dumps by official code of exported infos, which do not name them.

    Args:
        scenes: Name of the scene of each of S samples.
        times_us: (S,) their times in the tables.

    Returns:
        (S,) numbers of the samples in the order of the readers, who sort by the moved times.
    """
    names = np.array(scenes)
    of_scene = {name: times_us[names == name] for name in dict.fromkeys(scenes)}
    shifts = shifts_us([(name, int(times.min()), int(times.max())) for name, times in of_scene.items()])
    return np.argsort(times_us + np.array([shifts.get(name, 0) for name in scenes], np.int64), kind="stable")
