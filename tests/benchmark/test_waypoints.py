"""Frames of plans."""

import numpy as np
import pytest

from benchmark.waypoints import chord_headings, points_in_ego, points_in_lidar, waypoints_in_lidar

AHEAD_M = 0.94
STRAIGHT = np.column_stack([np.arange(1.0, 7.0), np.zeros(6)])
"""Ego frame: straight ahead at 2 m/s."""


def test_points_go_there_and_back() -> None:
    points = np.random.default_rng(0).normal(0.0, 20.0, (3, 5, 2))
    assert points_in_ego(points_in_lidar(points, AHEAD_M), AHEAD_M) == pytest.approx(points)
    assert points_in_lidar(np.array([AHEAD_M, 0.0]), AHEAD_M) == pytest.approx([0.0, 0.0])
    assert points_in_lidar(np.array([AHEAD_M + 5.0, 2.0]), AHEAD_M) == pytest.approx([-2.0, 5.0])


def test_waypoints_of_the_rear_axle_move_ahead_along_the_plan() -> None:
    assert waypoints_in_lidar(STRAIGHT, "ego", AHEAD_M) == pytest.approx(np.column_stack([np.zeros(6), STRAIGHT[:, 0]]))
    left = np.column_stack([np.zeros(6), np.arange(1.0, 7.0)])
    turned = waypoints_in_lidar(left, "ego", AHEAD_M)
    assert turned == pytest.approx(np.column_stack([-left[:, 1] - AHEAD_M, np.full(6, -AHEAD_M)]))


def test_many_plans_at_once_and_those_of_the_lidar_stay() -> None:
    plans = np.stack([STRAIGHT, 2.0 * STRAIGHT])
    assert waypoints_in_lidar(plans, "ego", AHEAD_M)[1] == pytest.approx(waypoints_in_lidar(plans[1], "ego", AHEAD_M))
    assert waypoints_in_lidar(plans, "lidar", AHEAD_M) is plans


def test_headings_do_not_depend_on_where_they_lie_in_memory() -> None:
    chance = np.random.default_rng(0)
    plans = np.cumsum(np.abs(chance.normal(3.0, 1.0, (340, 6, 2))), axis=1)
    first = chord_headings(plans, start_heading_rad=0.0).tobytes()
    held = [np.empty(size) for size in chance.integers(1, 5000, 50).tolist()]
    for size in chance.integers(1, 5000, 200).tolist():
        held[size % 50] = np.empty(size)
        assert chord_headings(plans, start_heading_rad=0.0).tobytes() == first
