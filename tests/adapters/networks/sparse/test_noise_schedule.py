"""Noise levels, and numbers in which plans get noise."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from adapters.networks.sparse.diffusion import (
    SIGNAL_SHARES,
    TimeEmbedding,
    add_noise,
    denormalise,
    normalise,
    previous_sample,
)


def test_golden_noise_levels() -> None:
    assert [SIGNAL_SHARES[step] for step in (8, 19, 20)] == pytest.approx([0.999002, 0.997460, 0.997301], abs=1e-6)
    assert len(SIGNAL_SHARES) == 1000 and list(SIGNAL_SHARES) == sorted(SIGNAL_SHARES, reverse=True)
    assert float(add_noise(torch.zeros(1), torch.ones(1))) == pytest.approx(0.0316, abs=1e-4)
    assert normalise(torch.tensor([[9.0, 9.0], [-9.0, -9.0]])).tolist() == [[1.0, 1.0], [-1.0, -1.0]]


@given(x=st.floats(-3, 3), y=st.floats(-0.5, 7.6))
def test_numbers_and_metres_are_inverse_within_their_range(x: float, y: float) -> None:
    step = torch.tensor([x, y])
    assert bool((normalise(step).abs() <= 1).all())
    torch.testing.assert_close(denormalise(normalise(step)), step, rtol=0, atol=1e-5)


@pytest.mark.parametrize("timestep", [20, 1, 0])
def test_a_step_back_leads_to_the_same_plan_with_less_noise(timestep: int) -> None:
    generator = torch.Generator().manual_seed(timestep)
    clean = torch.rand(6, 6, 2, generator=generator) * 1.8 - 0.9
    noise = torch.randn(6, 6, 2, generator=generator)
    share = SIGNAL_SHARES[timestep]
    sample = math.sqrt(share) * clean + math.sqrt(1 - share) * noise
    before = SIGNAL_SHARES[timestep - 1] if timestep else 1.0
    expected = math.sqrt(before) * clean + math.sqrt(1 - before) * noise
    torch.testing.assert_close(previous_sample(sample, clean, timestep), expected, rtol=0, atol=1e-5)


def test_time_embedding() -> None:
    found = TimeEmbedding(8)(torch.tensor(20.0)).tolist()
    angles = [20 * math.exp(-math.log(10000) * k / 3) for k in range(4)]
    assert found == pytest.approx([*map(math.sin, angles), *map(math.cos, angles)], abs=1e-5)
