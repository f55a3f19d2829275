"""The joint fit: the same numbers from the same seed, what it needs, and what it refuses."""

from importlib.util import find_spec

import numpy as np
import pytest

from benchmark.errors import InputError
from leaderboard.extensions.ability import sampling
from leaderboard.extensions.ability.likelihood import NUMPY, Mathematics
from leaderboard.extensions.ability.matrix import Outcome, OutcomeMatrix
from leaderboard.extensions.ability.sampling import JointModel, compute_r_hat, fit_posterior
from tests.leaderboard.extensions.ability.made_fits import gathered

needs_numpyro = pytest.mark.skipif(find_spec("numpyro") is None, reason="the extra ability is not installed")


def matrix(outcome: Outcome, *, shared: bool = True) -> OutcomeMatrix:
    rng = np.random.default_rng(4)
    values = rng.integers(0, 3 if outcome == "ordered" else 2, (4, 6)).astype(float)
    values = np.where(rng.random((4, 6)) < 0.2, np.nan, values if outcome != "score" else rng.random((4, 6)).round(2))
    values[0, :2] = 0.0, 2.0 if outcome == "ordered" else 1.0
    recordings = tuple(f"r{at // 2 if shared else at}" for at in range(6))
    return OutcomeMatrix(outcome, tuple("abcd"), tuple(f"s{at}" for at in range(6)), recordings, values)


@needs_numpyro
@pytest.mark.parametrize("outcome", ["contact", "score", "ordered"])
def test_what_is_sampled_is_the_likelihood_whose_cells_are_checked(outcome: Outcome) -> None:
    import jax

    for shared in (True, False):
        model = JointModel.of(matrix(outcome, shared=shared))
        size = sum(int(np.prod(shape)) for shape in model.shapes.values())
        at = np.random.default_rng(1).normal(0.0, 0.7, size)
        with jax.experimental.enable_x64():
            ours = model.make_potential(NUMPY, model.outcomes)(at)
            theirs = model.make_potential(Mathematics(jax.numpy), model.outcomes)
            # One program: step by step each operation would be compiled, and kept, by itself.
            value, slopes = jax.jit(jax.value_and_grad(theirs))(at)
        assert float(ours) == pytest.approx(float(value), rel=1e-12)
        assert np.isfinite(np.asarray(slopes)).all()
        assert ("u" in model.shapes) == shared


@needs_numpyro
def test_the_same_seed_gives_the_same_numbers_and_no_time_gives_none() -> None:
    own = gathered(scenes=6, variants=1).matrix
    first, second = (fit_posterior(own, seed=2, least_draws=500) for _ in range(2))
    assert np.array_equal(first.draws["theta"], second.draws["theta"]) and first.r_hat <= sampling.MOST_R_HAT
    assert first.draws["theta"].dtype == np.float64
    with pytest.raises(InputError, match=r"did not agree within 0.001 s .* no number is given; raise --max-seconds"):
        fit_posterior(own, max_seconds=0.001)


def test_without_numpyro_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark.machine.extension.importlib.util.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install \"challenger-bench\[ability\]\""):
        fit_posterior(gathered().matrix)


def test_r_hat_tells_chains_that_agree_from_those_that_do_not() -> None:
    rng = np.random.default_rng(0)
    agree = rng.standard_normal((4, 1000, 3))
    apart = agree + np.array([0.0, 0.0, 0.0, 1.0])[:, None, None] * np.array([0.0, 1.0, 0.0])
    drifting = agree + np.linspace(0.0, 2.0, 1000)[None, :, None]
    assert compute_r_hat(agree) < 1.01 < 1.05 < compute_r_hat(apart) and compute_r_hat(drifting) > 1.05
    assert compute_r_hat(np.zeros((4, 100, 1))) == np.inf


@pytest.mark.parametrize(("planners", "recordings", "words"), [(3, 5, "3 of the 4 planners"), (4, 4, "4 of the 5 rec")])
def test_too_few_planners_or_recordings_are_refused(planners: int, recordings: int, words: str) -> None:
    names, scenes = tuple(map(str, range(planners))), tuple(map(str, range(2 * recordings)))
    sources = tuple(str(at % recordings) for at in range(len(scenes)))
    own = OutcomeMatrix("contact", names, scenes, sources, np.ones((planners, len(scenes))))
    with pytest.raises(InputError, match=words):
        own.require_enough()


@pytest.mark.parametrize(("outcome", "value"), [("contact", 0.5), ("contact", 2.0), ("score", 1.1), ("score", -0.1)])
def test_outcomes_that_cannot_be_are_refused(outcome: Outcome, value: float) -> None:
    with pytest.raises(ValueError, match="is no"):
        OutcomeMatrix(outcome, ("a",), ("s",), ("r",), np.array([[value]]))
