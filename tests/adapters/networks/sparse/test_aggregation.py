"""Deformable aggregation against a loop over everything, and what is seen at the border of an image."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.networks.sparse.aggregation import CameraFeatures, deformable_aggregation
from tests.adapters.networks.layers.slow_sampling import bilinear

SHAPES = ((5, 7), (3, 4), (1, 2))
CAMERAS, GROUPS, CHANNELS = 2, 2, 6
CELLS = sum(rows * columns for rows, columns in SHAPES)


def slow(values: Tensor, locations: Tensor, weights: Tensor) -> Tensor:
    """The formula, number by number."""
    queries, cameras, points, _ = locations.shape
    found = torch.zeros(queries, CHANNELS, dtype=torch.float64)
    for query in range(queries):
        for camera in range(cameras):
            for point in range(points):
                u, v = locations[query, camera, point].double().tolist()
                if not (0 < u < 1 and 0 < v < 1):
                    continue
                start = 0
                for level, (rows, columns) in enumerate(SHAPES):
                    image = values[camera, start : start + rows * columns].double().view(rows, columns, CHANNELS)
                    start += rows * columns
                    sample = bilinear(image, u * columns - 0.5, v * rows - 0.5)
                    for group in range(GROUPS):
                        own = slice(group * CHANNELS // GROUPS, (group + 1) * CHANNELS // GROUPS)
                        found[query, own] += float(weights[query, camera, level, point, group]) * sample[own]
    return found


def drawn(seed: int, queries: int = 3, points: int = 4) -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    values = torch.randn(CAMERAS, CELLS, CHANNELS, generator=generator)
    locations = torch.rand(queries, CAMERAS, points, 2, generator=generator) * 1.6 - 0.3
    weights = torch.rand(queries, CAMERAS, len(SHAPES), points, GROUPS, generator=generator)
    return values, locations, weights


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_it_is_the_formula(seed: int) -> None:
    values, locations, weights = drawn(seed)
    fast = deformable_aggregation(values, SHAPES, locations, weights)
    torch.testing.assert_close(fast.double(), slow(values, locations, weights), rtol=1e-4, atol=1e-5)


@settings(max_examples=25, deadline=None)
@given(
    u=st.sampled_from([0.0, 1e-7, 0.05, 0.5, 0.95, 1 - 6e-8, 1.0, 1.0001]),
    v=st.sampled_from([0.0, 1e-7, 0.1, 0.9, 1.0]),
)
def test_borders_are_outside_and_what_is_next_to_them_inside(u: float, v: float) -> None:
    values, locations, weights = drawn(0, 1, 1)
    locations[...] = torch.tensor([u, v])
    fast = deformable_aggregation(values, SHAPES, locations, weights)
    torch.testing.assert_close(fast.double(), slow(values, locations, weights), rtol=1e-4, atol=1e-5)
    inside = 0 < locations[0, 0, 0, 0] < 1 and 0 < locations[0, 0, 0, 1] < 1
    assert bool(fast.any()) == bool(inside)


def test_what_lies_outside_or_nowhere_counts_nothing_whatever_its_weight() -> None:
    values, locations, weights = drawn(1)
    locations[0] = 5.0
    locations[1] = torch.nan
    locations[2, 0], locations[2, 1, 0] = torch.inf, 0.5
    weights[0] = torch.nan
    found = deformable_aggregation(values, SHAPES, locations, weights)
    assert not found[:2].any() and found[2].any()
    assert not deformable_aggregation(values, SHAPES, torch.full_like(locations, -1.0), weights).any()


def test_a_query_does_not_depend_on_the_others() -> None:
    values, locations, weights = drawn(2, queries=5)
    whole = deformable_aggregation(values, SHAPES, locations, weights)
    alone = [deformable_aggregation(values, SHAPES, locations[[i]], weights[[i]]) for i in range(5)]
    assert torch.equal(whole, torch.cat(alone))


def test_gradients_are_those_of_the_formula() -> None:
    values, locations, weights = (tensor.double() for tensor in drawn(3, 2, 2))
    values.requires_grad_()
    (own,) = torch.autograd.grad(deformable_aggregation(values, SHAPES, locations, weights).sum(), values)
    (expected,) = torch.autograd.grad(slow(values, locations, weights).sum(), values)
    torch.testing.assert_close(own, expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("depth", [4.0, 1e-6, -4.0])
def test_points_are_divided_by_their_depth_but_never_by_less_than_the_least(depth: float) -> None:
    projection = torch.tensor([[[100.0, 0, 50, 0], [0, 200, 60, 0], [0, 0, 1, 0], [0, 0, 0, 1]]])
    cameras = CameraFeatures.of([torch.zeros(1, 2, 4, 4)], projection, height_px=120, width_px=100)
    u, v = cameras.locate(torch.tensor([[[1.0, 2.0, depth]]]))[0, 0, 0].tolist()
    divisor = max(depth, 1e-5)
    assert u == pytest.approx((100 + 50 * depth) / divisor / 100, rel=1e-5)
    assert v == pytest.approx((400 + 60 * depth) / divisor / 120, rel=1e-5)
