"""The fast solver against the exact flow of a Gaussian, against the slow process, and at its edges."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from benchmark.errors import InputError
from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, draw_normal_noise, load_denoiser
from generation.diffusion.prior import SOLVER_CALLS
from generation.diffusion.schedule import (
    ALPHA_BARS,
    STEPS,
    choose_solver_timesteps,
    choose_strided_timesteps,
    compute_log_ratios,
    run_reverse_process,
    solve,
)

MEAN = 0.05
VARIANCES = torch.logspace(-4, -1.7, 48, dtype=torch.float64).view(16, 3)
"""Of a Gaussian that stands for driving: some directions hardly vary, others much."""


@given(st.integers(2, STEPS))
def test_timesteps_fall_from_the_noisiest_to_the_cleanest(calls: int) -> None:
    timesteps = choose_solver_timesteps(calls)
    assert (len(timesteps), timesteps[0], timesteps[-1]) == (calls, STEPS - 1, 0)
    assert all(later < earlier for earlier, later in itertools.pairwise(timesteps))


def test_few_timesteps_are_even_in_the_logarithm_of_signal_over_noise() -> None:
    steps = np.diff(compute_log_ratios()[list(choose_solver_timesteps(8))])
    assert steps.min() > 0.75 * steps.mean()
    assert steps.max() < 1.25 * steps.mean()


@pytest.mark.parametrize("calls", [1, 0, STEPS + 1])
def test_impossible_numbers_of_calls_are_refused(calls: int) -> None:
    with pytest.raises(InputError, match="2 to 100 network calls"):
        choose_solver_timesteps(calls)


def gaussian_denoiser(noisy: Tensor, timestep: Tensor) -> Tensor:
    """The perfect prediction where clean actions are normal."""
    alpha_bar = float(ALPHA_BARS[int(timestep)])
    spread = alpha_bar * VARIANCES + (1 - alpha_bar)
    noise: Tensor = (1 - alpha_bar) ** 0.5 * (noisy - alpha_bar**0.5 * MEAN) / spread
    return noise


def exact_flow(noisy: Tensor, timestep: int) -> Tensor:
    """Where the flow carries actions from the noisiest timestep: the deviation grows and shrinks with the spread.

    Then the perfect prediction of the clean sample.
    """
    first, last = float(ALPHA_BARS[-1]), float(ALPHA_BARS[timestep])
    ratio = ((last * VARIANCES + 1 - last) / (first * VARIANCES + 1 - first)).sqrt()
    there = last**0.5 * MEAN + ratio * (noisy - first**0.5 * MEAN)
    clean: Tensor = (there - (1 - last) ** 0.5 * gaussian_denoiser(there, torch.tensor([timestep]))) / last**0.5
    return clean


def start(count: int = 64) -> Tensor:
    alpha_bar = float(ALPHA_BARS[-1])
    noise = draw_normal_noise(np.random.default_rng(0), count).double()
    noisy: Tensor = alpha_bar**0.5 * MEAN + (alpha_bar * VARIANCES + 1 - alpha_bar).sqrt() * noise
    return noisy


def root_mean_square(values: Tensor) -> float:
    return float(values.square().mean().sqrt())


def test_error_falls_with_the_square_of_the_step() -> None:
    """Four times the calls: a first-order process would be four times as close, this one sixteen times."""
    noisy = start()
    exact = exact_flow(noisy, 0)

    def order(few: Tensor, many: Tensor) -> float:
        return float(np.log2(root_mean_square(few - exact) / root_mean_square(many - exact)) / 2)

    fast = [solve(gaussian_denoiser, noisy, choose_solver_timesteps(calls)) for calls in (4, 16)]
    slow = [
        run_reverse_process(gaussian_denoiser, noisy, choose_strided_timesteps(STEPS - 1, calls)) for calls in (4, 16)
    ]
    assert order(*fast) > 1.9
    assert order(*slow) < 1.1
    assert root_mean_square(fast[1] - exact) < 0.01 * root_mean_square(exact - MEAN)


def test_predicted_sample_is_clamped() -> None:
    huge = torch.full((2, 16, 3), 50.0)
    assert solve(lambda noisy, timestep: torch.zeros_like(noisy), huge, choose_solver_timesteps(4)).max() == 1.0


def test_few_calls_end_where_the_slow_process_ends_from_the_same_noise() -> None:
    """The reference's 100 steps without their noise solve the same equation, so samples agree one by one."""
    denoiser = load_denoiser(PACKAGED_WEIGHTS)
    noisy = denoiser.start(draw_normal_noise(np.random.default_rng(1), 64))
    with torch.inference_mode():
        finest = solve(denoiser, noisy, choose_solver_timesteps(STEPS))
        slow = run_reverse_process(denoiser, noisy, choose_strided_timesteps(STEPS - 1, None))
        off = [
            root_mean_square(solve(denoiser, noisy, choose_solver_timesteps(calls)) - finest)
            for calls in (4, SOLVER_CALLS)
        ]
    spread = root_mean_square(finest - finest.mean(0))
    assert root_mean_square(slow - finest) < 0.1 * spread
    assert off[1] < 0.5 * off[0]
    assert off[1] < 0.2 * spread
