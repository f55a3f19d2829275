"""The ways in which protocols make one value of the steps up to a horizon; they never share a column."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.protocols.contract import Outcomes


def at_steps(values: NDArray[Any]) -> Floats:
    """(S, 6) values at the steps: those at 1, 2 and 3 s themselves, (S, 3)."""
    return np.asarray(values[:, [count - 1 for count in HORIZON_STEPS.values()]], np.float64)


def means_up_to(values: NDArray[Any]) -> Floats:
    """Mean over the steps up to each horizon; arguments as in `at_steps`."""
    means = [values[:, :count].mean(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(means, axis=1), np.float64)


def any_up_to(verdicts: Bools) -> Floats:
    """1 if any step up to the horizon is positive, else 0; arguments as in `at_steps`."""
    any_so_far = [verdicts[:, :count].any(axis=1) for count in HORIZON_STEPS.values()]
    return np.asarray(np.stack(any_so_far, axis=1), np.float64)


def masked_columns(outcomes: Outcomes, average: Callable[[NDArray[Any]], Floats]) -> dict[str, Floats]:
    """The columns of a protocol with a mask and a test of the point below, all averaged in the same way.

    ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``, each (S, 3), of verdicts with the steps
    ``before_mask`` and ``obj_col``. ``average`` makes (S, 3) at 1, 2 and 3 s of (S, 6) values at the steps.
    """
    return {
        "collision": average(outcomes.collision),
        "collision_before_mask": average(outcomes.step("before_mask")),
        "obj_col": average(outcomes.step("obj_col")),
        "l2": average(outcomes.l2),
    }
