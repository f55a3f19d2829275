"""Conditions of a recorded nuScenes keyframe against what the official converter made of it."""

import numpy as np
import pytest

from benchmark.constants import DETECTION_CLASSES
from benchmark.errors import InputError
from generation.extensions.magicdrive.clip import build_clip
from generation.extensions.magicdrive.conditions import MODEL_CAMERAS
from tests.generation.extensions.magicdrive.recorded_keyframe import RECORDED, official_info, recorded_scene

pytestmark = pytest.mark.skipif(not RECORDED.is_dir(), reason="needs the recorded keyframe beside the repository")


def test_calibration_is_the_official_one() -> None:
    clip, images = build_clip(recorded_scene(), [0]), official_info()["images"]
    for view, name in enumerate(MODEL_CAMERAS):
        official = np.linalg.inv(np.array(images[name]["lidar2cam"], np.float64))
        np.testing.assert_allclose(clip.cams[view, 0, :, 3:], official[:3], atol=1e-6)
        np.testing.assert_allclose(clip.cams[view, 0, :, :3], np.array(images[name]["cam2img"])[:3, :3], rtol=1e-6)
    np.testing.assert_array_equal(clip.rel_pos, np.eye(4)[None])


def test_boxes_are_the_official_ones() -> None:
    boxes = build_clip(recorded_scene(), [0]).boxes
    rows = official_info()["instances"]
    assert len(boxes.ids) == len(rows) == 69
    names = ("car", "truck", "trailer", "bus", "construction_vehicle", "bicycle", "motorcycle", "pedestrian",
             "traffic_cone", "barrier")  # fmt: skip
    for slot, row in enumerate(rows):
        x, y, z, length, width, _, yaw = row["bbox_3d"]
        corners = boxes.true_corners[0, slot].astype(np.float64)
        assert corners.mean(axis=0) == pytest.approx([x, y, z], abs=1e-4)
        ahead = corners[0] - corners[3]
        assert np.linalg.norm(ahead) == pytest.approx(length, abs=1e-4)
        assert np.linalg.norm(corners[4] - corners[0]) == pytest.approx(width, abs=1e-4)
        assert np.cos(np.arctan2(ahead[1], ahead[0]) - yaw) == pytest.approx(1.0, abs=1e-6)
        assert boxes.corners[0, slot, :, 2].min() == pytest.approx(z, abs=1e-4)
        assert DETECTION_CLASSES[int(boxes.classes[0, slot])] == names[row["bbox_label_3d"]]


def test_what_the_official_converter_sees_in_an_image_the_view_is_told_of() -> None:
    boxes, info = build_clip(recorded_scene(), [0]).boxes, official_info()
    for view, name in enumerate(MODEL_CAMERAS):
        seen = len(info["cam_instances"][name])
        told = int(boxes.masks[view, 0].sum())
        assert seen <= told < 69


def test_the_recorded_car_stands_on_the_recorded_road() -> None:
    clip = build_clip(recorded_scene(), [0])
    assert clip.maps[0, 0, 99:102, 99:106].all()
    assert 0.1 < clip.maps[0, 0].mean() < 0.3
    assert clip.prompt.positive.startswith("A driving scene image at singapore-onenorth. Parked truck, construction")
    with pytest.raises(InputError):
        build_clip(recorded_scene(), [0, 0])
