"""Calls of the network against an obvious version of what they ask."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmark.geometry import Floats
from generation.diffusion.checkpoint import PACKAGED_WEIGHTS, load_denoiser
from generation.diffusion.network_calls import BatchedNetwork
from generation.diffusion.preconditioning import (
    PRESENT_FEATURES,
    GaussianPreconditioner,
    ResidualBlock,
    ResidualNetwork,
    compute_present_features,
    decode_known_speed,
)

SPEEDS = (0.0, 3.0, 30.0)


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def slow_network(network: ResidualNetwork, noisy: Tensor, level: Tensor, present: Tensor) -> Tensor:
    """Module after module."""
    features = network.encoder(torch.cat([noisy.flatten(1), present.expand(len(noisy), -1)], dim=1))
    level = network.level_encoder(level)
    for block in network.blocks:
        assert isinstance(block, ResidualBlock)
        hidden = torch.nn.functional.silu(block.widen(block.norm(features)) + block.level(level))
        features = features + block.narrow(hidden)
    answer: Tensor = network.decoder(features)
    return answer.view_as(noisy)


def slow_prediction(calls: BatchedNetwork, noisy: Tensor, timestep: int, present: Tensor) -> Tensor:
    """All anew in every call."""
    denoiser = calls.denoiser
    gaussians = denoiser.preconditioner
    assert isinstance(gaussians, GaussianPreconditioner)
    speed, known = decode_known_speed(present)
    kind = int(torch.bucketize(speed, gaussians.edges, right=True))
    mean, axes, variances = gaussians.mean, gaussians.axes, gaussians.variances
    if bool(known):
        mean, axes, variances = gaussians.told_mean[kind], gaussians.told_axes[kind], gaussians.told_variances[kind]
    alpha_bar = gaussians.alpha_bars[timestep]
    variance = alpha_bar * variances + (1.0 - alpha_bar)
    along = (noisy.flatten(1) - alpha_bar.sqrt() * mean) @ axes
    whitened = ((along * variance.rsqrt()) @ axes.mT).view_as(noisy)
    answer = slow_network(denoiser.residual_network, whitened, torch.tensor([float(timestep)]), present)
    guess = (1.0 - alpha_bar).sqrt() * along / variance
    left = (alpha_bar * variances / variance).sqrt()
    return ((guess + left * (answer.flatten(1) @ axes)) @ axes.mT).view_as(noisy)


def previous_of(speed: float) -> Floats:
    return np.array([-0.5 * speed, 0.0, -0.01])


def test_what_is_kept_between_calls_changes_no_bit() -> None:
    """Two rounds over speeds and timesteps, so that each kept step is met again by others."""
    calls = BatchedNetwork(load_denoiser(PACKAGED_WEIGHTS), torch.device("cpu"), None, conditioned=True, dropout=False)
    torch.manual_seed(0)
    for _ in range(2):
        for speed in SPEEDS:
            noisy = torch.randn(24, 16, 3)
            told = compute_present_features(torch.from_numpy(previous_of(speed).astype(np.float32)))[None]
            denoise = calls.told(calls.present([previous_of(speed)], [24]))
            for timestep in (99, 40, 4, 0):
                with calls.inference_context([]):
                    answer = denoise(noisy, torch.tensor([timestep], dtype=torch.float32))
                    assert torch.equal(answer, slow_prediction(calls, noisy, timestep, told))


def test_training_goes_through_the_same_blocks() -> None:
    """Gradients of the network as it is are those of one module after the other."""
    network = load_denoiser(PACKAGED_WEIGHTS).residual_network.eval()
    torch.manual_seed(1)
    noisy, level = torch.randn(6, 16, 3), torch.full((6,), 3.0)
    present = compute_present_features(torch.tensor([[-2.0, 0.0, 0.0]]))
    parameters = list(network.parameters())
    fast = torch.autograd.grad(network(noisy, level, present).square().sum(), parameters)
    slow = torch.autograd.grad(slow_network(network, noisy, level, present).square().sum(), parameters)
    assert all(torch.allclose(one, other, rtol=1e-5) for one, other in zip(fast, slow, strict=True))


def test_speed_and_turn_are_told_in_numbers_of_order_one() -> None:
    previous = torch.tensor([[0.0, 0.0, 0.0], [-6.0, 0.1, -0.2], [-90.0, 0.0, 3.0], [4.0, 0.0, 0.0]])
    features = compute_present_features(previous)
    speed, known = decode_known_speed(features)
    assert speed.tolist() == pytest.approx([0.0, 12.0, 40.0, 0.0]) and known.all()
    assert features[0].tolist() == pytest.approx([0.0, 1.0, 0.0, 1.0])
    assert features[1].tolist() == pytest.approx([1.2, math.exp(-6.0), 1.0, 1.0])
    assert features.abs().max() < 5


def test_what_is_told_changes_the_answer_and_saying_nothing_is_zeros() -> None:
    network = load_denoiser(PACKAGED_WEIGHTS).residual_network.eval()
    torch.manual_seed(0)
    noisy, level = torch.randn(5, 16, 3), torch.tensor([30.0])
    said = compute_present_features(torch.tensor([[-4.0, 0.0, 0.0]]))
    with torch.inference_mode():
        told, each = network(noisy, level, said), network(noisy, level, said.expand(5, -1))
        nothing, zeros = network(noisy, level), network(noisy, level, torch.zeros(5, PRESENT_FEATURES))
    assert torch.equal(told, each) and torch.equal(nothing, zeros)
    assert not torch.allclose(told, nothing, atol=1e-3)
