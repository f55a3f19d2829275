"""Which plans collide, against polygons, and the slip of the published code."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import Point, Polygon
from torch import Tensor

from adapters.networks.sparse.selection import agent_boxes, ego_boxes, find_collisions, has_corner_inside


def polygon(numbers: list[float]) -> Polygon:
    x, y, _, along, across, _, heading = numbers
    cosine, sine = math.cos(heading), math.sin(heading)
    corners = [(0.5, 0.5), (0.5, -0.5), (-0.5, -0.5), (-0.5, 0.5)]
    return Polygon(
        (x + cosine * along * a - sine * across * b, y + sine * along * a + cosine * across * b) for a, b in corners
    )


BOX = st.tuples(
    st.floats(-4, 4), st.floats(-4, 4), st.just(0.0), st.floats(1, 6), st.floats(1, 3), st.just(1.5), st.floats(-4, 4)
)


@settings(max_examples=100, deadline=None)
@given(first=BOX, second=BOX)
def test_corners_in_boxes_are_those_of_polygons(first: list[float], second: list[float]) -> None:
    own, other = polygon(list(first)), polygon(list(second))
    corners = [Point(corner) for corner in list(other.exterior.coords)[:4]]
    if any(own.exterior.distance(corner) < 1e-5 for corner in corners):
        return
    expected = any(own.contains(corner) for corner in corners)
    assert bool(has_corner_inside(torch.tensor(first), torch.tensor(second))) == expected


def straight(speed: float, x: float = 0.0) -> Tensor:
    steps = 0.5 * speed * torch.arange(1, 7)
    return torch.stack([torch.full((6,), x), steps], -1)


def test_headings_follow_the_path_and_stay_where_nothing_moves() -> None:
    turn = torch.tensor([[1.0, 0], [2, 0], [3, 1], [3, 2], [3, 3], [3, 5]])
    headings = ego_boxes(torch.stack([turn, torch.zeros(6, 2)]))[..., 6]
    assert headings[0].tolist() == pytest.approx(
        [0.0, math.atan2(1, 2), math.atan2(2, 1), math.pi / 2, math.pi / 2, math.pi / 2]
    )
    assert headings[1].tolist() == pytest.approx([math.pi / 2] * 6)
    assert ego_boxes(turn[None])[0, 0, 3:6].tolist() == pytest.approx([4.488, 1.903, 1.716])
    car = torch.tensor([[5.0, 5, 0, 1.4, 0.7, 0.4, math.sin(1), math.cos(1), 0, 0, 0]])
    standing = agent_boxes(car, torch.tensor([0.9]), car[:, None, :2].expand(-1, 6, -1) + 0.01)
    assert standing[0, :, 6].tolist() == pytest.approx([1.0] * 6)


def scene(score: float, count: int = 2) -> Tensor:
    """Whether plans at 0, 5 and 10 m/s hit the last of some cars, which stands 15 m ahead; the others are far away."""
    cars = torch.zeros(count, 11)
    cars[:, 3:6] = torch.tensor([4.0, 1.8, 1.5]).log()
    cars[:, 6], cars[:, 0], cars[-1, :2] = 1.0, 500.0, torch.tensor([0.0, 15.0])
    plans = torch.stack([straight(0.0), straight(5.0), straight(10.0), straight(5.0, x=8.0)])
    return find_collisions(plans, cars, torch.full((count,), score), cars[:, None, :2].expand(-1, 6, -1))


def test_touching_is_inside_and_crossing_without_corners_in_each_other_is_not_seen_as_published() -> None:
    square, beside = torch.tensor([0.0, 0, 0, 2, 2, 1, 0]), torch.tensor([2.0, 0, 0, 2, 2, 1, 0])
    assert has_corner_inside(square, beside)
    assert not has_corner_inside(square, beside + torch.tensor([0.01, 0, 0, 0, 0, 0, 0]))
    cross = torch.tensor([0.0, 0, 0, 9, 1, 1, 0]), torch.tensor([0.0, 0, 0, 9, 1, 1, math.pi / 2])
    assert not has_corner_inside(*cross) and not has_corner_inside(*reversed(cross))


def test_plans_that_reach_a_car_collide() -> None:
    assert scene(0.6).tolist() == [False, True, True, False]
    assert not scene(0.49).any(), "agents that are not certain are not avoided"


def test_the_slip_of_the_published_code_is_kept() -> None:
    # Boxes of the first plan at two steps get half the cosine and sine of another box's numbers, for the first agent.
    plans = torch.stack([straight(1.0), straight(1.0)]).repeat(3, 1, 1)
    car = torch.zeros(1, 11)
    car[:, 3:6] = torch.tensor([0.1, 0.1, 0.1]).log()
    car[0, 6] = 1.0
    third = ego_boxes(plans)[1, 0]
    first = ego_boxes(plans)[0, 0] + 0.5 * third.cos()
    corner = np.array(polygon(first.tolist()).exterior.coords)[0]
    inner = first[:2].numpy() + 0.999 * (corner - first[:2].numpy())
    car[0, :2] = torch.tensor(inner, dtype=torch.float32)
    away = torch.full((1, 6, 2), 900.0)
    away[0, 0] = car[0, :2]
    assert find_collisions(plans, car, torch.ones(1), away).tolist() == [True] + [False] * 5
