"""Plans that know the recorded future are told from plans that foretell it; by hand, and on drawn motions."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.metrics.leaks import LeakSample, compute_leak_figures, measure_surprise_m

AHEAD = np.array([0.0, 1.0])
TIMES = 0.5 * np.arange(1, 7)


def straight(distances: Floats) -> Floats:
    return np.stack([np.zeros(6), distances], axis=1)


def moment(
    recorded: Floats, planned: Floats | None = None, *, before: float, now: float, danger: bool = False
) -> LeakSample:
    return LeakSample(recorded if planned is None else planned, recorded, AHEAD, (before, now), danger)


@pytest.mark.parametrize(
    ("before", "now", "distances"),
    [
        (8.0, 8.0, 8.0 * TIMES),
        (8.0, 8.0, np.zeros(6)),
        (8.0, 9.0, 9.0 * TIMES + TIMES**2),
        (8.0, 9.0, 9.0 * TIMES + TIMES**2 / 2),
        # From 4 m/s at -2 m/s² a car stands after 2 s and 4 m.
        (5.0, 4.0, np.array([1.75, 3.0, 3.75, 4.0, 4.0, 4.0])),
    ],
)
def test_simple_continuations_are_no_surprise(before: float, now: float, distances: Floats) -> None:
    assert measure_surprise_m(moment(straight(distances), before=before, now=now)) == pytest.approx(0.0, abs=1e-9)


def test_a_bend_is_no_surprise_and_braking_is() -> None:
    angles = 8.0 * TIMES / 20.0
    bend = 20.0 * np.stack([1 - np.cos(angles), np.sin(angles)], axis=1)
    # Chords are a little shorter than the bend.
    assert measure_surprise_m(moment(bend, before=8.0, now=8.0)) < 0.3
    moves = np.minimum(TIMES, 8.0 / 3.0)
    braked = 8.0 * moves - 1.5 * moves**2
    kept, stood = 8.0 * TIMES - braked, braked
    expected = min(math.sqrt(np.mean(kept**2)), math.sqrt(np.mean(stood**2)))
    assert measure_surprise_m(moment(straight(braked), before=8.0, now=8.0)) == pytest.approx(expected)


def drives(count: int, rng: np.random.Generator) -> list[LeakSample]:
    """Cars that keep 8 m/s or begin to brake or speed up at a moment that nobody can foretell; the plan keeps it."""
    found = []
    for number in range(count):
        starts, change = rng.uniform(0.0, 1.5), rng.uniform(-3.0, 3.0)
        after = np.maximum(TIMES - starts, 0.0)
        recorded = straight(8.0 * TIMES + change * after**2 / 2)
        speed = 8.0 + rng.normal(0.0, 0.05)
        planned = straight(speed * TIMES + 0.3 * change * after**2 / 2)
        found.append(moment(recorded, planned, before=8.0, now=8.0, danger=number % 4 == 0))
    return found


def test_honest_plans_are_not_suspected() -> None:
    assert compute_leak_figures(drives(300, np.random.default_rng(1))).suspicions == ()


@settings(deadline=None, max_examples=6)
@given(seed=st.integers(0, 1000), metres=st.sampled_from([0.0, 0.03, 0.06, 0.12]), hard_only=st.booleans())
def test_the_future_with_noise_is_suspected_also_on_dangerous_samples_alone(
    seed: int, metres: float, hard_only: bool
) -> None:
    rng = np.random.default_rng(seed)
    leaks = [
        replace(each, planned=each.recorded + rng.normal(0.0, metres, (6, 2)))
        if each.dangerous or not hard_only
        else each
        for each in drives(300, rng)
    ]
    said = compute_leak_figures(leaks).suspicions
    assert any("unpredictable futures are matched" in sentence for sentence in said)
    assert any("dangerous" in sentence for sentence in said) or not hard_only


def test_who_knows_when_somebody_will_brake_is_suspected() -> None:
    rng = np.random.default_rng(2)
    braking = [each for each in drives(600, rng) if each.recorded[-1, 1] - each.recorded[-2, 1] < 2.8]
    assert len(braking) > 20 and not any("brakes" in said for said in compute_leak_figures(braking).suspicions)
    knows = [replace(each, planned=each.recorded + rng.normal(0.0, 0.1, (6, 2))) for each in braking]
    assert any("brakes" in said for said in compute_leak_figures(knows).suspicions)


def test_of_few_samples_and_of_cars_that_stand_nothing_is_said() -> None:
    standing = [moment(np.zeros((6, 2)), before=0.0, now=0.0) for _ in range(100)]
    assert compute_leak_figures(standing).suspicions == () and compute_leak_figures(standing).moving == 0
    assert compute_leak_figures(drives(5, np.random.default_rng(0))).error_m is None
    assert compute_leak_figures([]).suspicions == ()


def test_plans_that_are_off_by_one_offset_are_not_taken_for_the_future() -> None:
    # A wrong lidar mount: errors do not grow either, and are large at once.
    off = [replace(each, planned=each.planned + [0.0, 0.94]) for each in drives(300, np.random.default_rng(3))]
    assert compute_leak_figures(off).suspicions == ()
