from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nuscenes.eval.detection.utils import category_to_detection_name
from nuscenes.utils.data_classes import Box
from pyquaternion import Quaternion

from benchmark.constants import CATEGORIES, DETECTION_CLASSES
from benchmark.geometry import Floats, transform_matrix
from benchmark.scene import Scene
from generation.extensions.magicdrive.clip import ClipBoxes, build_clip_boxes, compute_corners
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from generation.extensions.magicdrive.sensor_frames import SensorFrames
from generation.render.schematic.view import PlacedCamera
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene
from tests.generation.nuscenes_writer.written_roots import with_adversary

metres = st.floats(-80.0, 80.0)
sizes = st.floats(0.2, 15.0)


def boxes_of(scene: Scene) -> ClipBoxes:
    frames = np.arange(len(scene.timestamps_us))
    return build_clip_boxes(scene, frames, SensorFrames.of(scene, frames))


@given(
    floor=st.tuples(metres, metres, metres), size=st.tuples(sizes, sizes, sizes), yaw=st.floats(-np.pi + 1e-6, np.pi)
)
@settings(max_examples=25, deadline=None)
def test_corners_can_be_turned_back_into_the_box(floor: tuple[float, ...], size: tuple[float, ...], yaw: float) -> None:
    corners = compute_corners(np.array(floor), np.array(size), np.array(yaw))
    ahead, left, up = corners[0] - corners[3], corners[4] - corners[0], corners[1] - corners[0]
    assert corners.mean(axis=0) - 0.5 * up == pytest.approx(np.array(floor), abs=1e-9)
    assert [np.linalg.norm(edge) for edge in (ahead, left, up)] == pytest.approx(list(size), abs=1e-9)
    assert np.cos(np.arctan2(ahead[1], ahead[0]) - yaw) == pytest.approx(1.0)
    assert np.cross(ahead, left) @ up > 0.0


def test_corner_order_is_the_models() -> None:
    corners = compute_corners(np.array([10.0, 20.0, -1.0]), np.array([4.0, 2.0, 1.5]), np.array(0.0))
    right, left, front, rear = 19.0, 21.0, 12.0, 8.0
    assert corners.tolist() == [
        [front, right, -1.0], [front, right, 0.5], [rear, right, 0.5], [rear, right, -1.0],
        [front, left, -1.0], [front, left, 0.5], [rear, left, 0.5], [rear, left, -1.0],
    ]  # fmt: skip


def slow_corners(scene: Scene, agent: int, frame: int) -> tuple[Floats, Floats]:
    """Corners as the devkit's own box has them (front face, then rear face), and the heading that it calls yaw."""
    length, width, height = scene.agents.size[agent]
    box = Box(
        scene.agents.position[agent, frame].tolist(),
        [width, length, height],
        Quaternion(axis=[0, 0, 1], angle=float(scene.agents.yaw[agent, frame])),
    )
    for rotation, translation in (
        (scene.ego.rotation[frame], scene.ego.position[frame]),
        (scene.lidar.rotation, scene.lidar.translation),
    ):
        box.translate(-translation)
        box.rotate(Quaternion(rotation).inverse)
    yaw = box.orientation.yaw_pitch_roll[0]
    upright = Box(box.center.tolist(), box.wlh.tolist(), Quaternion(axis=[0, 0, 1], angle=yaw))
    return np.asarray(upright.corners().T), np.asarray(yaw)


def test_boxes_agree_with_the_devkit_box_by_box() -> None:
    scene = busy_scene()
    boxes = boxes_of(scene)
    assert boxes.ids == tuple(sorted(scene.agents.ids))
    for slot, name in enumerate(boxes.ids):
        agent = scene.agents.ids.index(name)
        for frame in (0, 7, 16):
            slow, _ = slow_corners(scene, agent, frame)
            found = boxes.true_corners[frame, slot]
            gap = np.linalg.norm(found[:, None] - slow[None], axis=-1)
            assert gap.min(axis=1).max() < 1e-4
            assert len(set(gap.argmin(axis=1).tolist())) == 8
            assert set(gap[[0, 1, 4, 5]].argmin(axis=1).tolist()) == {0, 1, 2, 3}
            height = scene.agents.size[agent, 2]
            raised = boxes.corners[frame, slot] - found
            assert raised == pytest.approx(np.broadcast_to([0.0, 0.0, height / 2], (8, 3)), abs=1e-5)


def test_visibility_is_positive_depth_of_any_corner() -> None:
    scene = busy_scene()
    boxes = boxes_of(scene)
    cameras = {camera.name: camera for camera in scene.cameras}
    for frame in (0, 16):
        global_T_lidar = transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame]) @ transform_matrix(
            scene.lidar.rotation, scene.lidar.translation
        )
        for view, name in enumerate(MODEL_CAMERAS):
            placed = PlacedCamera.of(cameras[name], scene.ego.position[frame], scene.ego.rotation[frame])
            for slot, agent in enumerate(scene.agents.ids.index(name) for name in boxes.ids):
                corners, _ = slow_corners(scene, agent, frame)
                depths = [
                    placed.to_camera(global_T_lidar[:3, :3] @ corner + global_T_lidar[:3, 3])[2] for corner in corners
                ]
                assert boxes.masks[view, frame, slot] == int(max(depths) > 0.0)
    assert 0 < boxes.masks.mean() < 1


def test_an_absent_object_is_nothing() -> None:
    scene = busy_scene()
    valid = scene.agents.valid.copy()
    valid[2, 5:9] = False
    boxes = boxes_of(replace(scene, agents=replace(scene.agents, valid=valid)))
    slot = boxes.ids.index(scene.agents.ids[2])
    assert (boxes.classes[5:9, slot] == -1).all() and (boxes.classes[[4, 9], slot] == 0).all()
    assert not boxes.corners[5:9, slot].any() and not boxes.masks[:, 5:9, slot].any()


def test_without_objects_there_is_one_that_is_never_there() -> None:
    scene = busy_scene()
    nobody = np.zeros_like(scene.agents.valid)
    boxes = boxes_of(replace(scene, agents=replace(scene.agents, valid=nobody)))
    assert boxes.ids == () and boxes.corners.shape == (17, 1, 8, 3)
    assert (boxes.classes == -1).all() and not boxes.masks.any() and boxes.masks.shape == (6, 17, 1)


def test_classes_are_those_of_the_detection_task() -> None:
    scene = busy_scene()
    for category in CATEGORIES:
        categories = (category, *scene.agents.categories[1:])
        boxes = boxes_of(replace(scene, agents=replace(scene.agents, categories=categories)))
        name = category_to_detection_name(category)
        assert (scene.agents.ids[0] in boxes.ids) == (name is not None)
        if name is not None:
            assert (boxes.classes[:, boxes.ids.index(scene.agents.ids[0])] == DETECTION_CLASSES.index(name)).all()


def test_an_adversary_is_one_more_box_that_moves_otherwise() -> None:
    scene = busy_scene()
    attacked = with_adversary(scene, 1)
    before, after = boxes_of(scene), boxes_of(attacked)
    assert before.ids == after.ids
    changed = np.abs(before.corners - after.corners).max(axis=(0, 2, 3)) > 0.5
    assert [name for name, differs in zip(before.ids, changed) if differs] == [scene.agents.ids[1]]


@pytest.mark.parametrize(
    ("category", "drawn"), [("vehicle.emergency.ambulance", "truck"), ("vehicle.emergency.police", "car")]
)
def test_an_adversary_is_always_drawn(category: str, drawn: str) -> None:
    scene = busy_scene()
    agents = replace(scene.agents, categories=(category, *scene.agents.categories[1:]))
    scene = replace(scene, agents=agents)
    assert scene.agents.ids[0] not in boxes_of(scene).ids
    boxes = boxes_of(with_adversary(scene, 0))
    assert boxes.classes[0, boxes.ids.index(scene.agents.ids[0])] == DETECTION_CLASSES.index(drawn)
