"""Cells: golden ones, gradients and information by numbers, and probabilities that add up to one."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import integrate, special

from leaderboard.extensions.ability.likelihood import (
    CLIPPED,
    NUMPY,
    ScoreItem,
    clip_scores,
    compute_binary_information,
    compute_binary_log_likelihood,
    compute_expected_score,
    compute_ordered_log_likelihood,
    compute_score_gradients,
    compute_score_information,
    compute_score_log_likelihood,
)
from leaderboard.extensions.ability.posterior import find_half
from leaderboard.extensions.ability.verification import BUILT_IN, GOLDEN


def test_the_built_in_cells_and_matrix_agree() -> None:
    checks = {check.quantity: check for check in GOLDEN.verify()}
    assert all(check.passes for check in checks.values()) and checks["cells: loglik"].count == 200


@pytest.mark.path
def test_the_built_in_cells_agree_and_a_changed_cell_is_found(tmp_path: Path) -> None:
    changed = tmp_path / "irt"
    changed.mkdir()
    shutil.copy(BUILT_IN / "cells.json", changed)
    # No sampling: what it imports starts threads, and other tests of the core fork.
    assert all(check.passes for check in GOLDEN.verify(changed))
    cells = json.loads((changed / "cells.json").read_text())
    cells[7]["d_g0"] += 1e-8
    (changed / "cells.json").write_text(json.dumps(cells))
    wrong = [check.quantity for check in GOLDEN.verify(changed) if not check.passes]
    assert wrong == ["cells: d_g0"]


def item(rng: np.random.Generator) -> tuple[float, ScoreItem]:
    t, (beta, omega, g0) = float(rng.normal()), rng.normal(scale=0.7, size=3) + [0.0, 1.5, -1.0]
    return t, ScoreItem(beta, omega, g0, float(rng.uniform(0.5, 3)))


@pytest.mark.parametrize("x", [0.0, 1.0, 0.03, 0.6])
def test_gradients_are_those_of_small_steps(x: float) -> None:
    t, own = item(np.random.default_rng(int(100 * x)))
    step = 1e-6

    def value(at: float, of: ScoreItem) -> float:
        return float(compute_score_log_likelihood(np.array(x), np.array(at), of, NUMPY))

    found = compute_score_gradients(np.array(x), np.array(t), own)
    slopes: dict[str, Any] = {"t": (value(t + step, own) - value(t - step, own)) / (2 * step)}
    for name in ScoreItem._fields:
        sides = [value(t, own._replace(**{name: getattr(own, name) + sign * step})) for sign in (1, -1)]
        slopes[name] = (sides[0] - sides[1]) / (2 * step)
    for name, slope in slopes.items():
        assert float(getattr(found, name)) == pytest.approx(slope, abs=1e-7)


def test_the_masses_and_the_density_of_scores_add_up_and_the_information_is_the_mean_squared_slope() -> None:
    for seed in range(3):
        t, own = item(np.random.default_rng(seed))

        def density(x: float, t: float = t, own: ScoreItem = own) -> float:
            return float(np.exp(compute_score_log_likelihood(np.array(x), np.array(t), own, NUMPY)))

        def weighed(x: float, t: float = t, own: ScoreItem = own) -> float:
            return density(x) * float(compute_score_gradients(np.array(x), np.array(t), own).t) ** 2

        inside = integrate.quad(density, 0, 1)[0], integrate.quad(lambda x: x * density(x), 0, 1)[0]
        assert inside[0] + density(0.0) + density(1.0) == pytest.approx(1.0, abs=1e-7)
        assert inside[1] + density(1.0) == pytest.approx(float(compute_expected_score(np.array(t), own)), abs=1e-7)
        information = integrate.quad(weighed, 0, 1)[0] + weighed(0.0) + weighed(1.0)
        assert information == pytest.approx(float(compute_score_information(np.array(t), own)), rel=1e-6)


def test_binary_and_ordered_cells_agree_with_two_categories_and_add_up_with_more() -> None:
    rng = np.random.default_rng(2)
    ability, beta, alpha = rng.normal(size=20), rng.normal(size=20), np.exp(rng.normal(size=20))
    for x in (0.0, 1.0):
        binary = compute_binary_log_likelihood(x, alpha, ability, beta, NUMPY)
        cuts = (alpha * beta)[:, None]
        assert np.allclose(binary, compute_ordered_log_likelihood(np.full(20, x), alpha * ability, cuts, NUMPY))
    cuts = np.sort(rng.normal(size=(20, 3)), axis=1)
    parts = [np.exp(compute_ordered_log_likelihood(np.full(20, float(k)), ability, cuts, NUMPY)) for k in range(4)]
    assert np.allclose(sum(parts), 1.0) and min(part.min() for part in parts) > 0.0
    safe = 1.0 / (1.0 + np.exp(-alpha * (ability - beta)))
    assert np.allclose(compute_binary_information(alpha, ability, beta), alpha**2 * safe * (1 - safe))


def test_scores_that_are_nearly_zero_or_one_are_clipped_and_exact_ones_are_not() -> None:
    assert clip_scores(np.array([0.0, 1e-9, 0.5, 1 - 1e-9, 1.0])).tolist() == [0.0, CLIPPED, 0.5, 1.0 - CLIPPED, 1.0]


def test_far_out_nothing_overflows_and_half_is_found() -> None:
    own = ScoreItem(np.array([0.0, 30.0]), np.array([1.5, 1.5]), np.array([-2.0, -2.0]), np.array([1e-3, 4.0]))
    with np.errstate(all="raise", under="ignore"):
        for x in (0.0, 0.4, 1.0):
            value = compute_score_log_likelihood(np.full(2, x), np.array([-60.0, 60.0]), own, NUMPY)
            assert np.isfinite(value).all()
    assert np.allclose(compute_expected_score(find_half(own), own), 0.5)


def test_the_beta_function_is_that_of_scipy_and_logs_are_stable_far_out() -> None:
    a, b = np.exp(np.random.default_rng(0).uniform(-8, 8, (2, 500)))
    assert np.allclose(NUMPY.log_beta(a, b), special.betaln(a, b), rtol=1e-12, atol=1e-9)
    assert NUMPY.log_sigmoid(np.array([-800.0, 0.0, 800.0])) == pytest.approx([-800.0, -np.log(2.0), 0.0])
