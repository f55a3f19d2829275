"""Forecasts: geometry of anchors and goals, and attention around goals step by step."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.motion import GROUP_OF_CLASS, HALF_TURN, GoalAttention, MotionHead, rotate
from adapters.networks.uniad.tracking import Boxes
from tests.adapters.networks.layers.slow_sampling import slow_sampling
from tests.adapters.networks.uniad.small_uniad import SMALL, anchors


@given(st.floats(-7, 7), st.floats(-20, 20), st.floats(-20, 20))
def test_turning_is_multiplication_with_a_unit_number(angle: float, x: float, y: float) -> None:
    offsets = torch.tensor([[[x, y], [1.0, 0.0]]], dtype=torch.float64)
    found = rotate(offsets, torch.tensor([angle], dtype=torch.float64))[0].numpy()
    expected = [complex(x, y) * np.exp(1j * angle), np.exp(1j * angle)]
    np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], expected, atol=1e-9)


def agents(count: int) -> Boxes:
    generator = torch.Generator().manual_seed(count)
    boxes = torch.randn(count, 9, generator=generator) * 3
    states = torch.randn(count, 16, generator=generator)
    return Boxes(boxes, torch.rand(count), torch.arange(count) % 10, torch.arange(count), states)


def elements() -> MapElements:
    generator = torch.Generator().manual_seed(1)
    rows = [torch.randn(9, 16, generator=generator) for _ in range(2)]
    return MapElements(torch.zeros(1, 16), rows[0], rows[1], torch.zeros(1, 9, 3), torch.zeros(1, 9, 4))


def head() -> MotionHead:
    torch.manual_seed(0)
    return MotionHead(SMALL, anchors()).eval()


def test_attention_around_goals_step_by_step() -> None:
    torch.manual_seed(0)
    module = GoalAttention(8, 2, 3, 4).double().eval().requires_grad_(False)
    tokens, positions, bev = (torch.randn(rows, 8).double() for rows in (5, 5, 24))
    goals, shape = torch.rand(5, 2).double(), (4, 6)
    query = tokens + positions
    offsets = module.sampling_offsets(query).view(5, 2, 3, 4, 2)
    weights = module.attention_weights(query).view(5, 2, 3, 4).softmax(-1)
    values = module.value_proj(bev).view(1, 24, 2, 4)
    steps = [
        slow_sampling(values, [shape], goals[:, None, None, None], offsets[:, :, step, None], weights[:, :, step, None])
        for step in range(3)
    ]
    expected = tokens + module.output_proj(torch.cat(steps, -1))
    torch.testing.assert_close(module(tokens, positions, goals, bev, shape), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 11])
def test_forecasts_are_probabilities_and_sums_of_steps(count: int) -> None:
    with torch.inference_mode():
        found = head()(agents(count), elements(), torch.randn(SMALL.grid.cells, 16))
    assert found.trajectories.shape == (2, count, 6, 12, 5)
    torch.testing.assert_close(found.log_probabilities.exp().sum(-1), torch.ones(2, count))
    assert (found.trajectories[..., 2:4] > 0).all() and (found.trajectories[..., 4].abs() <= 1).all()


def test_order_of_agents_does_not_matter() -> None:
    some, order = agents(7), torch.tensor([3, 0, 6, 1, 2, 5, 4])
    mixed = Boxes(*(getattr(some, name)[order] for name in some.__slots__))
    bev = torch.randn(SMALL.grid.cells, 16)
    with torch.inference_mode():
        found, other = head()(some, elements(), bev), head()(mixed, elements(), bev)
    torch.testing.assert_close(found.trajectories[:, order], other.trajectories, rtol=1e-4, atol=1e-4)


def test_anchors_lie_along_the_heading_that_the_network_was_trained_with() -> None:
    module, some = head(), agents(4)
    with torch.inference_mode():
        _, along, _ = module._encode_anchors(some)
    for agent in range(4):
        angle = float(some.boxes[agent, 6]) - HALF_TURN
        matrix = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        own = anchors()[GROUP_OF_CLASS[agent]].double().numpy()
        np.testing.assert_allclose(along[agent].numpy(), own @ matrix.T, atol=1e-4)


def test_places_are_encoded_y_first() -> None:
    module = head()
    there = module._encode(torch.tensor([[-12.0, 0.0], [0.0, -8.0]]))
    assert there.shape == (2, 16)
    zero = torch.tensor([0.0, 1.0] * 4)
    torch.testing.assert_close(there[0, 8:], zero)
    torch.testing.assert_close(there[1, :8], zero)
    assert not torch.allclose(there[0, :8], zero)
