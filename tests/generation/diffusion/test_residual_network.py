"""The small noise predictor."""

import math

import pytest
import torch
from torch import nn

from generation.diffusion.preconditioning import (
    LEVEL_FEATURES,
    PRESENT_FEATURES,
    ResidualNetwork,
    compute_present_features,
    decode_known_speed,
)


class Repeated(nn.Module):
    """Level features of a test: the level itself, many times."""

    def forward(self, level: torch.Tensor) -> torch.Tensor:
        return level[:, None].expand(-1, LEVEL_FEATURES)


def network(dropout: float = 0.0) -> ResidualNetwork:
    torch.manual_seed(0)
    return ResidualNetwork(24, 16, 2, dropout, Repeated())


def trained(made: ResidualNetwork) -> ResidualNetwork:
    """Any weights that are not zero."""
    with torch.no_grad():
        for parameter in made.parameters():
            parameter.copy_(0.3 * torch.randn_like(parameter))
    return made


def test_says_nothing_before_training() -> None:
    answer = network()(torch.randn(5, 16, 3), torch.zeros(1))
    assert answer.shape == (5, 16, 3)
    assert not answer.any()


def test_every_weight_learns() -> None:
    made = trained(network())
    made(torch.randn(5, 16, 3), torch.ones(1)).square().sum().backward()
    assert all(parameter.grad is not None and parameter.grad.any() for parameter in made.parameters())


def test_one_level_for_all_is_the_same_as_one_each() -> None:
    made, noisy = trained(network()).eval(), torch.randn(5, 16, 3)
    with torch.inference_mode():
        together = made(noisy, torch.tensor([0.3]))
        each = made(noisy, torch.full((5,), 0.3))
        alone = torch.cat([made(one[None], torch.tensor([0.3])) for one in noisy])
        other = made(noisy, torch.tensor([0.9]))
    assert torch.allclose(together, each, atol=1e-5)
    assert torch.allclose(together, alone, atol=1e-5)
    assert not torch.allclose(together, other, atol=1e-2)


def test_speed_and_turn_are_told_in_numbers_of_order_one() -> None:
    previous = torch.tensor([[0.0, 0.0, 0.0], [-6.0, 0.1, -0.2], [-90.0, 0.0, 3.0], [4.0, 0.0, 0.0]])
    features = compute_present_features(previous)
    speed, known = decode_known_speed(features)
    assert speed.tolist() == pytest.approx([0.0, 12.0, 40.0, 0.0])
    assert known.all()
    assert features[0].tolist() == pytest.approx([0.0, 1.0, 0.0, 1.0])
    assert features[1].tolist() == pytest.approx([1.2, math.exp(-6.0), 1.0, 1.0])
    assert features.abs().max() < 5


def test_what_is_told_changes_the_answer_and_saying_nothing_is_zeros() -> None:
    torch.manual_seed(0)
    made = trained(ResidualNetwork(24, 16, 2, 0.0, Repeated(), conditioned=True)).eval()
    noisy, level = torch.randn(5, 16, 3), torch.tensor([0.3])
    said = compute_present_features(torch.tensor([[-4.0, 0.0, 0.0]]))
    with torch.inference_mode():
        told, each = made(noisy, level, said), made(noisy, level, said.expand(5, -1))
        nothing, zeros = made(noisy, level), made(noisy, level, torch.zeros(5, PRESENT_FEATURES))
    assert torch.equal(told, each)
    assert torch.equal(nothing, zeros)
    assert not torch.allclose(told, nothing, atol=1e-2)


def test_dropout_is_off_when_asked_to_answer() -> None:
    made, noisy = trained(network(dropout=0.5)), torch.randn(5, 16, 3)
    assert not torch.equal(made(noisy, torch.zeros(1)), made(noisy, torch.zeros(1)))
    made.eval()
    assert torch.equal(made(noisy, torch.zeros(1)), made(noisy, torch.zeros(1)))
