import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from generation.search.hyperparameters import CollisionReading, HyperParameters
from generation.search.scoring import (
    ScoringSurroundings,
    build_surroundings,
    compute_final_scores,
    compute_score_terms,
    find_collisions,
)
from tests.generation.search.slow_scoring import slow_collision, slow_final_scores, slow_score_terms
from tests.hand_made import Car, scene_on_straight_road

PAPER = HyperParameters(lookahead_frames=0, clearance_m=0.0, headway_s=0.0)
SIZE = np.array([4.6, 1.9])


def everything_drivable() -> DrivableRaster:
    return DrivableRaster(np.ones((200, 200), dtype=np.bool_), np.zeros(3), 0.5)


def random_boxes(rng: np.random.Generator, *shape: int) -> Floats:
    place = rng.uniform(-12.0, 12.0, (*shape, 2))
    return np.concatenate([place, rng.uniform(0.3, 9.0, (*shape, 2)), rng.uniform(-7, 7, (*shape, 1))], axis=-1)


@pytest.mark.parametrize("reading", CollisionReading)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32), far=st.sampled_from([0.0, 1e3, 1e6]))
def test_collisions_agree_with_polygons(reading: CollisionReading, seed: int, far: float) -> None:
    rng = np.random.default_rng(seed)
    around = ScoringSurroundings(
        random_boxes(rng, 3, 6), rng.random((3, 6)) < 0.7, np.zeros((3, 2)), everything_drivable()
    )
    around.boxes[..., 0] += far
    around.boxes[~around.present] = np.nan
    candidates = random_boxes(rng, 8, 3)
    candidates[..., 0] += far
    expected = [
        [
            slow_collision(list(box), around.boxes[step][around.present[step]], reading)[0]
            for step, box in enumerate(row)
        ]
        for row in candidates
    ]
    np.testing.assert_array_equal(find_collisions(candidates, around, reading), expected)


@pytest.mark.parametrize("reading", CollisionReading)
@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    clearance=st.sampled_from([0.0, 0.25]),
    headway=st.sampled_from([0.0, 0.15]),
    objects=st.integers(0, 9),
)
def test_all_terms_agree_with_the_slow_side(
    reading: CollisionReading, seed: int, clearance: float, headway: float, objects: int
) -> None:
    rng = np.random.default_rng(seed)
    hyper = HyperParameters(lookahead_frames=8, clearance_m=clearance, headway_s=headway, collision_reading=reading)
    steps = len(hyper.scored_frames)
    raster = DrivableRaster(rng.random((40, 40)) < 0.8, np.array([*rng.uniform(-5.0, 5.0, 2), rng.uniform(-7, 7)]), 0.5)
    ego = random_boxes(rng, steps)[:, :2]
    present = rng.random((steps, objects)) < 0.7
    around = ScoringSurroundings(random_boxes(rng, steps, objects), present, ego, raster)
    center, speed = random_boxes(rng, 5, steps)[..., [0, 1, 4]], rng.uniform(0.0, 15.0, (5, steps))
    fast = compute_score_terms(center, SIZE, around, hyper, speed=speed)
    slow = slow_score_terms(center, SIZE, around, hyper, speed)
    for name in ("center_off_road", "corner_off_road", "collision"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(slow, name), err_msg=name)
    for name in ("distance", "dac", "cr", "challenge"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), atol=1e-9, err_msg=name)
    start = rng.uniform(0.0, 1e-3, 5)
    np.testing.assert_allclose(
        compute_final_scores(fast, start, hyper), slow_final_scores(slow, start, hyper), atol=1e-9
    )


@pytest.mark.parametrize(
    "dx, dy, yaw, literal, half, geometry",
    [
        (0.0, 3.5, 0.0, True, False, False),  # side by side in the next lane: nearer than two short edges
        (0.0, 3.9, 0.0, False, False, False),  # a little farther to the side
        (0.0, 1.85, 0.0, True, True, True),  # flanks in each other
        (4.7, 0.5, 0.0, False, False, False),  # bumper to bumper, 10 cm apart
        (4.55, 0.5, 0.0, True, True, True),  # 5 cm into each other
        (4.59, 1.85, 0.0, True, False, True),  # corner contact beyond half the long edges
        (9.3, 0.0, 0.0, False, False, False),  # beyond both long edges
    ],
)
def test_readings_differ_where_they_should(
    dx: float, dy: float, yaw: float, literal: bool, half: bool, geometry: bool
) -> None:
    other = np.array([[[0.0, 0.0, *SIZE, 0.0]]])
    around = ScoringSurroundings(other, np.ones((1, 1), dtype=np.bool_), np.zeros((1, 2)), everything_drivable())
    own = np.array([[[dx, dy, *SIZE, yaw]]])
    assert find_collisions(own, around, CollisionReading.LITERAL)[0, 0] == literal
    assert find_collisions(own, around, CollisionReading.HALF)[0, 0] == half
    assert find_collisions(own, around)[0, 0] == geometry


def test_a_candidate_that_is_nowhere_does_not_hide_the_others() -> None:
    other = np.array([[[4.0, 2.0, 4.0, 2.0, 0.0]]])
    around = ScoringSurroundings(other, np.ones((1, 1), dtype=np.bool_), np.zeros((1, 2)), everything_drivable())
    own = np.repeat(np.array([[[3.0, 2.0, 4.0, 2.0, 0.0]]]), 4, axis=0)
    own[1, 0, 0], own[2, 0, 4], own[3, 0, 1] = np.nan, np.nan, 1e300
    np.testing.assert_array_equal(find_collisions(own, around)[:, 0], [True, False, False, False])


def test_corner_to_corner_touching_counts() -> None:
    other = np.array([[[4.0, 2.0, 4.0, 2.0, 0.0]]])
    around = ScoringSurroundings(other, np.ones((1, 1), dtype=np.bool_), np.zeros((1, 2)), everything_drivable())
    assert find_collisions(np.array([[[0.0, 0.0, 4.0, 2.0, 0.0]]]), around)[0, 0]
    assert not find_collisions(np.array([[[-1e-3, 0.0, 4.0, 2.0, 0.0]]]), around)[0, 0]


def test_step_weights_are_the_papers() -> None:
    weights = PAPER.safety_step_weights()
    assert weights[0] == 1.0
    assert weights[-1] == pytest.approx(0.85)
    np.testing.assert_allclose(np.diff(np.sqrt(weights), 2), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(PAPER.challenge_step_weights()), 0.3 / 11)
    assert HyperParameters().scored_frames[:12] == tuple(range(1, 13))
    assert HyperParameters().scored_frames[-1] == 36


def test_absent_objects_the_own_box_and_the_ego_are_treated_as_they_should() -> None:
    scene = scene_on_straight_road((Car(70.0, 198.25, 8.0), Car(90.0, 198.25, 8.0)))
    scene.agents.valid[1] = False
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    frames = tuple(range(1, 13))
    around = build_surroundings(scene, 0, frames, raster)
    assert around.boxes.shape == (12, 1, 5)
    np.testing.assert_allclose(around.boxes[:, -1], scene.ego.boxes[1:13])
    recorded = np.column_stack([scene.agents.position[0, 1:13, :2], scene.agents.yaw[0, 1:13]])
    on_ego = scene.ego.boxes[1:13][:, [0, 1, 4]]
    terms = compute_score_terms(np.stack([recorded, on_ego]), SIZE, around, PAPER)
    assert not terms.collision[0].any()
    assert terms.collision[1].all()
    assert terms.challenge[1] < terms.challenge[0]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e308, -1e160])
def test_a_broken_candidate_gets_infinity_and_does_not_touch_the_others(bad: float) -> None:
    scene = scene_on_straight_road()
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = build_surroundings(scene, 0, tuple(range(1, 13)), raster)
    poses = np.zeros((3, 12, 3))
    poses[..., 1] = 198.25
    poses[..., 0] = np.array([62.0, 75.0, 90.0])[:, None] + 0.6 * np.arange(12)
    clean = compute_final_scores(compute_score_terms(poses[[0, 2]], SIZE, around, PAPER), np.zeros(2), PAPER)
    poses[1, 3, 1] = bad
    scores = compute_final_scores(compute_score_terms(poses, SIZE, around, PAPER), np.zeros(3), PAPER)
    assert np.isinf(scores[1])
    np.testing.assert_array_equal(scores[[0, 2]], clean)


def test_equal_challenge_is_zero() -> None:
    scene = scene_on_straight_road((Car(70.0, 198.25, 8.0),))
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = build_surroundings(scene, 0, tuple(range(1, 13)), raster)
    poses = np.repeat(np.array([[[88.0, 198.25, 0.0]]]), 12, axis=1).repeat(4, axis=0)
    np.testing.assert_array_equal(
        compute_final_scores(compute_score_terms(poses, SIZE, around, PAPER), np.zeros(4), PAPER), 0.0
    )
