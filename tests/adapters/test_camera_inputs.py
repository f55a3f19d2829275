"""From observations to network inputs: pixels, camera matrices and ego motion, against slow and real ones."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyquaternion import Quaternion

from adapters.camera_inputs import (
    BGR_MEAN,
    RGB_MEAN_STD,
    SPARSE_DRIVE_IMAGE,
    NetworkImageFormat,
    PixelNormalisation,
    camera_images,
    can_bus_vector,
    lidar_pose,
    lidar_to_image,
)
from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.geometry import Floats, transform_matrix
from benchmark.planning import CameraView, Observation
from generation.sources.rig import build_default_cameras
from tests.adapters.real_sample import FRAME, SCENE, boxes_in_lidar, info, real_root
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.benchmark.fake_data import observation
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root
from tests.hand_made import scene_on_straight_road

TINY, BASE, FULL = NetworkImageFormat.scaled(0.4), NetworkImageFormat.scaled(0.8), NetworkImageFormat.scaled(1.0)
real = pytest.mark.skipif(not FRAME.is_dir(), reason="no shared material beside the repository")


def seen(size: tuple[int, int] = (1600, 900), *, seed: int = 0, tilt: bool = True) -> Observation:
    """A sample whose six cameras are exposed at different times on a bumpy road, with noise as images."""
    generator = np.random.default_rng(seed)
    scene = scene_on_straight_road()
    views = {}
    for index, camera in enumerate(build_default_cameras()):
        wobble = generator.normal(0, 0.02 if tilt else 0.0, 4)
        rotation = np.array([1.0, 0, 0, 0]) + wobble
        pixels = generator.integers(0, 256, (size[1], size[0], 3)).astype(np.uint8)
        views[camera.name] = CameraView(
            camera=camera.resized(*size),
            path=Path(f"{camera.name}.jpg"),
            timestamp_us=1000 * index,
            global_T_ego=transform_matrix(rotation, scene.ego.position[0] + generator.normal(0, 0.3, 3)),
            load=lambda pixels=pixels: pixels,  # type: ignore[misc]
        )
    made = observation(scene, 0, views)
    ego = replace(made.ego, rotation=np.array([0.6, 0.01, -0.02, -0.79]), position=np.array([410.0, 1180.0, 0.4]))
    return replace(made, ego=ego)


def pixel_of(point: Floats, sample: Observation, name: str) -> Floats:
    """Pixel of a lidar point in the recorded image, one step at a time with another library's rotations."""
    view, ego = sample.views[name], sample.ego
    in_ego = Quaternion(sample.lidar.rotation).rotate(point) + sample.lidar.translation
    in_global = Quaternion(ego.rotation).normalised.rotate(in_ego) + ego.position
    at_exposure = Quaternion(matrix=view.global_T_ego[:3, :3]).inverse.rotate(in_global - view.global_T_ego[:3, 3])
    in_camera = Quaternion(view.camera.rotation).normalised.inverse.rotate(at_exposure - view.camera.translation)
    homogeneous = view.camera.intrinsic @ in_camera
    return np.array([*(homogeneous[:2] / homogeneous[2]), homogeneous[2]])


@settings(max_examples=40, deadline=None)
@given(
    point=st.tuples(*[st.floats(-40, 40)] * 3),
    size=st.sampled_from([(1600, 900), (448, 256), (800, 448), (640, 640)]),
    image_format=st.sampled_from([TINY, BASE, FULL, SPARSE_DRIVE_IMAGE]),
    seed=st.integers(0, 100),
)
def test_projections_are_the_pinhole_of_each_camera_at_its_exposure(
    point: tuple[float, float, float], size: tuple[int, int], image_format: NetworkImageFormat, seed: int
) -> None:
    sample = seen(size, seed=seed)
    for name, matrix in zip(CAMERA_NAMES, lidar_to_image(sample, image_format)):
        u, v, depth = pixel_of(np.array(point), sample, name)
        if depth < 0.1:
            continue
        found = matrix @ [*point, 1.0]
        assert found[2] == pytest.approx(depth, abs=1e-9) and found[3] == 1.0
        across, down = u / size[0] * image_format.width, v / size[1] * image_format.height - image_format.crop_top
        assert found[:2] / found[2] == pytest.approx([across, down], rel=1e-9, abs=1e-6)


def slow_image(rgb: Any, image_format: NetworkImageFormat, normalisation: PixelNormalisation) -> Floats:
    """The published order: channels, normalisation, resizing, padding."""
    pixels = rgb.astype(np.float64) if normalisation.rgb else rgb[..., ::-1].astype(np.float64)
    pixels = (pixels - normalisation.mean) / normalisation.std
    resized = cv2.resize(pixels, (image_format.width, image_format.height), interpolation=cv2.INTER_LINEAR)
    height, width = image_format.padded
    padded = np.zeros((height, width, 3))
    padded[: image_format.height, : image_format.width] = resized
    return padded.transpose(2, 0, 1)


@pytest.mark.parametrize(
    ("size", "normalisation"), [((1600, 900), BGR_MEAN), ((448, 256), RGB_MEAN_STD), ((1920, 1080), BGR_MEAN)]
)
def test_images_are_those_of_the_published_pipeline(size: tuple[int, int], normalisation: PixelNormalisation) -> None:
    sample = seen(size)
    images = camera_images(sample, TINY, normalisation)
    assert images.shape == (6, 3, 384, 640) and images.dtype == np.float32
    for name, image in zip(CAMERA_NAMES, images):
        assert np.abs(image - slow_image(sample.views[name].load(), TINY, normalisation)).max() < 1e-4
    assert not images[:, :, 360:].any()
    for made, whole, padded in (
        (TINY, (640, 360), (384, 640)),
        (BASE, (1280, 720), (736, 1280)),
        (FULL, (1600, 900), (928, 1600)),
    ):
        assert (made.width, made.height) == whole and made.padded == padded


def test_sparse_images_are_resized_as_bytes_and_cropped_at_the_top() -> None:
    sample = seen()
    images = camera_images(sample, SPARSE_DRIVE_IMAGE, RGB_MEAN_STD)
    assert images.shape == (6, 3, 256, 704)
    values = images[0] * np.array(RGB_MEAN_STD.std)[:, None, None] + np.array(RGB_MEAN_STD.mean)[:, None, None]
    assert np.abs(values - np.rint(values)).max() < 1e-3
    camera = np.zeros((900, 1600, 3), np.uint8)
    camera[319:] = 200
    views = {name: replace(view, load=lambda: camera) for name, view in sample.views.items()}
    cropped = camera_images(replace(sample, views=views), SPARSE_DRIVE_IMAGE, RGB_MEAN_STD)
    assert np.ptp(cropped[0, 0, 4:]) == 0 and cropped[0, 0, 0, 0] > 0


@settings(max_examples=25, deadline=None)
@given(yaw=st.floats(-np.pi, np.pi), sign=st.sampled_from([1.0, -1.0]))
def test_the_can_bus_vector_is_the_published_one(yaw: float, sign: float) -> None:
    ego = observation(scene_on_straight_road(), 0, {}).ego
    assert can_bus_vector(ego)[7:16].tolist() == [0.0] * 9
    rotation = sign * np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    motion = np.array([7.0, 0.1, 0.2, 1.0, 2.0, 9.8, 0.01, 0.02, 0.5])
    turned = replace(ego, can_motion=motion, rotation=rotation, position=np.arange(3.0))
    found = can_bus_vector(turned)
    assert found[:3].tolist() == [0.0, 1.0, 2.0]
    assert found[3:7].tolist() == [rotation[0]] * 4
    assert found[7:16].tolist() == [1.0, 2.0, 9.8, 0.01, 0.02, 0.5, 7.0, 0.1, 0.2]
    assert 0 <= found[16] <= 2 * np.pi and 0 <= found[17] <= 360 and found[16] == pytest.approx(np.radians(found[17]))
    assert np.cos(found[16]) == pytest.approx(np.cos(yaw), abs=1e-9)
    assert np.sin(found[16]) == pytest.approx(np.sin(yaw), abs=1e-9)
    assert can_bus_vector(turned, repeat_w=False)[3:7].tolist() == turned.rotation.tolist()


def test_a_missing_camera_and_an_image_of_another_size_are_one_sentence() -> None:
    sample = seen()
    views = {name: view for name, view in sample.views.items() if name != "CAM_BACK"}
    for read in (lambda s: camera_images(s, TINY, BGR_MEAN), lambda s: lidar_to_image(s, TINY)):
        with pytest.raises(InputError, match="has no image of CAM_BACK; this model needs all of CAM_FRONT"):
            read(replace(sample, views=views))
    view = replace(sample.views["CAM_FRONT"], load=lambda: np.zeros((450, 800, 3), np.uint8))
    with pytest.raises(InputError, match=r"CAM_FRONT\.jpg is 800 x 450 pixels, but in sample_data 1600 x 900"):
        camera_images(replace(sample, views={**sample.views, "CAM_FRONT": view}), TINY, BGR_MEAN)


# --- through the data sets


def test_what_a_data_set_knows_reaches_the_network(tmp_path: Path) -> None:
    scene = short_scene()
    made = TinyRoot.of(tmp_path, [scene], cameras=CAMERA_NAMES)
    pose = made.row("ego_pose", "scene-9901-CAM_BACK-0")
    pose |= {"translation": [1.0, 2.0, 3.0], "rotation": [0.5, 0.5, 0.5, 0.5]}
    root = made.write()
    (root / "can_bus").mkdir()
    message = {"vel": [1, 2, 3], "accel": [4, 5, 6], "rotation_rate": [7, 8, 9], "utime": int(scene.timestamps_us[0])}
    (root / "can_bus" / "scene-9901_pose.json").write_text(json.dumps([message]))
    first, *_, last = NuScenesData.open(root).observations("scene-9901")
    assert np.allclose(first.views["CAM_BACK"].global_T_ego, transform_matrix([0.5] * 4, [1.0, 2.0, 3.0]))
    assert can_bus_vector(first.ego)[7:16].tolist() == [4, 5, 6, 7, 8, 9, 1, 2, 3]
    assert last.ego.can_motion is None and not can_bus_vector(last.ego)[7:16].any()
    assert np.array_equal(first.lidar.translation, scene.lidar.translation)


@pytest.mark.parametrize(("late_us", "counts"), [(20_000, True), (600_000, False)])
def test_the_first_sample_has_the_first_message_even_if_it_comes_a_little_later(
    tmp_path: Path, late_us: int, counts: bool
) -> None:
    scene = short_scene()
    root = TinyRoot.of(tmp_path, [scene], cameras=CAMERA_NAMES).write()
    (root / "can_bus").mkdir()
    start_us = int(scene.timestamps_us[0]) + late_us
    messages = [
        {"vel": [number, 0, 0], "accel": [0, 0, 9.8], "rotation_rate": [0, 0, 0], "utime": start_us + 20_000 * number}
        for number in range(1, 200)
    ]
    (root / "can_bus" / "scene-9901_pose.json").write_text(json.dumps(messages))
    first, _, third, *_ = NuScenesData.open(root).observations("scene-9901")
    assert first.ego.source == "derived", "planners that read speeds get nothing of the future"
    assert can_bus_vector(first.ego)[13] == (1.0 if counts else 0.0)
    assert third.ego.source == "can_bus" and can_bus_vector(third.ego)[13] == third.ego.velocity[0]


def test_small_rendered_images_come_with_matching_matrices(tmp_path: Path) -> None:
    scene = short_scene()
    write_root(tmp_path, [scene])
    sample = list(NuScenesData.open(tmp_path).observations(scene.name))[2]
    assert sample.views["CAM_FRONT"].camera.width < 100
    images, matrices = camera_images(sample, TINY, RGB_MEAN_STD), lidar_to_image(sample, TINY)
    assert images.shape == (6, 3, 384, 640)
    # The scene keeps one lens of 1600 x 900 pixels per camera; the written one is 32 x 18 of the same view.
    for camera, matrix in zip(scene.cameras, matrices):
        view = sample.views[camera.name]
        large = replace(sample, views={**sample.views, camera.name: replace(view, camera=camera)})
        assert np.allclose(matrix, lidar_to_image(large, TINY)[CAMERA_NAMES.index(camera.name)], atol=1e-3)


@real
def test_real_projections_are_those_of_another_project(tmp_path: Path) -> None:
    (sample,) = real_root(tmp_path).observations(SCENE)
    theirs = info()
    boxes = boxes_in_lidar()
    points = np.column_stack([boxes[:, :3], np.ones(len(boxes))])
    for image_format, scale in ((TINY, 0.4), (BASE, 0.8), (SPARSE_DRIVE_IMAGE, 0.44)):
        cut = np.eye(4)
        cut[1, 2] = -image_format.crop_top
        for name, matrix in zip(CAMERA_NAMES, lidar_to_image(sample, image_format)):
            camera = theirs["images"][name]
            intrinsic = np.eye(4)
            intrinsic[:3, :3] = camera["cam2img"]
            expected = cut @ np.diag([scale, scale, 1, 1]) @ intrinsic @ camera["lidar2cam"]
            assert np.allclose(matrix, expected, atol=1e-3)
            projected = matrix @ points.T
            pixels = ((projected[:2] / projected[2]).T[projected[2] > 0] + [0, image_format.crop_top]) / scale
            known = [entry["center_2d"] for entry in theirs["cam_instances"][name]]
            assert known
            for centre in known:
                assert np.linalg.norm(pixels - centre, axis=1).min() < 0.05
    lidar = np.array(theirs["ego2global"]) @ [0.943713, 0.0, 1.84023, 1.0]
    assert np.allclose(lidar_pose(sample) @ [0, 0, 0, 1], lidar, atol=1e-3)


@real
def test_without_the_ego_motion_between_the_stamps_real_boxes_are_missed(tmp_path: Path) -> None:
    (sample,) = real_root(tmp_path).observations(SCENE)
    frozen = transform_matrix(sample.ego.rotation, sample.ego.position)
    views = {name: replace(view, global_T_ego=frozen) for name, view in sample.views.items()}
    near = np.array([-3.0, 8.0, -1.0, 1.0])
    moved, still_standing = (lidar_to_image(s, TINY)[0] @ near for s in (sample, replace(sample, views=views)))
    assert np.linalg.norm(moved[:2] / moved[2] - still_standing[:2] / still_standing[2]) > 5


@real
def test_real_images_keep_their_colours_and_their_order(tmp_path: Path) -> None:
    (sample,) = real_root(tmp_path).observations(SCENE)
    images = camera_images(sample, BASE, BGR_MEAN)
    assert images.shape == (6, 3, 736, 1280)
    for name, image in zip(CAMERA_NAMES, images):
        decoded = cv2.imread(str(next((FRAME / name).glob("*.jpg"))))
        expected = slow_image(decoded[..., ::-1], BASE, BGR_MEAN)
        assert np.abs(image - expected).max() < 1e-3
