from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Floats
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import MutationRequest, run_searches
from generation.search.refinement import EvaluatedBatch, Refinement, ResamplingUnderflowError, refine, resample
from generation.search.scoring import ScoreTerms
from tests.generation.search.driving_prior import DrivingPrior, unchanged

HYPER = HyperParameters(candidates=32)
PREVIOUS = np.array([-3.0, 0.0, 0.0])


def at_distance(waypoints: Floats, distance: Floats, finite: bool = True) -> EvaluatedBatch:
    """A batch without faults whose challenge is a given distance."""
    count = len(waypoints)
    none = np.zeros((count, HYPER.horizon), dtype=np.bool_)
    terms = ScoreTerms(
        center_off_road=none,
        corner_off_road=none,
        collision=none,
        distance=np.repeat(distance[:, None], HYPER.horizon, axis=1),
        dac=np.zeros(count),
        cr=np.zeros(count),
        challenge=distance,
        finite=np.full(count, finite),
    )
    states = np.zeros((count, 13, 6))
    motion = SimulatedMotion(states[..., :3], states, np.zeros((count, 12, 2)), terms.finite)
    return EvaluatedBatch(motion, terms)


def to_a_target(waypoints: Floats) -> EvaluatedBatch:
    return at_distance(waypoints, np.hypot(waypoints[:, 3, 0] - 14.0, waypoints[:, 3, 1] - 2.0))


def refined(evaluate: Callable[[Floats], EvaluatedBatch], hyper: HyperParameters, seed: int = 0) -> Refinement:
    search = refine(unchanged, evaluate, PREVIOUS, hyper, np.random.default_rng(seed))
    return run_searches([search], DrivingPrior())[0][0]


def search(hyper: HyperParameters, seed: int = 0) -> Refinement:
    return refined(to_a_target, hyper, seed)


def test_refinement_comes_closer_than_one_batch_and_never_falls_behind() -> None:
    one_batch = HyperParameters(candidates=32, multi_round=False)

    def missed(hyper: HyperParameters) -> list[float]:
        return [float(np.hypot(*(search(hyper, seed).waypoints[3, :2] - [14.0, 2.0]))) for seed in range(10)]

    several, single = missed(HyperParameters(candidates=32, temperature=5.0)), missed(one_batch)
    assert all(after <= before + 1e-12 for after, before in zip(several, single, strict=True))
    assert np.mean(several) < 0.9 * np.mean(single)


def test_trace_has_one_entry_a_round_and_ablations_have_what_they_say() -> None:
    assert len(search(HYPER).rounds) == 6
    assert len(search(HyperParameters(candidates=8, multi_round=False)).rounds) == 1
    assert HYPER.noise_levels() == (5, 4, 3, 2, 1)
    unscored = [search(HyperParameters(candidates=32, scored=False), seed) for seed in range(8)]
    assert {found.round for found in unscored} == {5}
    assert len({found.chosen for found in unscored}) > 3


@pytest.mark.parametrize(("best_of_all", "best"), [(True, (1, 0)), (False, (2, 1))])
def test_the_best_of_all_rounds_is_kept_and_the_reference_forgets_all_but_the_last(
    best_of_all: bool, best: tuple[int, int]
) -> None:
    calls = iter([np.array([5.0, 9.0]), np.array([1.0, 6.0]), np.array([30.0, 4.0])])
    hyper = HyperParameters(candidates=2, rounds=2, init_scale=0.0, best_of_all_rounds=best_of_all)
    found = refined(lambda waypoints: at_distance(waypoints, next(calls)), hyper)
    assert (found.round, found.chosen) == best
    assert not best_of_all or found.score == 0.0


def test_every_round_asks_for_less_and_less_noise() -> None:
    asking = refine(unchanged, to_a_target, PREVIOUS, HYPER, np.random.default_rng(0))
    request, levels = next(asking), []
    with pytest.raises(StopIteration):
        while True:
            levels.append(request.noise_level if isinstance(request, MutationRequest) else None)
            request = asking.send(DrivingPrior().answer([request])[0])
    assert levels == [None, 5, 4, 3, 2, 1]


def test_searches_side_by_side_are_as_if_alone() -> None:
    alone = [search(HYPER, seed) for seed in range(4)]
    searches = [refine(unchanged, to_a_target, PREVIOUS, HYPER, np.random.default_rng(seed)) for seed in range(4)]
    together, seconds = run_searches(searches, DrivingPrior())
    assert len(seconds) == 4
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one.waypoints, other.waypoints)


def test_an_unstable_softmax_draws_like_a_stable_one_until_it_underflows() -> None:
    unstable = HyperParameters(stable_softmax=False)
    scores = np.linspace(0.0, 5.0, 400)
    drawn = [resample(scores, hyper, np.random.default_rng(0)) for hyper in (HYPER, unstable)]
    assert (drawn[0] == drawn[1]).mean() > 0.99
    parked = scores + 133.0
    with pytest.raises(ResamplingUnderflowError, match=r"133\.0"):
        resample(parked, unstable, np.random.default_rng(0))
    np.testing.assert_array_equal(resample(parked, HYPER, np.random.default_rng(0)), drawn[0])


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(0.0, 1e4), min_size=2, max_size=40), st.integers(0, 1000))
def test_resampling_is_stable_for_huge_scores(scores: list[float], seed: int) -> None:
    drawn = resample(np.array(scores) + 1e5, HYPER, np.random.default_rng(seed))
    assert len(drawn) == len(scores)
    hopeless = np.array(scores) > min(scores) + 800.0
    assert not hopeless[drawn].any()


@pytest.mark.parametrize("temperature", [0.1, 1.0, 4.0])
def test_resampling_follows_the_softmax(temperature: float) -> None:
    scores, hyper = np.repeat([0.0, 1.0, np.inf], 4000), HyperParameters(temperature=temperature)
    drawn = resample(scores, hyper, np.random.default_rng(1)) // 4000
    share = np.bincount(drawn, minlength=3) / len(scores)
    best = 1 / (1 + np.exp(-temperature))
    np.testing.assert_allclose(share, [best, 1 - best, 0.0], atol=0.02)


def test_without_a_finite_candidate_the_score_is_infinite() -> None:
    found = refined(lambda waypoints: at_distance(waypoints, np.ones(len(waypoints)), finite=False), HYPER)
    assert found.score == np.inf
