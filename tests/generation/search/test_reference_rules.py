from dataclasses import replace

import numpy as np
import pytest

from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.search.adversary import SearchOutcome
from generation.search.candidates import ExclusionReason, compute_eligibility, find_exclusion_reason, find_launch_frame
from generation.search.hyperparameters import HyperParameters
from generation.search.planning import find_distance_failure, find_score_failure
from generation.search.reference_scoring import (
    compute_lidar_distance,
    compute_reference_previous,
    compute_reference_state,
    find_reference_launch,
)
from generation.search.verify import DiscardReason
from tests.generation.search.driving_prior import DrivingPrior
from tests.generation.search.one_vehicle import attempt
from tests.hand_made import Car, scene_on_straight_road

REFERENCE, PAPER = HyperParameters.reference(), HyperParameters.paper()
NEAR = Car(62.0, 194.75, 8.0)


def scene_of(*cars: Car, seconds: float = 14.0, ego_speed: float = 8.0) -> Scene:
    return scene_on_straight_road(cars, seconds=seconds, ego_speed=ego_speed)


def absent(scene: Scene, agent: int, *frames: int) -> Scene:
    valid = scene.agents.valid.copy()
    valid[agent, list(frames)] = False
    return replace(scene, agents=replace(scene.agents, valid=valid))


def test_the_reference_tries_cars_alone_parked_ones_among_them() -> None:
    scene = scene_of(
        NEAR,
        Car(62.0, 201.75, 8.0, category="human.pedestrian.adult"),
        Car(38.0, 201.75, 8.0, category="vehicle.truck"),
        Car(75.0, 205.25, 0.0),
        Car(300.0, 194.75, 8.0),
        Car(62.0, 212.0, 8.0),
    )
    assert [find_exclusion_reason(scene, agent, REFERENCE) for agent in range(6)] == [
        None,
        ExclusionReason.NOT_FOUR_WHEELED,
        ExclusionReason.NO_CAR,
        None,
        ExclusionReason.NEVER_NEAR,
        ExclusionReason.OFF_ROAD,
    ]
    assert find_exclusion_reason(scene_of(NEAR, ego_speed=0.0), 0, REFERENCE) is None


def test_the_paper_tries_any_moving_vehicle_that_comes_near() -> None:
    scene = scene_of(
        NEAR, Car(38.0, 201.75, 8.0, category="vehicle.truck"), Car(75.0, 205.25, 0.0), Car(62.0, 212.0, 8.0)
    )
    assert [vehicle.agent for vehicle in compute_eligibility(scene, PAPER, 0).chosen] == [0, 1, 3]


def test_the_paper_launches_at_the_first_frame_in_the_area() -> None:
    assert find_launch_frame(scene_of(NEAR), 0, PAPER) == 0
    assert find_launch_frame(absent(scene_of(NEAR), 0, *range(9)), 0, PAPER) == 9
    coming = scene_of(Car(140.0, 201.75, 8.0, np.pi))
    frame = find_launch_frame(coming, 0, PAPER)
    ahead = coming.agents.position[0, :, 0] - coming.ego.pose[:, 0]
    assert frame is not None and ahead[frame] <= 50.0 < ahead[frame - 1]
    assert find_launch_frame(absent(scene_of(NEAR), 0, *range(160)), 0, PAPER) is None


def test_the_reference_waits_for_frame_20_and_for_25_metres_from_the_lidar() -> None:
    assert find_reference_launch(scene_of(NEAR), 0) == 20
    coming = scene_of(Car(140.0, 201.75, 8.0, np.pi))
    frame = find_reference_launch(coming, 0)
    distance = compute_lidar_distance(coming, 0)
    assert frame is not None and distance[frame] < 25.0 <= distance[frame - 1]
    assert find_reference_launch(scene_of(Car(300.0, 194.75, 8.0)), 0) is None


def test_the_reference_launches_nobody_after_frame_140() -> None:
    """A slower car ahead that is caught up with: three metres more are twelve frames later."""
    found = {}
    for ahead in (55.0, 58.0, 61.0, 64.0):
        scene = scene_of(Car(50.0 + ahead, 194.75, 5.0), seconds=20.0)
        near = int(np.flatnonzero(compute_lidar_distance(scene, 0) < 25.0)[0])
        found[near] = find_reference_launch(scene, 0)
    assert min(found) < 140 < max(found)
    assert found == {near: near if near <= 140 else None for near in found}


def test_a_history_with_a_gap_is_none() -> None:
    assert find_reference_launch(absent(scene_of(NEAR), 0, 18), 0) is None
    assert find_reference_launch(absent(scene_of(NEAR), 0, 1, 2, 3), 0) == 20
    assert find_reference_launch(absent(scene_of(NEAR), 0, 6), 0) is None


def test_speed_has_lost_its_sign_and_everything_else_is_zero() -> None:
    now, before = np.array([10.0, 5.0, 0.3]), np.array([10.9, 5.0, 0.3])
    state = compute_reference_state(before, now, 4.0)
    assert state.speed == pytest.approx(0.45)
    assert (state.acceleration, state.steering) == (0.0, 0.0)
    np.testing.assert_allclose(state.pose, [10.0 - 1.2 * np.cos(0.3), 5.0 - 1.2 * np.sin(0.3), 0.3])


def test_the_model_is_told_of_the_centre_in_the_frame_of_the_centre() -> None:
    told = compute_reference_previous(np.array([3.0, 1.0, np.pi / 2 - 0.1]), np.array([3.0, 4.0, np.pi / 2]))
    np.testing.assert_allclose(told, [-3.0, 0.0, -0.1], atol=1e-12)


def test_a_score_above_seven_drops_a_scene() -> None:
    assert find_score_failure(7.0, 20) is None
    finding = find_score_failure(7.001, 32)
    assert finding is not None and (finding.reason, finding.frame) == (DiscardReason.SCORES_TOO_HIGH, 32)


def test_the_area_is_square_along_the_axes_of_the_map_and_the_last_frame_does_not_count() -> None:
    scene = scene_of(NEAR)
    rear, last = scene.ego.pose[:, :2], len(scene.timestamps_us) - 1
    inside = rear[20:] + [49.9, -49.9]
    assert find_distance_failure(scene, inside, 20) is None
    outside = inside.copy()
    outside[7, 1] -= 0.2
    finding = find_distance_failure(scene, outside, 20)
    assert finding is not None and (finding.reason, finding.frame) == (DiscardReason.LEAVES_AREA, 27)
    only_last = inside.copy()
    only_last[last - 20] += 100.0
    assert find_distance_failure(scene, only_last, 20) is None


def searched(hyper: HyperParameters, *cars: Car, seed: int = 0) -> SearchOutcome:
    return attempt(scene_of(*cars), 0, seed, replace(hyper, candidates=32), DrivingPrior())


def test_the_reference_keeps_what_touches_because_it_does_not_look_again() -> None:
    """The recorded ego runs into a car that stands across its lane: no reason here, one in the other presets."""
    standing = Car(95.0, 198.25, 0.0, np.pi / 2)
    assert searched(PAPER, NEAR, standing).attempt.discard == DiscardReason.ORIGINAL_COLLIDES
    results = [searched(REFERENCE, NEAR, standing, seed=seed) for seed in range(3)]
    assert any(result.kept for result in results)


def test_both_presets_execute_what_they_chose_to_the_end_of_the_scene() -> None:
    for hyper in (PAPER, REFERENCE):
        kept = next(found for found in (searched(hyper, NEAR, seed=seed) for seed in range(20)) if found.kept)
        start = kept.attempt.launch_frame
        assert start is not None and kept.scene is not None
        assert len(kept.poses) == len(kept.scene.timestamps_us) - start
        frames = [plan.frame for plan in kept.attempt.plans]
        assert frames == list(range(start, len(kept.scene.timestamps_us) - 1, hyper.executed_frames))
        assert {plan.round for plan in kept.attempt.plans} == {hyper.rounds}


def test_a_vehicle_that_takes_over_at_its_first_frame_is_told_to_have_had_its_speed() -> None:
    class Listening(DrivingPrior):
        def sample(self, count: int, previous: Floats, rng: np.random.Generator) -> Floats:
            told.append(previous)
            return super().sample(count, previous, rng)

    for scene in (scene_of(NEAR), absent(scene_of(NEAR), 0, *range(30))):
        told: list[Floats] = []
        found = attempt(scene, 0, 0, replace(PAPER, candidates=16), Listening())
        assert found.attempt.launch_frame in (0, 30)
        np.testing.assert_allclose(told[0], [-4.0, 0.0, 0.0], atol=1e-6)
