from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.closed_loop.agent_policy import ActivePlan, TrafficSnapshot
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.scene import EgoTrack
from generation.extensions.reactive_adversary.braking import brake_on_path
from generation.extensions.reactive_adversary.ego_prediction import EgoObservations, predict_ego
from generation.extensions.reactive_adversary.settings import EgoPrediction
from tests.generation.extensions.reactive_adversary.loops import road

SCENE = road(seconds=8.0)
NOW = int(SCENE.timestamps_us[36])


def seen(speed: float, turn: float) -> EgoObservations:
    """An ego on a circle, or straight on, since a second."""
    found = EgoObservations.recorded(SCENE, int(SCENE.timestamps_us[24]))
    for step in range(10, -1, -1):
        time = NOW - 100_000 * step
        yaw = -turn * 0.1 * step
        bend = turn / max(speed, 1e-9)
        rear = (
            np.array([np.sin(yaw) / bend, (1 - np.cos(yaw)) / bend])
            if abs(turn) > 1e-9
            else np.array([-speed * 0.1 * step, 0.0])
        )
        box = np.array([*(rear + EGO_CENTER_FROM_REAR_AXLE_M * np.array([np.cos(yaw), np.sin(yaw)])), 4.0, 1.7, yaw])
        nobody = np.zeros((0, 5)), np.zeros(0, np.bool_), np.zeros((0, 2))
        found = found.then(TrafficSnapshot(time, box, speed, *nobody))
    return found


def later(track: EgoTrack, frame: int) -> Floats:
    return np.array(track.pose[frame])


@given(st.floats(0.5, 20.0), st.floats(-0.4, 0.4))
def test_motion_is_kept_up_on_its_circle(speed: float, turn: float) -> None:
    track = predict_ego(SCENE, seen(speed, turn), None, EgoPrediction.MOTION)
    seconds = (SCENE.timestamps_us[60] - NOW) / 1e6
    yaw = np.clip(turn * seconds, -np.pi / 2, np.pi / 2)
    assert later(track, 60)[2] == pytest.approx(yaw, abs=1e-6)
    steps = np.hypot(*np.diff(track.position[37:, :2], axis=0).T)
    np.testing.assert_allclose(steps, speed / 12, rtol=0.01)
    if abs(turn) > 0.01 and abs(turn) * seconds < np.pi / 2:
        radius = speed / turn
        np.testing.assert_allclose(later(track, 60)[:2], [radius * np.sin(yaw), radius * (1 - np.cos(yaw))], atol=1e-6)


def test_what_was_driven_stays_and_nothing_known_stands_still() -> None:
    known = seen(8.0, 0.0)
    tracks = {knows: predict_ego(SCENE, known, None, knows) for knows in (EgoPrediction.MOTION, EgoPrediction.NOTHING)}
    for track in tracks.values():
        np.testing.assert_allclose(track.position[:24], SCENE.ego.position[:24], atol=1e-9)
        np.testing.assert_allclose(later(track, 36)[:2], [0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(later(tracks[EgoPrediction.NOTHING], 90)[:2], [0.0, 0.0], atol=1e-9)
    assert predict_ego(SCENE, known, None, EgoPrediction.RECORDING) is SCENE.ego


def test_a_plan_is_driven_and_goes_on_as_it_ends() -> None:
    waypoints = np.column_stack([4.0 * np.arange(1, 7), np.zeros(6)])
    plan = ActivePlan(NOW, NOW, np.array([0.0, 0.0, np.pi / 2]), waypoints)
    track = predict_ego(SCENE, seen(8.0, 0.0), plan, EgoPrediction.PLAN)
    for frame in (42, 60, 90):
        way = 8.0 * (SCENE.timestamps_us[frame] - NOW) / 1e6
        np.testing.assert_allclose(later(track, frame), [0.0, way, np.pi / 2], atol=1e-6)
    # Without a plan, as reference drivers are, it is expected to keep its motion.
    unplanned = predict_ego(SCENE, seen(8.0, 0.0), None, EgoPrediction.PLAN)
    np.testing.assert_array_equal(
        unplanned.position, predict_ego(SCENE, seen(8.0, 0.0), None, EgoPrediction.MOTION).position
    )


@pytest.mark.parametrize("speed", [2.0, 8.0])
@pytest.mark.parametrize("aside", [0.0, 1.2, 4.0])
def test_who_is_on_its_route_follows_it_and_who_is_not_keeps_its_turn(speed: float, aside: float) -> None:
    """A route that bends: the ego is expected round the bend as far aside as it is, or straight on."""
    frames = np.arange(len(SCENE.timestamps_us))
    yaw = np.clip((frames - 60) * 0.02, 0.0, 1.2)
    ways = 8.0 / 12 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(ways[:-1], axis=0)])
    bent = EgoTrack(np.column_stack([place, np.zeros(len(place))]), quaternion_from_yaw(yaw))
    scene = replace(SCENE, ego=bent)
    known = EgoObservations(SCENE.timestamps_us[35:37], bent.pose[35:37] + np.array([0.0, aside, 0.0]), speed)
    track = predict_ego(scene, known, None, EgoPrediction.MOTION)
    assert known.is_as_recorded(scene) is (aside == 0.0)
    steps = np.hypot(*np.diff(track.position[40:, :2], axis=0).T)
    np.testing.assert_allclose(steps.mean(), speed / 12, rtol=0.15)
    turned = later(track, 95)[2]
    if aside > 1.5:
        assert turned == pytest.approx(0.0, abs=1e-6)
    else:
        way = speed * (SCENE.timestamps_us[95] - SCENE.timestamps_us[36]) / 1e6
        at = round(36 + way / (8.0 / 12))
        assert turned == pytest.approx(yaw[min(at, len(yaw) - 1)], abs=0.15)


@given(st.floats(0.0, 15.0), st.sampled_from([2.5, 5.0, 8.0]), st.integers(0, 12))
def test_braking_on_a_path_stops_on_it(speed: float, braking: float, first: int) -> None:
    seconds = np.arange(61) / 12
    bend = 0.02 * speed * seconds
    poses = np.column_stack([speed * seconds, np.sin(bend), bend])
    found = brake_on_path(poses, first, seconds, braking)
    assert found.shape == poses.shape
    np.testing.assert_allclose(found[:first], poses[:first], atol=1e-9)
    steps = np.hypot(*np.diff(found[:, :2], axis=0).T) * 12
    assert (np.diff(steps[first:]) <= 1e-3 * max(speed, 1.0)).all()
    way = speed**2 / (2 * braking)
    assert np.hypot(*np.diff(found[first:, :2], axis=0).T).sum() <= way * 1.02 + 1e-6
