"""Rates and their intervals against arithmetic done by hand and against a slow bootstrap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.metrics.rates import (
    HORIZONS,
    RESAMPLES,
    compute_ratios_over_scenes,
    find_interval,
    find_intervals,
    rates,
    sum_by_scene,
)
from benchmark.protocols import ProtocolOutcomes
from benchmark.protocols.exact import ExactProtocol


def outcomes_of(collision: list[list[int]], counted: list[bool]) -> ProtocolOutcomes:
    flags = np.array(collision, dtype=np.bool_).reshape(-1, 6)
    return ProtocolOutcomes(flags, flags * 2.0, np.ones_like(flags), np.array(counted))


def test_rates_are_shares_of_the_counted_samples() -> None:
    outcomes = outcomes_of(
        [[0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1], [1, 1, 1, 1, 1, 1]], [True, True, True, False]
    )
    found = rates(ExactProtocol(), outcomes, ["a", "a", "b", "b"])["collision"]
    assert [found[horizon].value for horizon in HORIZONS] == pytest.approx([1 / 3, 1 / 3, 2 / 3, 4 / 9])
    assert all(found[horizon].denominator == 3 for horizon in HORIZONS)
    assert [found[horizon].numerator for horizon in HORIZONS[:3]] == [1, 1, 2]


def test_without_counted_samples_there_is_no_rate() -> None:
    found = rates(ExactProtocol(), outcomes_of([[1, 1, 1, 1, 1, 1]], [False]), ["a"])["collision"]["3s"]
    assert found.value is None and found.low is None and found.denominator == 0
    assert rates(ExactProtocol(), outcomes_of([], []), [])["l2"]["avg"].value is None


def test_one_scene_has_no_interval() -> None:
    found = rates(ExactProtocol(), outcomes_of([[1, 1, 1, 1, 1, 1]] * 5, [True] * 5), ["a"] * 5)["collision"]["3s"]
    assert found.value == 1.0 and found.low is None and found.high is None


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_the_order_of_samples_changes_no_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=(40, 2)), np.ones((40, 2))
    scenes = [f"scene-{index}" for index in rng.integers(0, 6, 40)]
    order = rng.permutation(40)
    shuffled = compute_ratios_over_scenes(values[order], weights[order], [scenes[index] for index in order], seed=1)
    assert compute_ratios_over_scenes(values, weights, scenes, seed=1) == shuffled


def test_draws_without_a_number_widen_both_ends_to_the_bounds() -> None:
    draws = np.linspace(0.4, 0.6, 1000)
    assert find_interval(draws, (0.0, 1.0)) == (draws[24], draws[975])
    draws[::10] = np.nan
    assert find_interval(draws, (0.0, 1.0)) == (0.0, 1.0)
    assert find_interval(np.full(10, np.inf), (-1.0, np.inf)) == (np.inf, np.inf)


def test_sums_over_other_names_are_zero_where_there_was_nothing() -> None:
    sums = sum_by_scene(np.array([[1.0], [2.0], [4.0]]), np.ones((3, 1)), ["b", "a", "b"])
    assert sums.names == ("a", "b") and sums.numerators.tolist() == [[2.0], [5.0]]
    other = sums.over(["b", "c"])
    assert other.numerators.tolist() == [[5.0], [0.0]] and other.denominators.tolist() == [[2.0], [0.0]]


def one_after_the_other(values: Floats, weights: Floats, scenes: list[str]) -> list[tuple[float | None, float | None]]:
    """Intervals by the plainest way that adds in the same order: all columns in one product, a percentile each."""
    sums = sum_by_scene(values, weights, scenes)
    rng = np.random.default_rng(content_seed("scene bootstrap", list(sums.names), 0))
    count = len(sums.names)
    drawn = rng.multinomial(count, np.full(count, 1 / count), size=RESAMPLES).astype(np.float64)
    above, below = (np.einsum("rs,sc->rc", drawn, part) for part in (sums.numerators, sums.denominators))
    found: list[tuple[float | None, float | None]] = []
    for column in range(values.shape[1]):
        there = below[:, column] > 0
        if count < 2 or np.count_nonzero(sums.denominators[:, column]) < 2:
            found.append((None, None))
            continue
        low, high = np.percentile(above[there, column] / below[there, column], (2.5, 97.5))
        found.append((float(low), float(high)))
    return found


@pytest.mark.parametrize("columns", [1, 3, 9])
@pytest.mark.parametrize("seed", range(3))
def test_columns_that_are_alike_or_whole_give_the_bits_that_they_give_with_all_others(columns: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = [f"scene-{number}" for number in rng.integers(0, 12, 150)]
    kinds = [rng.random(150), rng.random(150) < 0.2, rng.integers(0, 4, 150) / 3.0]
    values = np.stack([np.asarray(kinds[(column + seed) % 3], np.float64) for column in range(columns)], axis=1)
    weights = (rng.random((150, columns)) < (0.05, 0.5, 1.0)[seed]).astype(np.float64)
    found = compute_ratios_over_scenes(values * weights, weights, scenes, seed=0)
    expected = one_after_the_other(values * weights, weights, scenes)
    assert [(rate.low, rate.high) for rate in found] == expected
    # Asked once more, from what is remembered.
    assert compute_ratios_over_scenes(values * weights, weights, scenes, seed=0) == found


def test_ends_of_several_numbers_are_those_of_each() -> None:
    rng = np.random.default_rng(0)
    draws = rng.random((4, RESAMPLES))
    draws[1, ::3], draws[2, :], draws[3, :5] = np.nan, np.nan, np.inf
    low, high = find_intervals(draws, (-1.0, 1.0))
    assert list(zip(low.tolist(), high.tolist())) == [find_interval(one, (-1.0, 1.0)) for one in draws]
    whole = np.sort(draws[0])
    assert (low[0], high[0]) == (whole[49], whole[1950])
    assert (low[2], high[2]) == (-1.0, 1.0)
