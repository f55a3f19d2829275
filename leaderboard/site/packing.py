"""Numbers of a scene as short JSON: whole units, each as the step from the one before."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

CENTIMETRE: Final = 0.01
DECIMETRE: Final = 0.1
MILLIRADIAN: Final = 0.001

Packed = list[int | None]
"""First value, then steps, in whole units; null where there is no value; zeros at the end are left out."""


def packed(values: Sequence[float | None], unit: float) -> Packed:
    """A series as steps, as many as values, less the zeros at the end.

    Rounding to the unit comes first, so that errors do not add up.
    """
    steps: Packed = []
    before = 0
    for value in values:
        if value is None:
            steps.append(None)
            continue
        now = round(value / unit)
        steps.append(now - before)
        before = now
    while steps and steps[-1] == 0:
        steps.pop()
    return steps


def packed_path(points: ArrayLike, unit: float, start: tuple[float, float] = (0.0, 0.0)) -> list[int]:
    """(N, 2) metres as 2 N steps from ``start``, x and y in turn; zeros at the end stay: they tell its length."""
    whole = np.rint(np.vstack([np.array([start]), np.asarray(points, np.float64).reshape(-1, 2)]) / unit)
    return [int(step) for step in np.diff(whole, axis=0).ravel()]
