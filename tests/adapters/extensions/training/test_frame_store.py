"""Training frames say what the data set says, and a broken store is never taken for a whole one."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from adapters.camera_inputs import MINIATURE_IMAGE, RGB_MEAN_STD, camera_images, can_bus_vector, lidar_to_image
from adapters.extensions.training.dataset_mixture import INDEX, FrameStore, build_frames
from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, FUTURE_STEPS, TrainingFrame
from adapters.extensions.training.image_encoder import miniature_images
from adapters.extensions.training.scene_frames import drivable_cells
from benchmark.constants import DETECTION_CLASSES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.errors import InputError
from benchmark.geometry import to_global
from benchmark.records.off_path import OFF_PATH, Excursion, read_excursions
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

SCENES = ("scene-9901", "scene-9902")


def frames_of(store: FrameStore, scene: str) -> list[TrainingFrame]:
    return [store.frame(number) for number in store.frames_of(scene)]


def test_frames_are_what_a_planner_sees_and_what_happened(data: NuScenesData, store: FrameStore) -> None:
    assert store.scenes == SCENES and len(store) == 2 * len(store.frames_of(SCENES[0]))
    for name in SCENES:
        truths, observations = data.truth(name), list(data.observations(name))
        frames = frames_of(store, name)
        assert [frame.index for frame in frames] == list(range(len(truths)))
        for frame, truth, seen in zip(frames, truths, observations, strict=True):
            assert (frame.scene, frame.command) == (name, int(truth.command))
            assert frame.timestamp_s == pytest.approx(truth.timestamp_us * 1e-6)
            np.testing.assert_allclose(frame.can_bus, can_bus_vector(seen.ego))
            np.testing.assert_allclose(frame.lidar2img, lidar_to_image(seen, MINIATURE_IMAGE))
            np.testing.assert_allclose(frame.ego_future, truth.ego_future[:, :2], atol=1e-5)
            assert frame.ego_future_valid.tolist() == truth.ego_future_valid.tolist()
            wanted = camera_images(seen, MINIATURE_IMAGE, RGB_MEAN_STD)
            # Bytes hold half a grey level of 255.
            assert np.abs(miniature_images(frame.images).numpy() - wanted).max() < 0.51 / 57


def test_boxes_and_futures_are_those_of_the_truth(data: NuScenesData, store: FrameStore) -> None:
    for name in SCENES:
        scene = data.scene(name)
        for frame, truth in zip(frames_of(store, name), data.truth(name), strict=True):
            rows = [truth.instances.index(scene.agents.ids[row]) for row in frame.instances.tolist()]
            assert len(rows) == len(frame.boxes) == len(set(rows))
            present = truth.boxes[rows, 0]
            found = frame.boxes.numpy()
            np.testing.assert_allclose(found[:, [0, 1, 3, 4]], present[:, :4], atol=2e-3)
            np.testing.assert_allclose(np.exp(1j * found[:, 6]), np.exp(1j * present[:, 4]), atol=2e-3)
            later = frame.futures.numpy()[:, :6]
            valid = frame.futures_valid.numpy()[:, :6]
            assert (valid == truth.annotated[rows, 1:]).all()
            np.testing.assert_allclose(later[..., :2][valid], truth.boxes[rows, 1:, :2][valid], atol=2e-3)
            assert {DETECTION_CLASSES[label] for label in frame.labels.tolist()} <= set(DETECTION_CLASSES)
            assert frame.futures.shape == (len(rows), FUTURE_STEPS, 3)


def test_velocities_lead_to_where_things_are_next_and_lines_lie_around_the_lidar(store: FrameStore) -> None:
    counted = 0
    for frame in frames_of(store, SCENES[0])[1:]:
        steady = frame.futures_valid[:, 0]
        ahead = frame.boxes[steady, :2] + 0.5 * frame.boxes[steady, 7:]
        assert bool(((ahead - frame.futures[steady, 0, :2]).norm(dim=-1) < 1.0).all())
        counted += int(steady.sum())
        assert len(frame.lines) == len(frame.line_labels) > 0 and set(frame.line_labels.tolist()) <= {0, 1, 2}
        assert bool((frame.lines.abs() <= torch.tensor([15.001, 30.001])).all())
    assert counted


def test_cells_are_drivable_where_the_map_is(data: NuScenesData, store: FrameStore) -> None:
    scene = data.scene(SCENES[0])
    pose = compute_planar_lidar_poses(scene)[2]
    cells = drivable_cells(scene.road_map, pose)
    assert (cells == store.frame(2).drivable.numpy()).all()
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, DRIVABLE_CELLS, (200, 2)):
        right, forward = (np.array([column, row]) + 0.5) * 0.8 - DRIVABLE_HALF_M
        point = to_global(np.array([[forward, -right]]), pose)[0]
        assert cells[row, column] == bool(scene.road_map.is_drivable(point))
    assert cells.any() and not cells.all()


def test_building_again_changes_nothing_and_goes_on_where_it_stopped(data: NuScenesData, tmp_path: Path) -> None:
    store = build_frames(data.root, "val", tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    (tmp_path / INDEX).unlink()
    damaged = tmp_path / f"{SCENES[1]}.safetensors"
    damaged.write_bytes(damaged.read_bytes()[:1000])
    with pytest.raises(InputError, match="cannot read the training frames"):
        store.frame(store.frames_of(SCENES[1])[0])
    with pytest.raises(InputError, match="no complete training frames"):
        FrameStore.open(tmp_path)
    build_frames(data.root, "val", tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
    for text, sentence in (("{}", "not a list of training frames"), ("{", "not valid JSON")):
        (tmp_path / INDEX).write_text(text)
        with pytest.raises(InputError, match=sentence):
            FrameStore.open(tmp_path)
    with pytest.raises(InputError, match="split"):
        build_frames(data.root, "nonsense", tmp_path / "nonsense")


def test_matrices_stay_on_the_processor_when_a_frame_moves(store: FrameStore) -> None:
    frame = store.frame(0)
    assert frame.on(torch.device("cpu")) is frame
    moved = frame.on(torch.device("meta"))
    assert {moved.images.device.type, moved.boxes.device.type, moved.ego_future_valid.device.type} == {"meta"}
    assert {moved.lidar2img.device.type, moved.can_bus.device.type} == {"cpu"} and moved.scene == frame.scene


def test_nothing_is_learned_from_an_ego_that_departs_from_its_path(tmp_path: Path) -> None:
    data = write_off_path(tmp_path / "root")
    excursions = read_excursions(data.provenance(), data.scene_names("val")[0])
    store = build_frames(data.root, "val", tmp_path / "frames")
    frames = [store.frame(number) for number in range(len(store))]
    (away,) = excursions
    for frame in frames:
        now = 0.5 * frame.index
        learned = frame.ego_future_valid.numpy()
        later = now + 0.5 * np.arange(1, 7)
        assert not learned[(later > away.begin_s) & (now < away.worst_s)].any()
        if now >= away.worst_s and frame.index < len(frames) - 1:
            assert learned[0], now
    assert any(frame.ego_future_valid.any() for frame in frames)


def write_off_path(folder: Path) -> NuScenesData:
    """A short scene whose report says that its ego was off its path from 1.1 to 3.2 s, furthest off at 2.0 s."""
    write_root(folder, [short_scene("scene-9903", seconds=4.0)])
    (place,) = folder.glob("*/challenger.json")
    made = json.loads(place.read_text())
    away = Excursion("lateral", 1.1, 2.0, 3.2, 0.8, 0.0, 0.0, 0.0)
    made["scenes"]["scene-9903"]["report"] = {OFF_PATH: [away.as_json()]}
    place.write_text(json.dumps(made))
    return NuScenesData.open(folder)
