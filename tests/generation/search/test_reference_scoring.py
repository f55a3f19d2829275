import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from generation.search.hyperparameters import HyperParameters
from generation.search.reference_scoring import (
    CALM_FRAMES,
    ReferenceTerms,
    build_reference_surroundings,
    compute_reference_terms,
    find_reference_collisions,
    is_challenge_on,
)
from generation.search.scoring import ScoringSurroundings, compute_final_scores
from tests.generation.search.slow_reference_scoring import slow_reference
from tests.hand_made import Car, scene_on_straight_road

SIZE = np.array([4.6, 1.9])
HYPER = HyperParameters.reference()


def some_boxes(rng: np.random.Generator, *shape: int) -> Floats:
    place = rng.uniform(-16.0, 16.0, (*shape, 2))
    return np.concatenate([place, rng.uniform(0.5, 8.0, (*shape, 2)), rng.uniform(-7, 7, (*shape, 1))], axis=-1)


def affine_of(raster: DrivableRaster) -> Floats:
    cos, sin = np.cos(raster.pose[2]) / raster.resolution_m, np.sin(raster.pose[2]) / raster.resolution_m
    x, y = raster.pose[:2]
    middle = len(raster.cells) / 2
    return np.array([[sin, -cos, middle - sin * x + cos * y], [cos, sin, middle - cos * x - sin * y]])


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32), objects=st.integers(1, 7), poses=st.sampled_from([1, 13, 15, 30, 81]))
def test_every_term_agrees_with_the_obvious_loops(seed: int, objects: int, poses: int) -> None:
    rng = np.random.default_rng(seed)
    raster = DrivableRaster(rng.random((60, 60)) < 0.7, np.array([*rng.uniform(-5, 5, 2), rng.uniform(-7, 7)]), 0.5)
    present = rng.random((poses, objects)) < 0.7
    present[:, -1] = True
    around = ScoringSurroundings(some_boxes(rng, poses, objects), present, rng.uniform(-9, 9, (poses, 2)), raster)
    center = some_boxes(rng, 9, poses)[..., [0, 1, 4]]
    slow = slow_reference(center, SIZE, around.boxes, present, around.ego_center, raster.cells, affine_of(raster))
    fast, contacts = compute_reference_terms(center, SIZE, around), find_reference_collisions(center, SIZE, around)
    np.testing.assert_array_equal(fast.center_off_road, slow.off)
    np.testing.assert_array_equal(fast.corners_off, slow.corners)
    np.testing.assert_array_equal(contacts.sure, slow.sure)
    np.testing.assert_array_equal(fast.collision, slow.collision)
    np.testing.assert_array_equal(fast.hits_ego, slow.hits_ego)
    assert contacts.tests == slow.tests
    np.testing.assert_allclose(fast.dac, slow.dac, atol=1e-12)
    np.testing.assert_allclose(fast.cr, slow.cr, atol=1e-12)
    np.testing.assert_allclose(fast.challenges([fast])[0], slow.ac, atol=1e-9)
    start = np.full(9, HYPER.init_least)
    np.testing.assert_allclose(compute_final_scores(fast, start, HYPER), slow.final(), atol=1e-9)
    off = compute_reference_terms(center, SIZE, around, challenged=False)
    np.testing.assert_allclose(compute_final_scores(off, start, HYPER), slow.final(challenged=False), atol=1e-9)


def seen_from(car: Car, place: tuple[float, float]) -> tuple[ScoringSurroundings, Floats]:
    """The surroundings of one car, and a candidate that stands at a place relative to the ego's lidar."""
    scene = scene_on_straight_road((car,), seconds=12.0)
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = build_reference_surroundings(scene, 0, tuple(range(81)), raster)
    return around, (around.boxes[:, -1, :2] + place)[None]


def test_the_ego_is_seven_metres_long_around_its_lidar_and_challenged_at_its_rear_axle() -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 8.0),), seconds=12.0)
    around = build_reference_surroundings(
        scene, 0, tuple(range(81)), DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    )
    np.testing.assert_allclose(around.boxes[:, -1, 2:4], np.tile([7.0, 3.5], (81, 1)))
    np.testing.assert_allclose(around.boxes[:, -1, 0] - scene.ego.pose[:81, 0], scene.lidar.translation[0])
    np.testing.assert_allclose(around.ego_center, scene.ego.pose[:81, :2])
    assert scene.ego.boxes[0, 2] < 5.0


def test_whoever_hits_the_ego_gets_the_worst_challenge_though_nearest() -> None:
    around, nearest = seen_from(Car(80.0, 198.25, 8.0), (0.0, 2.8))
    _, farther = seen_from(Car(80.0, 198.25, 8.0), (0.0, 6.0))
    _, farthest = seen_from(Car(80.0, 198.25, 8.0), (0.0, -7.0))
    places = np.concatenate([nearest, farther, farthest])
    center = np.concatenate([places, np.zeros((3, 81, 1))], axis=-1)
    terms = compute_reference_terms(center, SIZE, around)
    np.testing.assert_array_equal(terms.hits_ego, [True, False, False])
    (challenge,) = terms.challenges([terms])
    assert challenge[0] == pytest.approx(1.0) and challenge[2] == pytest.approx(1.0) and 0.0 < challenge[1] < 1.0


def test_a_candidate_that_is_nowhere_is_never_chosen_and_spoils_nothing() -> None:
    around, place = seen_from(Car(80.0, 198.25, 8.0), (0.0, 6.0))
    center = np.concatenate([np.repeat(place, 3, axis=0), np.zeros((3, 81, 1))], axis=-1)
    center[1, 40, 0], center[2, :, 1] = np.nan, center[2, :, 1] + 3.0
    terms = compute_reference_terms(center, SIZE, around)
    scores = compute_final_scores(terms, np.zeros(3), HYPER)
    alone = compute_reference_terms(center[[0, 2]], SIZE, around)
    assert np.isinf(scores[1])
    np.testing.assert_allclose(scores[[0, 2]], compute_final_scores(alone, np.zeros(2), HYPER), rtol=1e-12)


def test_rounds_are_normalised_together() -> None:
    around, place = seen_from(Car(80.0, 198.25, 8.0), (0.0, 6.0))

    def terms_at(*away: float) -> ReferenceTerms:
        center = np.concatenate([np.repeat(place, len(away), axis=0), np.zeros((len(away), 81, 1))], axis=-1)
        center[..., 1] += np.array(away)[:, None]
        return compute_reference_terms(center, SIZE, around)

    near, far = terms_at(0.0, 1.0), terms_at(2.0, 9.0)
    both = near.challenges([near, far])
    assert both[0, 0] == 0.0 and both[1, 1] == pytest.approx(1.0)
    assert both[0, 1] < both[1, 0] < 0.9


def test_the_challenge_is_off_in_half_of_the_planning_frames_near_the_ego_after_three_seconds() -> None:
    near, far = np.full(200, 4.0), np.full(200, 6.0)
    rng = np.random.default_rng(0)
    late = [is_challenge_on(near, 20, 20 + CALM_FRAMES + 12, rng) for _ in range(400)]
    assert 0.42 < np.mean(late) < 0.58
    assert all(is_challenge_on(near, 20, 20 + CALM_FRAMES, rng) for _ in range(40))
    assert all(is_challenge_on(far, 20, 100, rng) for _ in range(40))


def test_the_distance_that_switches_the_challenge_is_smoothed_up_to_the_frame_before() -> None:
    frame, launch = 80, 20
    distance = np.full(200, 4.9)
    smoothed = 0.0
    for value in distance[: frame - launch + 1]:
        smoothed = 0.7 * smoothed + 0.3 * value
    distance[frame - launch] += 0.999 * (5.0 - smoothed) / 0.3
    states = [is_challenge_on(distance, launch, frame, np.random.default_rng(seed)) for seed in range(20)]
    assert False in states
    distance[frame - launch] += 0.002 * (5.0 - smoothed) / 0.3
    assert all(is_challenge_on(distance, launch, frame, np.random.default_rng(seed)) for seed in range(20))
    distance[frame - launch + 1 :] = 0.0
    assert all(is_challenge_on(distance, launch, frame, np.random.default_rng(seed)) for seed in range(20))
