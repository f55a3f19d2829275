"""Training frames say what the data set says; what the image encoder is asked for agrees with them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from adapters.camera_inputs import MINIATURE_IMAGE, RGB_MEAN_STD, camera_images, can_bus_vector, lidar_to_image
from adapters.extensions.training.dataset_mixture import INDEX, FrameStore, build_frames
from adapters.extensions.training.frames import DRIVABLE_CELLS, DRIVABLE_HALF_M, FUTURE_STEPS, TrainingFrame
from adapters.extensions.training.image_encoder import (
    CELL_PX,
    FARTHEST_M,
    GROUND_KINDS,
    GROUND_PX,
    ImageEncoder,
    ImageEncoderObjective,
    ImageTargets,
    _mirror,
    image_targets,
    miniature_images,
)
from adapters.extensions.training.scene_frames import drivable_cells
from benchmark.constants import DETECTION_CLASSES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.sample_truth import compute_planar_lidar_poses
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global
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


@pytest.fixture(scope="module")
def frame(store: FrameStore) -> TrainingFrame:
    return store.frame(2)


@pytest.fixture(scope="module")
def targets(frame: TrainingFrame) -> ImageTargets:
    return image_targets(frame)


def seen(frame: TrainingFrame, point: Floats) -> list[tuple[int, float, float, float]]:
    """Camera, column, row and depth of a point of the lidar frame in the images that show it."""
    found = []
    for camera, matrix in enumerate(frame.lidar2img.numpy()):
        u, v, depth = (matrix @ [*point, 1.0])[:3]
        if depth > 1 and 0 <= u / depth < frame.images.shape[-1] and 0 <= v / depth < frame.images.shape[-2]:
            found.append((camera, u / depth, v / depth, depth))
    return found


def test_centres_are_where_boxes_are_and_numbers_give_them_back(frame: TrainingFrame, targets: ImageTargets) -> None:
    counted = 0
    for box, label in zip(frame.boxes.double().numpy(), frame.labels.tolist(), strict=True):
        for camera, u, v, depth in seen(frame, box[:3]):
            row, column = int(v // CELL_PX), int(u // CELL_PX)
            if not 5 < depth < FARTHEST_M:
                continue  # Too far, or it may reach behind the camera.
            if abs(u / CELL_PX - round(u / CELL_PX)) < 1e-3:
                continue  # On the border of two cells.
            assert targets.heat[camera, label, row, column] == 1 and targets.has_box[camera, row, column]
            numbers = targets.boxes[camera, :, row, column]
            if abs(np.exp(numbers[2]) - depth) > 0.01:
                continue  # A nearer box has the cell.
            assert CELL_PX * (column + 0.5 + numbers[0]) == pytest.approx(u, abs=0.01)
            assert CELL_PX * (row + 0.5 + numbers[1]) == pytest.approx(v, abs=0.01)
            np.testing.assert_allclose(np.exp(numbers[3:6]), box[3:6], rtol=1e-4)
            counted += 1
    assert counted >= 2
    assert (targets.heat >= 1).sum() <= sum(len(seen(frame, box[:3])) for box in frame.boxes.double().numpy())


def test_ground_is_what_the_ray_through_a_cell_meets(frame: TrainingFrame, targets: ImageTargets) -> None:
    ground_z_m = -float(frame.global_T_lidar[2, 3])
    asked = np.argwhere(targets.sees_ground[:, 0])
    assert len(asked) > 500
    for camera, row, column in asked[np.random.default_rng(0).permutation(len(asked))[:200]]:
        matrix = frame.lidar2img[camera].numpy()
        # The point (x, y) of the ground with u d, v d, d on the ray: two linear equations.
        u, v = (column + 0.5) * GROUND_PX, (row + 0.5) * GROUND_PX
        lines = np.stack([matrix[0] - u * matrix[2], matrix[1] - v * matrix[2]])
        x, y = np.linalg.solve(lines[:, :2], -(lines[:, 2] * ground_z_m + lines[:, 3]))
        place = (np.array([y, x]) + DRIVABLE_HALF_M) / 0.8
        if np.abs(place - np.rint(place)).min() > 0.01:
            assert targets.ground[camera, 0, row, column] == float(frame.drivable[*np.floor(place).astype(int)])


def test_lines_are_asked_for_and_no_ground_behind_a_box(frame: TrainingFrame, targets: ImageTargets) -> None:
    assert all(targets.ground[:, GROUND_KINDS.index(kind)].sum() > 10 for kind in ("divider", "boundary"))
    assert (targets.ground <= targets.sees_ground).all()
    for box in frame.boxes.double().numpy():
        for camera, u, v, depth in seen(frame, box[:3]):
            if 5 < depth < FARTHEST_M:
                assert not targets.sees_ground[camera, :, int(v // GROUND_PX), int(u // GROUND_PX)].any()


def test_mirroring_twice_changes_nothing_and_once_turns_sides(frame: TrainingFrame, targets: ImageTargets) -> None:
    wanted = {name: torch.from_numpy(getattr(targets, name)) for name in ImageTargets.__dataclass_fields__}
    every, none = torch.ones(6, dtype=torch.bool), torch.zeros(6, dtype=torch.bool)
    images, once = _mirror(frame.images, wanted, every)
    again, twice = _mirror(images, once, every)
    assert torch.equal(again, frame.images) and all(torch.equal(twice[name], wanted[name]) for name in wanted)
    kept, same = _mirror(frame.images, wanted, none)
    assert torch.equal(kept, frame.images) and all(torch.equal(same[name], wanted[name]) for name in wanted)
    width = targets.has_box.shape[-1]
    camera, row, column = np.argwhere(targets.has_box)[0]
    before, after = wanted["boxes"][camera, :, row, column], once["boxes"][camera, :, row, width - 1 - column]
    assert torch.equal(after * torch.tensor([-1.0, 1, 1, 1, 1, 1, -1, 1]), before)


def test_losses_of_one_frame_fall(frame: TrainingFrame) -> None:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        objective = ImageEncoderObjective(ImageEncoder())
        # Images of one colour, as the frame has, say nothing of where things are.
        noise = torch.randint(0, 256, frame.images.shape, dtype=torch.uint8)
        optimiser = torch.optim.AdamW(objective.network.parameters(), 1e-3)
        totals = []
        for _ in range(10):
            total = torch.stack(list(objective.losses([replace(frame, images=noise)]).values())).sum()
            optimiser.zero_grad()
            total.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            totals.append(float(total.detach()))
    assert np.mean(totals[-2:]) < 0.8 * np.mean(totals[:2])
    # Its statistics were learned; as part of a planner they stay.
    statistics = [module for module in objective.network.img_backbone.modules() if isinstance(module, nn.BatchNorm2d)]
    assert all(bool((module.running_mean != 0).any()) for module in statistics if module.running_mean is not None)
