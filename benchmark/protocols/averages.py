"""The ways in which protocols make one value of the steps up to a horizon; they never share a column."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Bools, Floats


def at_steps(values: NDArray[Any]) -> Floats:
    """The value at each horizon itself.

    Args:
        values: (S, 6) at the steps.

    Returns:
        (S, 3) at 1, 2 and 3 s.
    """
    return np.asarray(values[:, [count - 1 for count in HORIZON_STEPS.values()]], np.float64)


def means_up_to(values: NDArray[Any]) -> Floats:
    """Mean over the steps up to each horizon; arguments as in `at_steps`."""
    means = [values[:, :count].mean(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(means, axis=1), np.float64)


def any_up_to(verdicts: Bools) -> Floats:
    """1 if any step up to the horizon is positive, else 0; arguments as in `at_steps`."""
    any_so_far = [verdicts[:, :count].any(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(any_so_far, axis=1), np.float64)
