from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Bools, Floats, box_corners
from benchmark.road_map import DrivableRaster
from generation.hyperparameters import HyperParameters
from generation.scoring import Surroundings, collisions, final_scores, score_terms, surroundings
from tests.hand_made import Car, scene_on_straight_road

GOLDEN = Path(__file__).resolve().parents[3] / "shared" / "golden" / "scoring"
PAPER = HyperParameters(lookahead_frames=0, clearance_m=0.0, headway_s=0.0)
SIZE = np.array([4.6, 1.9])


def everything_drivable() -> DrivableRaster:
    return DrivableRaster(np.ones((200, 200), dtype=np.bool_), np.zeros(3), 0.5)


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="needs the golden scores")
@pytest.mark.parametrize("path", sorted(GOLDEN.glob("*.npz")), ids=lambda path: path.stem)
def test_terms_repeat_the_golden_numbers(path: Path) -> None:
    golden = np.load(path)
    boxes = golden["boxes_x_y_heading_width_length"][1:13][..., [0, 1, 4, 3, 2]]
    affine = golden["raster_affine_global_to_index"]
    origin = np.linalg.solve(affine[:, :2], 100.0 - affine[:, 2])
    raster = DrivableRaster(golden["raster"], np.array([*origin, np.arctan2(affine[1, 1], affine[1, 0])]), 0.5)
    ego = boxes[:, int(golden["ego_index"]), :2]
    around = Surroundings(boxes, golden["valid"][1:13], ego, raster)
    terms = score_terms(golden["candidates"][:, 1:13], golden["adv_width_length"][::-1], around, PAPER)
    np.testing.assert_array_equal(terms.center_off_road, golden["paper_center_violation"])
    np.testing.assert_array_equal(terms.corner_off_road, golden["paper_corner_violation"])
    np.testing.assert_array_equal(terms.collision, golden["paper_collision_geometry"])
    np.testing.assert_allclose(terms.dac, golden["paper_dac"], atol=1e-9)
    np.testing.assert_allclose(terms.cr, golden["paper_cr_geometry"], atol=1e-9)
    np.testing.assert_allclose(terms.challenge, golden["paper_ac_raw"], atol=1e-9)
    scores = final_scores(terms, np.zeros(len(terms.dac)), PAPER)
    np.testing.assert_allclose(scores, golden["paper_final_geometry"], atol=1e-9)


def slow_collisions(boxes: Floats, around: Surroundings) -> Bools:
    hit = np.zeros(boxes.shape[:2], dtype=np.bool_)
    for step in range(boxes.shape[1]):
        others = [
            shapely.Polygon(box_corners(other))
            for other, present in zip(around.boxes[step], around.present[step], strict=True)
            if present
        ]
        for candidate in range(len(boxes)):
            own = shapely.Polygon(box_corners(boxes[candidate, step]))
            hit[candidate, step] = any(own.intersects(other) for other in others)
    return hit


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_collisions_agree_with_polygons(seed: int) -> None:
    rng = np.random.default_rng(seed)

    def boxes(*shape: int) -> Floats:
        place = rng.uniform(-12.0, 12.0, (*shape, 2))
        return np.concatenate([place, rng.uniform(0.3, 9.0, (*shape, 2)), rng.uniform(-7, 7, (*shape, 1))], axis=-1)

    around = Surroundings(boxes(3, 6), rng.random((3, 6)) < 0.7, np.zeros((3, 2)), everything_drivable())
    candidates = boxes(8, 3)
    np.testing.assert_array_equal(collisions(candidates, around), slow_collisions(candidates, around))


def test_corner_to_corner_touching_counts() -> None:
    other = np.array([[[4.0, 2.0, 4.0, 2.0, 0.0]]])
    around = Surroundings(other, np.ones((1, 1), dtype=np.bool_), np.zeros((1, 2)), everything_drivable())
    assert collisions(np.array([[[0.0, 0.0, 4.0, 2.0, 0.0]]]), around)[0, 0]
    assert not collisions(np.array([[[-1e-3, 0.0, 4.0, 2.0, 0.0]]]), around)[0, 0]


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
    around = surroundings(scene, 0, frames, raster)
    assert around.boxes.shape == (12, 1, 5)
    np.testing.assert_allclose(around.boxes[:, -1], scene.ego.boxes[1:13])
    recorded = np.column_stack([scene.agents.position[0, 1:13, :2], scene.agents.yaw[0, 1:13]])
    on_ego = scene.ego.boxes[1:13][:, [0, 1, 4]]
    terms = score_terms(np.stack([recorded, on_ego]), SIZE, around, PAPER)
    assert not terms.collision[0].any()
    assert terms.collision[1].all()
    assert terms.challenge[1] < terms.challenge[0]


def test_leaving_the_road_counts_and_outside_the_raster_is_off_road() -> None:
    scene = scene_on_straight_road()
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = surroundings(scene, 0, tuple(range(1, 13)), raster)
    lanes = np.array([194.75, 193.5, 190.0])
    poses = np.zeros((4, 12, 3))
    poses[..., 0] = 70.0 + 0.7 * np.arange(12)
    poses[:3, :, 1] = lanes[:, None]
    poses[3] = [400.0, 198.25, 0.0]
    terms = score_terms(poses, SIZE, around, PAPER)
    np.testing.assert_array_equal(terms.center_off_road.all(axis=1), [False, False, True, True])
    np.testing.assert_array_equal(terms.corner_off_road.all(axis=1), [False, True, True, True])
    assert terms.dac[0] == 0.0 < terms.dac[1] < terms.dac[2]


def test_clearance_and_headway_only_add_collisions() -> None:
    scene = scene_on_straight_road((Car(70.0, 198.25, 8.0),))
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = surroundings(scene, 0, tuple(range(1, 13)), raster)
    pose = scene.ego.boxes[1:13][:, [0, 1, 4]].copy()
    pose[:, 0] += 0.5 * (4.084 + 4.6) + 0.6
    speed = np.full((1, 12), 8.0)
    near = score_terms(pose[None], SIZE, around, PAPER, speed=speed)
    careful = HyperParameters(lookahead_frames=0, clearance_m=0.0, headway_s=0.15)
    assert not near.collision.any()
    assert score_terms(pose[None], SIZE, around, careful, speed=speed).collision.all()


def test_a_broken_candidate_gets_infinity_and_does_not_touch_the_others() -> None:
    scene = scene_on_straight_road()
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = surroundings(scene, 0, tuple(range(1, 13)), raster)
    poses = np.zeros((3, 12, 3))
    poses[..., 1] = 198.25
    poses[..., 0] = np.array([62.0, 75.0, 90.0])[:, None] + 0.6 * np.arange(12)
    clean = final_scores(score_terms(poses[[0, 2]], SIZE, around, PAPER), np.zeros(2), PAPER)
    poses[1, 3, 2] = np.nan
    scores = final_scores(score_terms(poses, SIZE, around, PAPER), np.zeros(3), PAPER)
    assert np.isinf(scores[1])
    np.testing.assert_array_equal(scores[[0, 2]], clean)


def test_equal_challenge_is_zero() -> None:
    scene = scene_on_straight_road((Car(70.0, 198.25, 8.0),))
    raster = DrivableRaster.around(scene.road_map, scene.ego.pose[0])
    around = surroundings(scene, 0, tuple(range(1, 13)), raster)
    poses = np.repeat(np.array([[[88.0, 198.25, 0.0]]]), 12, axis=1).repeat(4, axis=0)
    np.testing.assert_array_equal(final_scores(score_terms(poses, SIZE, around, PAPER), np.zeros(4), PAPER), 0.0)
