"""The Gaussians of the preconditioner: of all vehicles, and of those of a present speed."""

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.preconditioning import ACTIONS, GaussianPreconditioner, compute_present_features

STANDING, FAST = 0.0, 15.0


def features(speed: float, count: int = 1) -> Tensor:
    return compute_present_features(torch.tensor([[-0.5 * speed, 0.0, 0.0]])).expand(count, -1)


def made_up(seed: int, mean: float, count: int = 1000) -> Floats:
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((ACTIONS, ACTIONS)) * np.geomspace(1e-3, 0.1, ACTIONS)
    return np.asarray((mean + rng.standard_normal((count, ACTIONS)) @ mix.T).reshape(-1, 16, 3))


def fitted() -> GaussianPreconditioner:
    preconditioner = GaussianPreconditioner(conditioned=True)
    standing, fast = made_up(0, 0.02), made_up(1, -0.03)
    told = torch.cat([features(STANDING, len(standing)), features(FAST, len(fast))])
    preconditioner.fit(np.concatenate([standing, fast]), told)
    return preconditioner


def noise(count: int, seed: int = 2) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((count, 16, 3))).float()


def test_each_speed_has_the_moments_of_its_own_windows() -> None:
    preconditioner = fitted()
    for speed, actions in ((STANDING, made_up(0, 0.02)), (FAST, made_up(1, -0.03))):
        alone = GaussianPreconditioner()
        alone.fit(actions)
        drawn = preconditioner.start(noise(6), features(speed))
        assert torch.allclose(drawn, alone.start(noise(6)), atol=1e-4)


@pytest.mark.parametrize("told", [features(STANDING, 4), features(FAST), None])
def test_join_undoes_residual(told: Tensor | None) -> None:
    split = fitted().split(0.3 * noise(4), torch.tensor([20.0, 1.0, 50.0, 99.0]), told)
    answer = split.gaussian.from_axes(split.compute_residual(noise(4)))
    assert (split.join(answer.view(4, 16, 3)) - noise(4)).abs().max() < 1e-3
    assert torch.allclose(split.along(answer), split.compute_residual(noise(4)), atol=1e-3)


def test_one_row_speaks_for_all_and_rows_do_not_mind_each_other() -> None:
    preconditioner, at = fitted(), torch.tensor([9.0])
    mixed = torch.cat([features(STANDING, 2), features(FAST, 2), torch.zeros(2, 4)])
    together = preconditioner.split(noise(6), at, mixed)
    for rows, said in ((slice(0, 2), features(STANDING)), (slice(2, 4), features(FAST)), (slice(4, 6), None)):
        alone = preconditioner.split(noise(6)[rows], at, said)
        assert torch.allclose(together.whitened[rows], alone.whitened, atol=1e-5)
        assert torch.allclose(together.guess[rows], alone.guess, atol=1e-5)


def test_a_speed_with_too_few_windows_has_the_moments_of_all() -> None:
    preconditioner = GaussianPreconditioner(conditioned=True)
    told = torch.cat([features(STANDING, 900), features(FAST, 100)])
    preconditioner.fit(made_up(0, 0.02), told)
    assert torch.equal(preconditioner.start(noise(3), features(FAST)), preconditioner.start(noise(3)))


def test_fitting_without_speeds_is_refused() -> None:
    with pytest.raises(InputError, match="speed of every window"):
        GaussianPreconditioner(conditioned=True).fit(made_up(0, 0.0))
