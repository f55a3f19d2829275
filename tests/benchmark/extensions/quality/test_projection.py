"""Projected boxes: against a slow oracle that asks of every pixel whether its ray meets the box."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.extensions.quality.masks import (
    ProjectedBox,
    compute_scaled_size,
    find_visible_parts,
    project_boxes,
    reduce_picture,
)
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, rotation_matrix, transform_matrix
from benchmark.planning import CameraView
from benchmark.scene import Scene
from tests.benchmark.extensions.quality.synthetic_videos import standing_scene
from tests.hand_made import Car

SIZE = (64, 36)
NEAR_M = 0.5


def view_of(scene: Scene, camera: int = 0) -> CameraView:
    def load() -> None:
        raise AssertionError("no pixels are needed")

    pose = transform_matrix(scene.ego.rotation[0], scene.ego.position[0])
    return CameraView(scene.cameras[camera], None, int(scene.timestamps_us[0]), pose, load)  # type: ignore[arg-type]


def rays_that_meet(scene: Scene, view: CameraView, size: tuple[int, int]) -> Bools:
    """Pixels whose ray meets the first car in front of the near plane, by clipping each ray with the box's slabs."""
    camera, (width, height) = view.camera.resized(*size), size
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    directions = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(camera.intrinsic).T
    directions = directions @ rotation_matrix(camera.rotation).T @ view.global_T_ego[:3, :3].T
    origin = view.global_T_ego[:3, :3] @ camera.translation + view.global_T_ego[:3, 3]
    turn = rotation_matrix(quaternion_from_yaw(scene.agents.yaw[:1, 0]))[0]
    half: Floats = scene.agents.size[0] / 2
    start, along = (origin - scene.agents.position[0, 0]) @ turn, directions @ turn
    with np.errstate(divide="ignore"):
        enter, leave = (-half - start) / along, (half - start) / along
    first = np.minimum(enter, leave).max(axis=-1)
    last = np.maximum(enter, leave).min(axis=-1)
    return np.asarray(np.maximum(first, NEAR_M) <= last)


@settings(max_examples=60, deadline=None)
@given(
    st.floats(-12, 30), st.floats(-12, 12), st.floats(-3.1, 3.1), st.integers(0, 5), st.floats(1, 6), st.floats(0.5, 3)
)
def test_a_projected_box_is_what_rays_meet(
    ahead: float, left: float, yaw: float, camera: int, length: float, width: float
) -> None:
    scene = standing_scene(cars=(Car(50.0 + ahead, 198.25 + left, 0.0, yaw, size=(length, width, 1.6)),))
    # Large enough that the thinnest of these boxes is several pixels wide.
    view, (wide, high) = view_of(scene, camera), (320, 180)
    met = rays_that_meet(scene, view, (wide, high))
    boxes = project_boxes(scene, view, (wide, high), ("vehicle.car",), NEAR_M)
    drawn = boxes[0].fill_mask(high, wide) if boxes else np.zeros((high, wide), bool)
    # Filling paints the outline's pixels too: nothing that is met may be missing but on the border of the outline.
    grown = np.zeros_like(met)
    for down in (-1, 0, 1):
        for across in (-1, 0, 1):
            grown |= np.roll(met, (down, across), axis=(0, 1))
    assert not (met & ~drawn).sum() > 0.02 * met.sum() + 1
    assert not (drawn & ~grown).sum() > 0.05 * drawn.sum() + 2
    for box in boxes:
        bounds = box.bounds
        assert 0 <= bounds[0] <= bounds[2] <= wide and 0 <= bounds[1] <= bounds[3] <= high


def test_a_box_around_the_camera_fills_the_image_and_one_behind_is_not_there() -> None:
    around = standing_scene(cars=(Car(51.0, 198.25, size=(20.0, 10.0, 6.0)),))
    (box,) = project_boxes(around, view_of(around), SIZE, ("vehicle.car",), NEAR_M)
    assert box.fill_mask(SIZE[1], SIZE[0]).all()
    behind = standing_scene(cars=(Car(30.0, 198.25),))
    assert project_boxes(behind, view_of(behind), SIZE, ("vehicle.car",), NEAR_M) == ()


def test_other_categories_and_absent_vehicles_are_no_subjects() -> None:
    scene = standing_scene(cars=(Car(64.0, 198.25), Car(60.0, 196.0, category="human.pedestrian.adult")))
    found = project_boxes(scene, view_of(scene), SIZE, ("vehicle.car",), NEAR_M)
    assert [box.instance for box in found] == [scene.agents.ids[0]]
    gone = replace(scene, agents=replace(scene.agents, valid=np.zeros_like(scene.agents.valid)))
    assert project_boxes(gone, view_of(gone), SIZE, ("vehicle.car",), NEAR_M) == ()


def test_between_frames_a_box_is_between_its_places_and_turns_the_short_way() -> None:
    scene = standing_scene(cars=(Car(64.0, 198.25, 12.0, np.pi - 0.01),))
    scene.agents.yaw[0, 1:] = -np.pi + 0.01
    view = view_of(scene)
    half_way = replace(view, timestamp_us=int(scene.timestamps_us[:2].mean()))
    before, between = (project_boxes(scene, at, SIZE, ("vehicle.car",), NEAR_M)[0] for at in (view, half_way))
    assert abs(between.distance_m - before.distance_m + 0.5) < 0.02


def polygon(name: str, left: float, right: float, distance_m: float) -> ProjectedBox:
    corners = np.array([[left, 2.0], [right, 2.0], [right, 18.0], [left, 18.0]])
    return ProjectedBox(name, "vehicle.car", corners, distance_m)


def test_nearer_boxes_hide_farther_ones_whatever_the_order() -> None:
    boxes = (polygon("far", 2, 20, 30.0), polygon("near", 10, 30, 8.0))
    parts = find_visible_parts(boxes, 20, 40)
    assert not (parts["near"] & parts["far"]).any()
    assert (parts["near"] == boxes[1].fill_mask(20, 40)).all() and parts["far"][10, 5] and not parts["far"][10, 15]
    again = find_visible_parts(boxes[::-1], 20, 40)
    assert all((parts[name] == again[name]).all() for name in parts)


def test_frames_are_brought_down_and_never_enlarged() -> None:
    assert compute_scaled_size(1600, 900, 800) == (800, 450) and compute_scaled_size(448, 256, 800) == (448, 256)
    assert compute_scaled_size(3000, 1, 800) == (800, 1)
    image = np.zeros((90, 160, 3), np.uint8)
    image[:, ::2] = 200
    assert (reduce_picture(image, 80) == 100).all() and reduce_picture(image, 160) is image
