"""Tests of unit, frame and origin: far worse planners than any pass, and only what fits better otherwise is refused."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from adapters.result_files.importing import require_plausible
from benchmark.geometry import Floats
from benchmark.untrusted.files import RefusedFileError
from benchmark.untrusted.plan_plausibility import FEWEST, TESTS
from tests.adapters.result_files.broken_files import SAMPLES

TIMES = 0.5 * np.arange(1, 7)
ROWS = np.arange(len(SAMPLES.tokens))
PATH = Path("results.pkl")


def straight(speed: float) -> Floats:
    return np.stack([np.zeros(6), speed * TIMES], axis=1)


def braking(speed: float, deceleration: float) -> Floats:
    lasts = np.minimum(TIMES, speed / deceleration)
    return np.stack([np.zeros(6), speed * lasts - 0.5 * deceleration * lasts**2], axis=1)


def swerving(row: int) -> Floats:
    return np.stack([np.where(row % 2, 1.0, -1.0) * 0.8 * TIMES**2, 6.0 * TIMES], axis=1)


PLANNERS: dict[str, Callable[[int], Floats]] = {
    "stands": lambda row: np.zeros((6, 2)),
    "creeps": lambda row: straight(0.1),
    "only straight": lambda row: straight(8.0),
    "half as fast": lambda row: straight(4.0),
    "three times as fast": lambda row: straight(24.0),
    "brakes": lambda row: braking(8.0, 4.0),
    "brakes hard": lambda row: braking(8.0, 8.0),
    "brakes from a walk": lambda row: braking(4.0, 3.0),
    "swerves": swerving,
    "always turns left": lambda row: np.stack([-0.5 * TIMES**2, 6.0 * TIMES], axis=1),
    "feet": lambda row: 3.28 * SAMPLES.future[row],
}


@pytest.mark.parametrize("planner", PLANNERS)
def test_bad_planners_pass(planner: str) -> None:
    plans = np.array([PLANNERS[planner](row) for row in ROWS.tolist()])
    said = require_plausible(PATH, plans, ROWS, SAMPLES).measured
    assert set(said) == set(TESTS)
    assert planner != "stands" or said["offsets"] == f"not testable (0 of {FEWEST} samples)"
    few = ROWS[: FEWEST - 1]
    said = require_plausible(PATH, 100.0 * SAMPLES.future[few], few, SAMPLES).measured
    assert all(text.startswith("not testable") for text in said.values())


@pytest.mark.parametrize("far_m", [2e4, 1e300])
def test_what_is_beyond_all_plans_is_refused_however_few_there_are(far_m: float) -> None:
    with pytest.raises(RefusedFileError, match=r"reaches \S+e\+\d+ m") as refused:
        require_plausible(PATH, np.full((2, 6, 2), far_m), ROWS[:2], SAMPLES)
    assert refused.value.category == "unit"


def test_the_reason_says_what_would_fit() -> None:
    for plans, says in (
        (100.0 * SAMPLES.future, "centimetres would fit"),
        (SAMPLES.future[..., ::-1] * [1.0, -1.0], r"x and y look exchanged: as read 1\.4\d, turned 0\.00"),
        (SAMPLES.future * [-1.0, 1.0], "mirrored 0.00 m"),
        (SAMPLES.future + [0.0, 0.943713], "begin 0.94 m away"),
    ):
        with pytest.raises(RefusedFileError, match=says):
            require_plausible(PATH, plans, ROWS, SAMPLES)
