"""What the image encoder is asked for agrees with the geometry of the frame, mirrored or not, and it can be learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from adapters.extensions.training.dataset_mixture import FrameStore
from adapters.extensions.training.frames import DRIVABLE_HALF_M, TrainingFrame
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
)
from benchmark.geometry import Floats


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
