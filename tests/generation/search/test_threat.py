from dataclasses import fields, replace

import numpy as np
import pytest

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_ego_path import RecordedEgoPath, compute_overrun
from generation.search.scoring import build_surroundings
from generation.search.threat import LaneHeadings, build_threat_rating
from generation.search.threat_settings import ThreatSettings
from tests.generation.search.slow_threat import slow_further
from tests.hand_made import Car, scene_on_straight_road

OFFSETS = (*range(1, 13), *range(14, 37, 2))
COUNTED = (6, 12, 18, 24, 30, 36)
WEIGHTS = tuple(each.name for each in fields(ThreatSettings) if each.name.endswith("_weight"))
CARS = (Car(70.0, 198.25, 8.0), Car(60.0, 194.75, 10.0), Car(90.0, 201.75, 9.0, np.pi))


def braking_in_a_bend() -> Scene:
    """The ego slows down from 9 m/s to 3 m/s on an arc to the left."""
    scene = scene_on_straight_road(CARS, seconds=10.0)
    time = np.arange(len(scene.timestamps_us)) / FRAME_HZ
    way = np.cumsum(np.clip(9.0 - 1.5 * (time - 2.0), 3.0, 9.0)) / FRAME_HZ
    yaw = way / 60.0
    position = np.column_stack([50.0 + 60.0 * np.sin(yaw), 198.25 + 60.0 * (1 - np.cos(yaw)), np.zeros(len(time))])
    return replace(scene, ego=replace(scene.ego, position=position, rotation=quaternion_from_yaw(yaw)))


def candidates(scene: Scene, frame: int, count: int, seed: int) -> SimulatedMotion:
    """Tracks that begin anywhere around the ego and drive on with it, across it or towards it."""
    rng = np.random.default_rng(seed)
    pose = scene.ego.pose[frame]
    yaw = pose[2] + rng.choice([0.0, 0.4, 1.5, 3.1], count)[:, None] + 0.002 * np.arange(37)
    speed = np.clip(
        rng.uniform(0.0, 12.0, count)[:, None] + rng.uniform(-2, 2, count)[:, None] * np.arange(37) / 12, 0, 20
    )
    start = pose[:2] + rng.uniform(-30, 40, (count, 1)) * [np.cos(pose[2]), np.sin(pose[2])]
    start = start + rng.uniform(-5, 5, (count, 1)) * [-np.sin(pose[2]), np.cos(pose[2])]
    step = speed[..., None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1) / FRAME_HZ
    center = np.concatenate([start[:, None] + np.cumsum(step, axis=1), yaw[..., None]], axis=-1)
    states = np.concatenate(
        [center, speed[..., None], rng.uniform(-5, 2, (count, 37, 1)), rng.uniform(-0.2, 0.2, (count, 37, 1))], -1
    )
    return SimulatedMotion(center, states, np.zeros((count, 36, 2)), np.ones(count, np.bool_))


def only(weights: dict[str, float]) -> HyperParameters:
    """Settings with these weights of a threat and no others."""
    return HyperParameters().changed([f"{name}={weights.get(name, 0.0)}" for name in WEIGHTS])


def further(scene: Scene, hyper: HyperParameters, motion: SimulatedMotion, frame: int = 24) -> Floats:
    raster = DrivableRaster(np.ones((200, 200), dtype=np.bool_), np.zeros(3), 0.5)
    around = build_surroundings(scene, 0, tuple(frame + offset for offset in OFFSETS), raster, raster_ego=False)
    return build_threat_rating(scene, 0, frame, OFFSETS, around, hyper)(motion)


@pytest.mark.parametrize("name", WEIGHTS)
@pytest.mark.parametrize("bend", [False, True])
def test_each_term_agrees_with_its_slow_form(name: str, bend: bool) -> None:
    scene = braking_in_a_bend() if bend else scene_on_straight_road(CARS, seconds=10.0)
    hyper = only({name: 2.5})
    motion = candidates(scene, 24, 60, 3)
    fast = further(scene, hyper, motion)
    frames = [24 + offset for offset in COUNTED]
    slow = [
        slow_further(scene, 0, frames, motion.center[row, list(COUNTED)], motion.states[row, list(COUNTED)], hyper)
        for row in range(60)
    ]
    np.testing.assert_allclose(fast, slow, atol=1e-9)
    assert np.ptp(fast) > 0.0


def test_terms_add_up_with_their_weights() -> None:
    scene, motion = braking_in_a_bend(), candidates(braking_in_a_bend(), 24, 20, 5)
    each = [
        further(scene, HyperParameters().changed([f"{name}={2 * (name == one)}" for name in WEIGHTS]), motion)
        for one in WEIGHTS
    ]
    together = further(scene, HyperParameters().changed([f"{name}=2" for name in WEIGHTS]), motion)
    np.testing.assert_allclose(together, np.sum(each, axis=0), atol=1e-9)


def test_what_is_not_finite_disturbs_nobody() -> None:
    scene, motion = braking_in_a_bend(), candidates(braking_in_a_bend(), 24, 8, 5)
    hyper = only(dict.fromkeys(WEIGHTS, 1.0))
    expected = further(scene, hyper, motion)
    broken = replace(motion, finite=np.arange(8) != 3, center=motion.center.copy())
    broken.center[3] = np.nan
    found = further(scene, hyper, broken)
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(np.delete(found, 3), np.delete(expected, 3))


def test_the_way_of_the_ego_measures_along_and_across() -> None:
    scene = braking_in_a_bend()
    way = RecordedEgoPath.of(scene)
    for frame in (0, 30, 80, 119):
        x, y, yaw = scene.ego.boxes[frame, [0, 1, 4]]
        pose = np.array([x - 2.0 * np.sin(yaw), y + 2.0 * np.cos(yaw), yaw + 0.3])
        station, offset, turn = way.places(pose, frame, frame)
        assert abs(station - way.station[frame]) < 0.1
        assert abs(offset - 2.0) < 0.02
        assert abs(turn - 0.3) < 0.05


def test_an_ego_that_brakes_is_overrun_by_one_that_does_not() -> None:
    time = np.arange(72) / FRAME_HZ
    speed = np.where(time < 2.0, 10.0, np.maximum(10.0 - 4.0 * (time - 2.0), 0.0))
    station = np.cumsum(speed) / FRAME_HZ
    over = compute_overrun(station, speed)
    assert np.abs(over[:24]).max() < 1e-9
    # After 1.5 s of braking at 4 m/s^2 it is 4.5 m behind; who set off at full speed 3 s ago is no further.
    assert abs(over[24 + 18] - 4.5) < 0.5
    assert (np.diff(over[24:60]) >= -1e-9).all()


def test_lanes_say_what_is_against_traffic() -> None:
    lanes = LaneHeadings.of(scene_on_straight_road())
    poses = np.array(
        [[80.0, 198.25, 0.0], [80.0, 198.25, np.pi], [80.0, 201.75, np.pi], [80.0, 201.75, 0.1], [80.0, 230.0, 0.0]]
    )
    assert lanes.against(poses).tolist() == [False, True, False, True, False]
