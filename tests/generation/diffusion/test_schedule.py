"""Noise schedule, DDIM steps and the Verlet standardiser."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from generation.diffusion.schedule import (
    ALPHA_BARS,
    STEPS,
    add_noise,
    choose_strided_timesteps,
    compute_reverse_step,
    run_reverse_process,
)
from generation.diffusion.standardiser import convert_actions_to_waypoints, convert_waypoints_to_actions


def test_forward_process_never_reaches_pure_noise() -> None:
    assert ALPHA_BARS[0] == pytest.approx(0.9999)
    assert ALPHA_BARS[99] == pytest.approx(0.4846, abs=1e-4)
    assert (np.diff(ALPHA_BARS) < 0).all()


@settings(max_examples=30, deadline=None)
@given(timestep=st.integers(0, 99), seed=st.integers(0, 1000))
def test_true_noise_leads_back_to_the_clean_sample(timestep: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    clean = torch.from_numpy(rng.uniform(-0.9, 0.9, (3, 16, 3)))
    noise = torch.from_numpy(rng.standard_normal((3, 16, 3)))
    noisy = add_noise(clean, noise, timestep)
    assert (compute_reverse_step(noisy, noise, timestep, -1) - clean).abs().max() < 1e-9
    if timestep:
        lower = compute_reverse_step(noisy, noise, timestep, timestep // 2)
        assert (lower - add_noise(clean, noise, timestep // 2)).abs().max() < 1e-9


@pytest.mark.parametrize("calls", [1, 2, 7, None])
def test_perfect_denoiser_recovers_the_sample_at_any_stride(calls: int | None) -> None:
    clean = torch.from_numpy(np.random.default_rng(1).uniform(-0.5, 0.5, (2, 16, 3)))

    def perfect(noisy: torch.Tensor, timesteps: torch.Tensor) -> torch.Tensor:
        alpha_bar = float(ALPHA_BARS[int(timesteps)])
        noise: torch.Tensor = (noisy - alpha_bar**0.5 * clean) / (1 - alpha_bar) ** 0.5
        return noise

    for first in (0, 4, 99):
        end = run_reverse_process(perfect, torch.full_like(clean, 0.3), choose_strided_timesteps(first, calls))
        assert (end - clean).abs().max() < 1e-6


def test_predicted_sample_is_clamped() -> None:
    noisy = torch.full((1, 16, 3), 5.0)
    assert compute_reverse_step(noisy, torch.zeros_like(noisy), 50, -1).max() == 1.0


@settings(max_examples=25, deadline=None)
@given(first=st.integers(0, 99), calls=st.integers(1, 120))
def test_strided_timesteps_fall_from_the_first(first: int, calls: int) -> None:
    asked = choose_strided_timesteps(first, calls)
    assert asked[0] == first
    assert len(asked) == min(calls, first + 1)
    assert all(later < earlier for earlier, later in itertools.pairwise(asked))
    assert asked[-1] >= 0


def test_reference_asks_at_every_step() -> None:
    assert choose_strided_timesteps(4, None) == (4, 3, 2, 1, 0)
    assert choose_strided_timesteps(STEPS - 1, None) == tuple(range(99, -1, -1))


@pytest.mark.parametrize(("first", "calls"), [(-1, None), (100, None), (5, 0), (5, -3)])
def test_impossible_strides_are_refused(first: int, calls: int | None) -> None:
    with pytest.raises(InputError):
        choose_strided_timesteps(first, calls)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 1000))
def test_standardiser_is_its_own_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    actions, previous = rng.uniform(-1, 1, (5, 16, 3)), rng.uniform(-8, 0, 3)
    waypoints = convert_actions_to_waypoints(actions, previous)
    assert np.abs(convert_waypoints_to_actions(waypoints, previous) - actions).max() < 1e-10


def test_no_action_keeps_the_speed_and_a_full_one_is_four_metres_of_second_difference() -> None:
    actions = np.zeros((2, 16, 3))
    actions[1, 0, 0] = 1.0
    for waypoints, step in zip(convert_actions_to_waypoints(actions, np.array([-5.0, 0.0, 0.0])), (5.0, 9.0)):
        assert np.allclose(waypoints[:, 0], step * np.arange(1, 17))
        assert np.allclose(waypoints[:, 1:], 0.0)
