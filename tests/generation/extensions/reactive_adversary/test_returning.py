"""Motions that end on the adversary's recording, and what an ego may do that nothing announces."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import DriverLimits
from benchmark.geometry import Floats, wrap_angle
from generation.extensions.reactive_adversary.ego_prediction import TURNS_RAD_S, EgoObservations, predict_turns
from generation.extensions.reactive_adversary.returning import OVER_S, build_returns, find_recorded_rest
from generation.extensions.reactive_adversary.rules import AdversaryRules, rasterise_road
from generation.extensions.reactive_adversary.safe_endings import SurroundingTracks
from tests.generation.extensions.reactive_adversary.loops import road
from tests.hand_made import Car

SECONDS = np.arange(121) / FRAME_HZ
EXECUTED = 12


def on_circle(speed: float, rate: float, aside: float = 0.0, ahead_s: float = 0.0) -> Floats:
    """(121, 3) of a car on a circle, or beside it, some time ahead."""
    yaw = rate * (SECONDS + ahead_s)
    places = speed / rate * np.column_stack([np.sin(yaw), 1.0 - np.cos(yaw)])
    return np.column_stack([places + aside * np.column_stack([-np.sin(yaw), np.cos(yaw)]), wrap_angle(yaw)])


@pytest.mark.parametrize(("aside", "ahead_s"), [(0.0, 0.0), (1.2, 0.0), (-0.8, 0.6), (1.0, -0.6)])
def test_a_return_begins_where_the_motion_is_and_ends_on_the_recording(aside: float, ahead_s: float) -> None:
    recorded = on_circle(8.0, 0.2)
    motion = on_circle(8.0, 0.2, aside, ahead_s)[:37]
    columns, can = build_returns(motion[None], EXECUTED, recorded, SECONDS)
    assert can.any()
    for way in np.flatnonzero(can[0]):
        poses = columns[:, 0, way].T
        np.testing.assert_allclose(poses[: EXECUTED + 1], motion[: EXECUTED + 1], atol=1e-9)
        back = EXECUTED + int(OVER_S[way] * FRAME_HZ) + 1
        np.testing.assert_allclose(poses[back:], recorded[back:], atol=1e-9)
        velocity = np.gradient(poses[EXECUTED:, :2], 1.0 / FRAME_HZ, axis=0)[1:-1]
        course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
        assert np.abs(wrap_angle(course - poses[EXECUTED + 1 : -1, 2])).max() < 0.03
        speed, limits = np.hypot(*velocity.T), DriverLimits()
        assert np.abs(np.gradient(speed, 1.0 / FRAME_HZ)).max() < limits.acceleration_m_s2
        assert np.abs(speed * np.gradient(course, 1.0 / FRAME_HZ)).max() < limits.lateral_acceleration_m_s2


def test_nobody_returns_from_too_far_away_or_sideways_to_where_it_stands() -> None:
    moving, standing = on_circle(8.0, 0.2), np.zeros((121, 3))
    _, far = build_returns((on_circle(8.0, 0.2, 40.0)[:37])[None], EXECUTED, moving, SECONDS)
    _, beside = build_returns((np.tile([0.0, 2.0, 0.0], (37, 1)))[None], EXECUTED, standing, SECONDS)
    _, there = build_returns((standing[:37])[None], EXECUTED, standing, SECONDS)
    assert not far.any() and not beside.any() and there.all()


def test_a_recording_that_ends_goes_on_braking_and_one_that_has_ended_is_none() -> None:
    scene = road(Car(90.0, 198.25, 8.0), seconds=9.0)
    agents, last = scene.agents, len(scene.timestamps_us) - 1
    valid = agents.valid.copy()
    valid[0, 60:] = False
    short = replace(scene, agents=replace(agents, valid=valid))
    whole, rest = find_recorded_rest(scene, 0, 24), find_recorded_rest(short, 0, 24)
    assert whole is not None and rest is not None and len(whole) == len(rest) == last - 24 + 1
    np.testing.assert_allclose(rest[:36], whole[:36])
    assert 8.0 < rest[-1, 0] - rest[35, 0] < 14.0 and rest[-1, 0] == pytest.approx(rest[-2, 0], abs=0.02)
    assert find_recorded_rest(short, 0, 60) is None


def test_whoever_cannot_brake_before_followers_returns_and_without_a_recording_does_not() -> None:
    """A car close behind keeps to its recording: who brakes is hit by it, who goes on leaves a road that ends."""
    scene = road(Car(90.0, 198.25, 8.0), Car(82.0, 198.25, 8.0), seconds=9.0)
    around = SurroundingTracks.of(scene, 0, 24, int(scene.timestamps_us[0]))
    recorded = find_recorded_rest(scene, 0, 24)
    assert recorded is not None
    leaving = recorded[:37].copy()
    leaving[:, 2] -= 0.03
    leaving[:, 1] -= 0.03 * (leaving[:, 0] - leaving[0, 0])
    rules = AdversaryRules.of(scene, rasterise_road(scene), [], 0, leaving[0], recorded)
    found = rules.find_return(around, leaving[None], EXECUTED, rules.are_on_road)
    assert found is not None and found[0] == 0 and around.compute_clear_seconds(found[1]) == np.inf
    assert np.abs(found[1][-1, 1] - 198.25) < 1e-6
    assert replace(rules, recorded=None).find_return(around, leaving[None], EXECUTED, rules.are_on_road) is None
    assert rules.find_return(around, leaving[None], EXECUTED, lambda columns: np.zeros(columns.shape[1], bool)) is None


def test_an_ego_may_turn_where_there_is_road_for_it() -> None:
    scene = road()
    ego = EgoObservations(scene.timestamps_us[:25], scene.ego.pose[:25], 8.0)
    raster = rasterise_road(scene)
    assert predict_turns(scene, ego, replace(raster, cells=np.zeros_like(raster.cells))) == []
    (left,) = predict_turns(scene, ego, raster)
    assert left.pose[48, 1] > 200.0
    everywhere = replace(raster, cells=np.ones_like(raster.cells))
    found = predict_turns(scene, ego, everywhere)
    for turned, rate in zip(found, TURNS_RAD_S, strict=True):
        np.testing.assert_allclose(turned.pose[:25], scene.ego.pose[:25])
        assert turned.yaw[36] == pytest.approx(rate, abs=1e-6)
        assert np.hypot(*(turned.pose[36] - turned.pose[24])[:2]) == pytest.approx(8.0, abs=0.1)
