"""Boxes, lines and points from frame to frame, and what they are told by."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from adapters.networks.layers.attention import ResidualAttention
from adapters.networks.sparse.aggregation import AsymmetricFeedForward, decoupled_attention, sine_of_points
from adapters.networks.sparse.boxes import (
    BoxPoints,
    KeyframeMotion,
    KeyframePose,
    carry_boxes,
    decode_boxes,
    heading_of,
)
from adapters.networks.sparse.decoder import LinePoints, at_heights, carry_lines

NUMBERS = st.floats(-50, 50)


def pose(x: float, y: float, yaw_rad: float) -> Tensor:
    matrix = torch.eye(4, dtype=torch.float64)
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    matrix[:2, :2] = torch.tensor([[cosine, -sine], [sine, cosine]], dtype=torch.float64)
    matrix[:2, 3] = torch.tensor([x, y], dtype=torch.float64)
    return matrix


def motion(first: Tensor, second: Tensor, seconds: float = 0.5) -> KeyframeMotion:
    poses = KeyframePose(1.5e9, first, "a"), KeyframePose(1.5e9 + seconds, second, "a")
    return KeyframeMotion.between(*poses, torch.device("cpu"))


def box(x: float, y: float, heading: float, speed: float = 0.0) -> Tensor:
    """A car of 4 m by 2 m that drives where it heads."""
    cosine, sine = math.cos(heading), math.sin(heading)
    numbers = [x, y, 0.5, math.log(4), math.log(2), math.log(1.5), sine, cosine, speed * cosine, speed * sine, 0.0]
    return torch.tensor([numbers])


@settings(max_examples=25, deadline=None)
@given(x=NUMBERS, y=NUMBERS, turn=st.floats(-3, 3), seconds=st.floats(-3, 3), heading=st.floats(-3, 3))
def test_boxes_go_there_and_back(x: float, y: float, turn: float, seconds: float, heading: float) -> None:
    here, there = pose(1200, 700, 0.3), pose(1200 + x, 700 + y, 0.3 + turn)
    car = box(y, x, heading, speed=5)
    away = carry_boxes(car, motion(here, there, seconds), seconds)
    back = carry_boxes(away, motion(there, here, -seconds), -seconds)
    torch.testing.assert_close(back, car, rtol=0, atol=2e-4)
    assert float((away[:, 8:10].norm() - 5).abs()) < 1e-4, "speeds do not depend on who looks"
    assert torch.equal(away[:, 3:6], car[:, 3:6])


def test_an_ego_that_drives_on_sees_a_standing_car_come_nearer_and_a_moving_one_stay() -> None:
    on = motion(pose(0, 0, 0), pose(0, 5, 0), 0.5)
    standing = carry_boxes(box(1, 20, math.pi / 2), on, on.seconds)
    moving = carry_boxes(box(1, 20, math.pi / 2, speed=10), on, on.seconds)
    assert standing[0, :2].tolist() == pytest.approx([1, 15])
    assert moving[0, :2].tolist() == pytest.approx([1, 20])
    assert float(heading_of(moving)) == pytest.approx(math.pi / 2)


@settings(max_examples=15, deadline=None)
@given(x=NUMBERS, y=NUMBERS, turn=st.floats(-3, 3))
def test_lines_move_point_by_point(x: float, y: float, turn: float) -> None:
    here, there = pose(1200, 700, 0.3), pose(1200 + x, 700 + y, 0.3 + turn)
    points = torch.tensor([[3.0, 4.0], [-7.0, 20.0]])
    carried = carry_lines(points.flatten()[None], motion(here, there)).view(2, 2).numpy()
    world = np.linalg.inv(there.numpy()) @ here.numpy()
    expected = points.numpy() @ world[:2, :2].T + world[:2, 3]
    np.testing.assert_allclose(carried, expected, atol=1e-4)


@pytest.mark.parametrize(
    ("seconds", "fresh", "interval"),
    [(0.5, True, 0.5), (2.0, True, 2.0), (2.1, False, 0.5), (0.0, True, 0.5), (-1.0, True, -1.0), (-3.0, False, 0.5)],
)
def test_time_decides_what_is_fresh(seconds: float, fresh: bool, interval: float) -> None:
    found = motion(pose(0, 0, 0), pose(0, 0, 0), seconds)
    assert found.fresh is fresh
    assert found.interval_s == pytest.approx(interval, abs=1e-6)


def test_points_of_a_box_lie_in_it_and_turn_with_it() -> None:
    points = BoxPoints(8, 6)
    car = box(10, 20, math.pi / 2)
    found = points(torch.randn(1, 8, generator=torch.Generator().manual_seed(0)), car)[0].detach()
    assert found.shape == (13, 3)
    assert found[0].tolist() == pytest.approx([10, 20, 0.5])
    assert found[1].tolist() == pytest.approx([10, 21.8, 0.5], abs=1e-5), "its front is 0.45 of 4 m ahead"
    assert found[3].tolist() == pytest.approx([9.1, 20, 0.5], abs=1e-5), "its left is at smaller x"
    assert found[5].tolist() == pytest.approx([10, 20, 1.175], abs=1e-5)
    inside = (found - found[0]).abs() <= torch.tensor([1.0, 2.0, 0.75]) + 1e-5
    assert inside.all()
    decoded = decode_boxes(car)[0].tolist()
    assert decoded[3:7] == pytest.approx([4, 2, 1.5, math.pi / 2])


def test_points_of_a_line_come_point_by_point_and_height_by_height() -> None:
    points = LinePoints(4, points=2, samples=3)
    torch.nn.init.zeros_(points.learnable_fc.weight)
    torch.nn.init.zeros_(points.learnable_fc.bias)
    found = points(torch.zeros(1, 4), torch.tensor([[1.0, 2.0, 3.0, 4.0]]))[0].detach()
    assert found.shape == (30, 3)
    assert found[:15, :2].unique(dim=0).tolist() == [[1, 2]]
    heights = [found[index, 2].item() + 1.84023 for index in (0, 3, 6, 9, 12)]
    assert heights == pytest.approx([0, 0.5, -0.5, 1, -1], abs=1e-6)
    assert at_heights(torch.zeros(2, 5, 1, 2)).shape == (2, 5, 1, 3)


def test_sines_of_a_point() -> None:
    x, y, features = 1.25, -3.5, 8
    found = sine_of_points(torch.tensor([x, y]), features).tolist()
    expected = []
    for coordinate in (y, x):
        for place in range(features // 2):
            angle = 2 * math.pi * coordinate / 10000 ** (2 * (place // 2) / (features // 2))
            expected.append(math.sin(angle) if place % 2 == 0 else math.cos(angle))
    assert found == pytest.approx(expected, abs=1e-5)


def test_decoupled_attention_has_no_way_round_its_last_layer() -> None:
    layer = ResidualAttention(8, 2)
    widen, narrow = torch.nn.Linear(4, 8, bias=False), torch.nn.Linear(8, 4, bias=False)
    torch.nn.init.zeros_(narrow.weight)
    query = torch.randn(3, 4), torch.randn(3, 4)
    assert not decoupled_attention(layer, widen, narrow, query, query).any()
    torch.nn.init.zeros_(layer.attn.out_proj.weight)
    torch.nn.init.normal_(narrow.weight)
    expected = narrow(torch.cat(query, -1))
    torch.testing.assert_close(decoupled_attention(layer, widen, narrow, query, None), expected)


def test_both_ways_of_the_feed_forward_block_start_from_what_is_normalised() -> None:
    block = AsymmetricFeedForward(6, 4, 8)
    tokens = torch.randn(2, 6)
    torch.testing.assert_close(block(tokens), block(5 * tokens + 3), rtol=1e-3, atol=1e-3)
