"""Pairs, sight and places against slow and obvious versions, and against what one can work out by hand."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats, box_corners, boxes_overlap
from benchmark.interactions.contacts import (
    KINDS,
    ContactKind,
    ContactPairs,
    compute_delta_v,
    compute_fatal_probability,
    compute_time_to_contact,
    is_at_fault,
    mass_kg,
)
from benchmark.interactions.driver_simulation import find_visible
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.tracks import ContinuousTracks
from tests.benchmark.interactions.made import SECONDS, along, boxes, ego, scene

numbers = st.floats(-20.0, 20.0)
pairs = st.tuples(numbers, numbers)


def polygon(box: Floats) -> shapely.Polygon:
    return shapely.Polygon(box_corners(box))


@settings(max_examples=60, deadline=None)
@given(place=st.tuples(numbers, numbers, numbers), first=pairs, second=pairs)
def test_the_time_to_contact_is_when_small_steps_first_touch(
    place: tuple[float, ...], first: tuple[float, float], second: tuple[float, float]
) -> None:
    one, other = np.array([0.0, 0.0, 4.0, 1.8, 0.3]), np.array([place[0], place[1], 4.6, 1.9, place[2]])
    found = float(compute_time_to_contact(one, np.array(first), other, np.array(second)))
    times = np.arange(0.0, 6.0, 0.01)
    mine, theirs = np.repeat(one[None], len(times), axis=0), np.repeat(other[None], len(times), axis=0)
    mine[:, :2] += times[:, None] * np.array(first)
    theirs[:, :2] += times[:, None] * np.array(second)
    touching = np.flatnonzero(boxes_overlap(mine, theirs))
    if len(touching):
        assert found <= times[touching[0]] + 1e-9 and found > times[touching[0]] - 0.0101
    elif np.isfinite(found) and found < 5.9:
        # They graze one another between two of the steps.
        gap = shapely.distance([polygon(box) for box in mine], [polygon(box) for box in theirs]).min()
        assert gap < 0.01 * np.hypot(*np.subtract(first, second)) + 1e-9


def test_a_head_on_impact_by_hand() -> None:
    """10 m/s against 8 m/s, car against car: the difference is 18, of which the ego takes 1800 / 3400."""
    pair = ContactPairs(
        ego=np.array([[0.0, 0.0, 4.084, 1.73, 0.0]]), ego_speed=np.array([10.0]),
        other=np.array([[4.0, 0.0, 4.6, 1.9, np.pi]]), other_velocity=np.array([[-8.0, 0.0]]),
        is_agent=np.array([True]),
    )  # fmt: skip
    assert pair.impact_speed[0] == pytest.approx(18.0) and pair.gap[0] == 0.0
    own, others = compute_delta_v(pair.impact_speed, np.array([mass_kg("vehicle.car")]))
    assert own[0] == pytest.approx(18.0 * 1800 / 3400) and own[0] + others[0] == pytest.approx(18.0)
    assert compute_fatal_probability(own)[0] == pytest.approx((own[0] / 31.74) ** 4)
    assert compute_fatal_probability(np.array([40.0]))[0] == 1.0
    assert pair.delta_v_nuplan[0] == pytest.approx(9.0)


@pytest.mark.parametrize(
    ("x", "y", "speed", "velocity", "agent", "kind"),
    [
        (4.0, 0.0, 5.0, 3.0, True, ContactKind.FRONT),
        (4.0, 0.0, 5.0, 0.0, True, ContactKind.STOPPED_TRACK),
        (4.0, 0.0, 5.0, 3.0, False, ContactKind.STOPPED_TRACK),
        (4.0, 0.0, 0.02, 3.0, True, ContactKind.STOPPED_EGO),
        (-4.0, 0.0, 5.0, 9.0, True, ContactKind.REAR),
        (-1.0, 1.7, 5.0, 9.0, True, ContactKind.LATERAL),
    ],
)
def test_kinds_of_contact(x: float, y: float, speed: float, velocity: float, agent: bool, kind: ContactKind) -> None:
    own, other = np.array([[0.0, 0.0, 4.084, 1.73, 0.0]]), np.array([[x, y, 4.6, 1.9, 0.0]])
    pair = ContactPairs(own, np.array([speed]), other, np.array([[velocity, 0.0]]), np.array([agent]))
    assert KINDS[pair.kinds[0]] is kind


def test_who_is_to_blame() -> None:
    assert [is_at_fault(kind, False) for kind in ContactKind] == [False, True, True, False, False]
    assert [is_at_fault(kind, True) for kind in ContactKind] == [False, True, True, False, True]


def test_masses() -> None:
    assert mass_kg("human.pedestrian.child") == 75.0 and mass_kg("vehicle.bicycle") == 90.0
    assert mass_kg("movable_object.barrier") == 1600.0


def test_one_sees_past_a_car_but_not_through_it() -> None:
    eye = np.zeros((1, 2))
    everybody = np.array([[20.0, 0.0, 4.6, 1.9, 0.0], [10.0, 0.0, 4.6, 1.9, 0.0], [10.0, 6.0, 4.6, 1.9, 0.0]])
    present, hides = np.ones(3, np.bool_), np.array([True, True, False])
    target = np.array([0])
    assert not find_visible(eye, target, everybody, present, hides)[0]
    assert find_visible(eye, target, everybody, np.array([True, False, True]), hides)[0]
    assert find_visible(eye, target, everybody, present, np.array([True, False, False]))[0]
    half = everybody.copy()
    half[1, 1] = 1.2
    assert find_visible(eye, target, half, present, hides)[0], "a corner is free"
    far = everybody.copy()
    far[0, 0], far[1, 0] = 80.5, 200.0
    assert not find_visible(eye, target, far, present, hides)[0]


def test_velocities_look_at_the_past_only_and_inside_a_run() -> None:
    seconds = np.arange(13) / 12.0
    x = np.where(seconds < 0.5, 0.0, 10.0 * (seconds - 0.5))
    track = boxes(x, 0.0 * x, yaw=0.0)
    valid = np.ones((1, 13), np.bool_)
    tracks = ContinuousTracks(seconds, boxes(0.0 * x, 0.0 * x, yaw=0.0), track[None], valid, ("vehicle.car",))
    assert tracks.velocities_at(np.array([0.5]))[0, 0, 0] == 0.0
    assert tracks.velocities_at(np.array([0.6]))[0, 0, 0] == pytest.approx(5.0)
    assert tracks.velocities_at(np.array([1.0]))[0, 0, 0] == pytest.approx(10.0)
    late = valid.copy()
    late[0, :9] = False
    appeared = ContinuousTracks(seconds, tracks.ego, track[None], late, ("vehicle.car",))
    assert appeared.velocities_at(np.array([9 / 12]))[0, 0, 0] == pytest.approx(10.0), "forward at its first frame"
    only = np.zeros((1, 13), np.bool_)
    only[0, 9] = True
    alone = ContinuousTracks(seconds, tracks.ego, track[None], only, ("vehicle.car",))
    assert alone.velocities_at(np.array([9 / 12]))[0, 0].tolist() == [0.0, 0.0]


def test_an_agent_between_two_frames_is_there_if_it_is_there_at_both() -> None:
    track = along(0.0, 5.0, 6.0)
    valid = np.ones((1, len(SECONDS)), np.bool_)
    valid[0, 10:] = False
    tracks = ContinuousTracks(SECONDS, ego(5.0), track[None], valid, ("vehicle.car",))
    times = np.array([8.5, 9.0, 9.5, 10.0]) / 12
    assert tracks.present_at(times).tolist() == [[True, True, False, False]]


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_feet_on_the_path_are_nearest_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.cumsum(rng.normal(0, 0.05, len(SECONDS)))
    x, y = np.cumsum(0.7 * np.cos(turn)), np.cumsum(0.7 * np.sin(turn))
    path = EgoPath.of(scene(boxes(x, y, (4.084, 1.73))))
    points = np.column_stack([rng.uniform(x.min() - 20, x.max() + 20, 40), rng.uniform(y.min() - 20, y.max() + 20, 40)])
    line = shapely.LineString(path.points)
    station, offset = path.project(points)
    assert np.abs(offset) == pytest.approx(shapely.distance(line, shapely.points(points)), abs=1e-9)
    assert path.position(station) == pytest.approx(
        np.array([line.interpolate(s + 100.0).coords[0] for s in station]), abs=1e-6
    )
    low, high = station - 30.0, station - 5.0
    inside, _ = path.project(points, low, high)
    assert (inside >= np.maximum(low, path.station[0]) - 1e-9).all()
    assert (inside <= np.maximum(high, path.station[0]) + 1e-9).all()


def test_the_left_of_the_path_is_positive() -> None:
    path = EgoPath.of(scene(ego(5.0)))
    station, offset = path.project(np.array([[10.0, 3.0], [10.0, -2.0], [-20.0, 1.0]]))
    assert station == pytest.approx([10.0, 10.0, -20.0]) and offset == pytest.approx([3.0, -2.0, 1.0])
