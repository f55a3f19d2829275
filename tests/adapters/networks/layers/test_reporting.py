"""Which boxes count as what a network expects."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from adapters.networks.layers.reporting import PUBLISHED, STANDING_M, find_distinct, limit_steering

PLACES = st.lists(st.tuples(*[st.integers(-8, 8)] * 2, st.integers(1, 9), st.integers(0, 4)), max_size=8)


@given(PLACES)
def test_of_what_is_too_near_the_surest_is_left(boxes: list[tuple[int, int, int, int]]) -> None:
    """What is left is apart, and whatever is left out is near something surer, or as sure and before it."""
    table = torch.tensor(boxes, dtype=torch.float32).reshape(-1, 4)
    centres, lengths, certainty = table[:, :2], table[:, 2], table[:, 3]
    left = find_distinct(centres, lengths, certainty, 0.5).tolist()

    def near(one: int, other: int) -> bool:
        distance = float((centres[one] - centres[other]).norm())
        return distance < 0.5 * float(torch.minimum(lengths[one], lengths[other]))

    kept = [place for place, stays in enumerate(left) if stays]
    assert not any(near(one, other) for one, other in itertools.combinations(kept, 2))
    for place, stays in enumerate(left):
        if not stays:
            surer = [each for each in kept if (-certainty[each], each) < (-certainty[place], place)]
            assert any(near(place, each) for each in surer)


def test_cars_side_by_side_and_walkers_in_a_row_are_several_and_as_published_everything_counts() -> None:
    cars = torch.tensor([[0.0, 0.0], [2.6, 0.0]])
    assert find_distinct(cars, torch.full((2,), 4.6), torch.tensor([0.9, 0.5]), 0.5).all()
    walkers = torch.tensor([[0.0, 0.0], [0.6, 0.0], [1.2, 0.0]])
    assert find_distinct(walkers, torch.full((3,), 0.8), torch.tensor([0.9, 0.5, 0.7]), 0.5).all()
    twice = torch.tensor([[0.0, 0.0], [1.0, 1.0]])
    assert find_distinct(twice, torch.full((2,), 4.6), torch.tensor([0.4, 0.5]), 0.5).tolist() == [False, True]
    for apart in (0.0, PUBLISHED.apart):
        assert find_distinct(torch.zeros(3, 2), torch.ones(3), torch.ones(3), apart).all()
    plan = np.full((6, 2), 0.1)
    assert PUBLISHED.steered_from_m == 0 and limit_steering(plan, PUBLISHED.steered_from_m) is plan


@given(st.floats(0.0, 12.0), st.floats(-1.5, 1.5))
def test_short_plans_lead_more_straight_ahead_and_long_ones_where_they_did(length_m: float, bearing: float) -> None:
    along = length_m * np.linspace(0.0, 1.0, 7)[1:, None]
    plan = along * np.array([np.sin(bearing), np.cos(bearing)])
    found = limit_steering(plan[None], 6.0)[0]
    assert np.array_equal(found[:, 1], plan[:, 1])
    if length_m >= 6.0 + 1e-9:
        assert np.array_equal(found, plan)
    elif length_m <= STANDING_M:
        assert not found[:, 0].any()
    else:
        share = (length_m - STANDING_M) / (6.0 - STANDING_M)
        assert found[:, 0] == pytest.approx(share * plan[:, 0], abs=1e-9)
