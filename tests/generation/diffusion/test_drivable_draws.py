"""Draws of one request: counted, asked for again, the drivable ones given first."""

import numpy as np
import pytest

from benchmark.geometry import Floats
from generation.diffusion.kinematics import TrajectoryDraws, select_most_drivable

PREVIOUS = np.array([-4.0, 0.0, 0.0])


def steady(count: int) -> Floats:
    """Straight on at 8 m/s, told apart by a speed that differs a little."""
    speed = 8.0 + 0.01 * np.arange(count)
    along = 0.5 * speed[:, None] * np.arange(1, 17)
    return np.stack([along, np.zeros_like(along), np.zeros_like(along)], axis=-1)


def reversing(count: int) -> Floats:
    return -steady(count)


def test_drivable_ones_come_first_in_the_order_of_drawing() -> None:
    draws = TrajectoryDraws.empty().extend(reversing(3), PREVIOUS).extend(steady(5), PREVIOUS)
    np.testing.assert_array_equal(draws.select_best(4), steady(5)[:4])


def test_the_least_bad_ones_fill_up() -> None:
    draws = TrajectoryDraws.empty().extend(reversing(3), PREVIOUS).extend(steady(2), PREVIOUS)
    best = draws.select_best(4)
    np.testing.assert_array_equal(best[:2], steady(2))
    assert len(best) == 4
    assert list(select_most_drivable(np.array([0.3, 0.0, 0.1, 0.2]), 3)) == [1, 2, 3]


@pytest.mark.parametrize(
    ("good", "bad", "count", "missing"), [(256, 64, 256, 0), (128, 128, 192, 154 + 8), (0, 9, 5, 5)]
)
def test_more_are_asked_for_by_the_share_so_far(good: int, bad: int, count: int, missing: int) -> None:
    draws = TrajectoryDraws.empty()
    for made in (steady(good), reversing(bad)):
        if len(made):
            draws = draws.extend(made, PREVIOUS)
    assert draws.missing(count) == missing
