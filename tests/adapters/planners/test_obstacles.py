"""Who is taken for a leader: on a straight lane and on a ring, whose end comes round to its beginning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.planners.idm import IntelligentDriver, Obstacles, expected_centres, obstacles_along
from benchmark.dynamics.lane_path import LanePath, build_straight_path
from benchmark.geometry import Floats
from benchmark.planning import SceneInfo
from tests.benchmark.fake_data import observation
from tests.hand_made import Car, scene_on_straight_road

SECONDS = 0.1 * np.arange(30)
EAST = build_straight_path(np.zeros(3), 60.0)


def along(path: LanePath, *movers: tuple[float, float, float, float]) -> Obstacles:
    """Cars of 4.6 m x 1.9 m at x, y, yaw, driving forwards."""
    boxes = np.array([(x, y, 4.6, 1.9, yaw) for x, y, yaw, _ in movers])
    velocity = np.array([(speed * np.cos(yaw), speed * np.sin(yaw)) for _, _, yaw, speed in movers])
    return obstacles_along(path, boxes, velocity, SECONDS, side_margin_m=0.3, foresight_s=1.5)


def centres(path: LanePath, *movers: tuple[float, float, float, float]) -> Floats:
    boxes = np.array([(x, y, 4.6, 1.9, yaw) for x, y, yaw, _ in movers])
    velocity = np.array([(speed * np.cos(yaw), speed * np.sin(yaw)) for _, _, yaw, speed in movers])
    return expected_centres(path, boxes, velocity, SECONDS, foresight_s=1.5)


def last_speed(*cars: Car, ego_speed: float) -> float:
    scene = scene_on_straight_road(cars, ego_speed=ego_speed)
    driver = IntelligentDriver()
    driver.reset(SceneInfo(scene.name, scene.road_map.location, ()))
    driver.reveal(scene)
    waypoints: Floats = driver.plan(observation(scene, 2, {})).waypoints
    return float(waypoints[5, 0] - waypoints[4, 0]) / 0.5


def test_a_leader_moves_along_the_path_with_its_own_ends() -> None:
    found = along(EAST, (20.0, 0.2, 0.0, 5.0))
    assert found.rear[0] == pytest.approx(20.0 - 2.3 + 5.0 * SECONDS, abs=1e-6)
    assert found.front[0] - found.rear[0] == pytest.approx(4.6)
    assert found.speed[0] == pytest.approx(5.0)


def test_who_comes_from_behind_never_leads_however_fast() -> None:
    assert np.isinf(along(EAST, (-6.0, 0.0, 0.0, 15.0)).rear).all()


def test_an_oncoming_car_beside_the_lane_stays_beside_it() -> None:
    assert np.isinf(along(EAST, (40.0, 3.6, np.pi + 0.2, 8.0)).rear).all()
    in_the_way = along(EAST, (40.0, 0.0, np.pi, 8.0))
    assert np.isfinite(in_the_way.rear).all() and in_the_way.speed == pytest.approx(-8.0)


def test_who_crosses_is_in_the_way_when_it_gets_there_and_not_after() -> None:
    inside = np.isfinite(along(EAST, (20.0, -20.0, np.pi / 2, 10.0)).rear[0])
    assert not inside[SECONDS < 1.6].any() and inside[np.abs(SECONDS - 2.0) < 0.15].all()
    assert not inside[SECONDS > 2.5].any()


def test_on_a_ring_the_car_behind_is_not_taken_for_a_leader_at_the_bumper() -> None:
    angle = np.linspace(-np.pi / 2, 1.45 * np.pi, 300)
    ring = LanePath.through(14.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    behind = -np.pi / 2 - 7.0 / 14.0
    found = along(ring, (14.5 * np.cos(behind), 14.5 * np.sin(behind), behind + np.pi / 2, 4.0))
    assert (found.rear > 70.0).all()


def test_close_behind_a_leader_it_lets_the_gap_grow_gently_and_stops_where_it_stands() -> None:
    assert 7.0 - 3.0 * 1.5 < last_speed(Car(50.0 + 7.7, 198.25, 7.0), ego_speed=7.0) < 6.9
    assert last_speed(Car(50.0 + 7.0 + 10.0, 198.25, 0.0), ego_speed=7.0) == pytest.approx(0.0, abs=0.2)


def arc(radius_m: float) -> LanePath:
    angle = np.linspace(0.0, 1.8, 200)
    return LanePath.through(radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle)]))


MOVERS = st.tuples(st.floats(2.0, 30.0), st.floats(-4.0, 4.0), st.floats(-np.pi, np.pi), st.floats(0.0, 12.0))


@settings(max_examples=25, deadline=None)
@given(st.lists(MOVERS, min_size=1, max_size=5), st.sampled_from([20.0, 40.0]))
def test_where_others_are_expected_is_where_they_are_met(
    movers: list[tuple[float, float, float, float]], radius_m: float
) -> None:
    path = arc(radius_m)
    placed = []
    for along_m, left_m, turn, speed in movers:
        on, heading = path.at(np.array(along_m)), float(path.heading_at(np.array(along_m)))
        placed.append((on[0] - left_m * np.sin(heading), on[1] + left_m * np.cos(heading), heading + turn, speed))
    met, expected = along(path, *placed), centres(path, *placed)
    where, beside = path.project(expected)
    inside = np.isfinite(met.rear)
    assert (0.5 * (met.rear + met.front))[inside] == pytest.approx(where[inside], abs=0.15)
    # Corridor: half the ego's width, a margin, and at most half the other's length.
    assert np.abs(beside[inside]).max(initial=0.0) < 0.925 + 0.3 + 2.5 + 0.1
    assert expected[:, 0] == pytest.approx(np.array([(x, y) for x, y, _, _ in placed]), abs=1e-9)


def test_in_a_bend_the_next_lane_keeps_its_car_and_who_crosses_goes_straight_on() -> None:
    path, inner = arc(25.0), 25.0 - 3.5
    (expected,) = centres(path, (inner * np.sin(0.2), 25.0 - inner * np.cos(0.2), 0.2, 8.0))
    assert np.hypot(expected[:, 0], expected[:, 1] - 25.0) == pytest.approx(inner, abs=0.15)
    (expected,) = centres(path, (10.0, -10.0, np.pi / 2, 5.0))
    assert expected == pytest.approx(np.column_stack([np.full(30, 10.0), -10.0 + 5.0 * SECONDS]))
    assert expected_centres(EAST, np.zeros((0, 5)), np.zeros((0, 2)), SECONDS, foresight_s=1.5).shape == (0, 30, 2)


def test_beyond_the_ends_of_the_path_others_go_straight_on() -> None:
    ahead, behind = centres(EAST, (58.0, 1.0, 0.0, 10.0), (-8.0, -1.0, 0.0, 3.0))
    assert ahead == pytest.approx(np.column_stack([58.0 + 10.0 * SECONDS, np.ones(30)]))
    assert behind == pytest.approx(np.column_stack([-8.0 + 3.0 * SECONDS, -np.ones(30)]))
