"""Projected boxes and masks, and what consistency is measured of subjects that are cut out by them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.extensions.quality.definition import QualityDefinition
from benchmark.extensions.quality.masks import (
    BoxMasks,
    CameraVideo,
    CroppedMask,
    ProjectedBox,
    TrackedMasks,
    compute_overlap,
    compute_scaled_size,
    find_visible_parts,
    match_detections,
    project_boxes,
    reduce_picture,
)
from benchmark.extensions.quality.scoring import SubjectFeatureExtractor, compute_similarities, crop_subject
from benchmark.extensions.quality.segmentation import Box, Detector, Segmenter, prepare_frame
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, rotation_matrix, transform_matrix
from benchmark.planning import CameraView
from benchmark.scene import Scene
from benchmark.weights.catalogue import DINO, GROUNDING_DINO, SAM2
from tests.benchmark.extensions.quality.small_networks import SAM2_SIDE_PX
from tests.benchmark.extensions.quality.synthetic_videos import standing_scene, texture
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


@settings(max_examples=25, deadline=None)
@example(-0.46875, 12.0, 0.0, 2, 4.96875, 2.5)
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
    # At the border of the image what is met may lie just beyond it.
    too_much = (drawn & ~grown)[1:-1, 1:-1]
    assert not too_much.sum() > 0.05 * drawn.sum() + 2
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


CPU = torch.device("cpu")
HEIGHT, WIDTH = 60, 100
SMALL = QualityDefinition(masks="boxes", min_mask_px=80)


def box(name: str, left: float, distance_m: float = 10.0, *, width: float = 20.0) -> ProjectedBox:
    right = left + width
    corners = np.array([[left, 20.0], [right, 20.0], [right, 40.0], [left, 40.0]])
    return ProjectedBox(name, "vehicle.car", corners, distance_m)


def video(*frames: Sequence[ProjectedBox]) -> CameraVideo:
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    return CameraVideo("CAM_FRONT", tuple(range(len(frames))), (image,) * len(frames), tuple(map(tuple, frames)))


def rectangle(area: Box) -> Bools:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    left, top, right, bottom = (round(side) for side in area)
    mask[top:bottom, left:right] = True
    return mask


@dataclass
class Follower:
    """Stands for SAM 2: gives the prompted box until the frames in which it has wandered off."""

    lost: frozenset[int] = frozenset()
    calls: list[str] = field(default_factory=list)
    last: Box = (0.0, 0.0, 1.0, 1.0)

    def open(self, frames: Sequence[NDArray[np.uint8]]) -> "Follower":
        self.calls.append(f"open {len(frames)}")
        return self

    def begin(self, frame: int, box: Box) -> Bools:
        self.calls.append(f"begin {frame}")
        self.last = box
        return rectangle(box)

    def follow(self, frame: int) -> Bools:
        self.calls.append(f"follow {frame}")
        return rectangle((0.0, 0.0, 5.0, 5.0) if frame in self.lost else self.last)


def tracked(follower: Follower, definition: QualityDefinition = SMALL, detector: object = None) -> TrackedMasks:
    return TrackedMasks(definition, follower, detector)  # type: ignore[arg-type]


def test_boxes_need_enough_pixels_and_enough_of_them_visible() -> None:
    hidden = box("hidden", 30, 30.0)
    near = box("near", 28, 5.0, width=18)
    tiny = box("tiny", 0, width=1.5)
    (masks,) = BoxMasks(SMALL).masks(video((hidden, near, tiny)))
    assert list(masks) == ["near"]
    (alone,) = BoxMasks(SMALL).masks(video((hidden,)))
    assert list(alone) == ["hidden"] and abs(alone["hidden"].area_px - 400) < 50


def test_a_subject_is_prompted_once_and_followed_while_its_box_is_in_view() -> None:
    follower = Follower()
    masks = tracked(follower).masks(video(*[(box("a", 30),)] * 3, (), *[(box("a", 30),)] * 2))
    assert [sorted(frame) for frame in masks] == [["a"], ["a"], ["a"], [], ["a"], ["a"]]
    assert follower.calls == ["open 6", "begin 0", "follow 1", "follow 2", "begin 4", "follow 5"]
    # Without vehicles in view no video is prepared.
    assert tracked(idle := Follower()).masks(video((), ())) == [{}, {}] and idle.calls == []


def test_a_track_that_leaves_its_box_begins_again() -> None:
    follower = Follower(lost=frozenset({2}))
    masks = tracked(follower).masks(video(*[(box("a", 30),)] * 4))
    assert follower.calls[1:] == ["begin 0", "follow 1", "follow 2", "begin 2", "follow 3"] and all(masks)


@dataclass
class Finder:
    """Stands for Grounding DINO."""

    found: dict[int, list[Box]]
    attend_to_scene: int = 0

    def boxes(self, image: NDArray[np.uint8]) -> list[Box]:
        self.attend_to_scene += 1
        return self.found.get(self.attend_to_scene - 1, [])


def test_detections_without_annotation_are_dropped_and_gaps_of_the_detector_are_followed() -> None:
    seen: Box = (31.0, 21.0, 49.0, 39.0)
    finder = Finder({1: [(70.0, 5.0, 90.0, 15.0), seen]})
    follower = Follower()
    masks = tracked(follower, detector=finder).masks(video(*[(box("a", 30),)] * 4))
    assert [sorted(frame) for frame in masks] == [[], ["a"], ["a"], ["a"]]
    assert finder.attend_to_scene == 4 and follower.calls == ["open 4", "begin 1", "follow 2", "follow 3"]


def test_the_detector_looks_at_each_so_many_th_frame() -> None:
    finder = Finder({})
    sparse = QualityDefinition(masks="grounded-sam2", min_mask_px=80, detect_every=3)
    tracked(Follower(), sparse, finder).masks(video(*[(box("a", 30),)] * 7))
    assert finder.attend_to_scene == 3


def test_instances_and_detections_are_tied_one_to_one_best_first() -> None:
    projected: dict[str, Box] = {"a": (0, 0, 10, 10), "b": (4, 0, 14, 10)}
    both: list[Box] = [(3, 0, 13, 10), (0, 0, 10, 10)]
    assert match_detections(both, projected, 0.25) == {"a": both[1], "b": both[0]}
    assert match_detections([(3, 0, 13, 10)], projected, 0.25) == {"b": (3, 0, 13, 10)}
    assert match_detections([(50, 0, 60, 10)], projected, 0.25) == {}
    assert match_detections([(9, 0, 19, 10)], {"a": (0, 0, 10, 10)}, 0.25) == {}


def test_frames_are_prepared_as_sam_2_wants_them() -> None:
    found = prepare_frame(np.full((30, 50, 3), 255, np.uint8), 16)
    assert found.shape == (3, 16, 16)
    assert found[:, 3, 3].tolist() == pytest.approx([(1 - 0.485) / 0.229, (1 - 0.456) / 0.224, (1 - 0.406) / 0.225])


def test_the_real_sam_2_follows_a_subject_and_subjects_do_not_disturb_each_other(networks: Path) -> None:
    segmenter = Segmenter(networks / SAM2.name, CPU)
    assert segmenter.side_px == SAM2_SIDE_PX
    frames = [np.roll(np.tile(texture("road"), (1, 2, 1))[:60, :100], step, axis=1) for step in range(3)]

    def follow(order: list[Box]) -> dict[Box, list[Bools]]:
        video = segmenter.open(frames)
        return {area: [video.begin(0, area), video.follow(1), video.follow(2)] for area in order}

    one, other = (10.0, 10.0, 40.0, 50.0), (50.0, 5.0, 90.0, 55.0)
    first, second = follow([one, other]), follow([other, one])
    for area in (one, other):
        assert all(mask.shape == (60, 100) for mask in first[area])
        assert all((a == b).all() for a, b in zip(first[area], second[area]))


def test_the_real_grounding_dino_gives_boxes_inside_the_image_surest_first(networks: Path) -> None:
    image = np.tile(texture("road"), (1, 2, 1))[:60, :100]
    every = Detector(networks / GROUNDING_DINO.name, CPU, "car.", 0.0, 0.0).boxes(image)
    assert every and all(0 <= left < right <= 100 and 0 <= top < bottom <= 60 for left, top, right, bottom in every)
    assert every == Detector(networks / GROUNDING_DINO.name, CPU, "car.", 0.0, 0.0).boxes(image)
    assert Detector(networks / GROUNDING_DINO.name, CPU, "car.", 1.0, 0.0).boxes(image) == []


WHOLE = CroppedMask(0, 0, np.ones((96, 96), bool))


def slow_similarities(features: Floats) -> list[float]:
    """The formula, one frame after the other."""
    values = []
    for index in range(1, len(features)):
        to_previous = max(0.0, sum(a * b for a, b in zip(features[index - 1], features[index])))
        to_first = max(0.0, sum(a * b for a, b in zip(features[0], features[index])))
        values.append((to_previous + to_first) / 2)
    return values


@settings(max_examples=25, deadline=None)
@given(arrays(np.float64, st.tuples(st.integers(0, 6), st.just(4)), elements=st.floats(-1, 1)))
def test_the_formula_is_that_of_vbench(features: Floats) -> None:
    lengths = np.linalg.norm(features, axis=1, keepdims=True)
    features = features / np.where(lengths > 1e-6, lengths, 1.0)
    found = compute_similarities(features)
    assert found.tolist() == pytest.approx(slow_similarities(features)) and ((found >= 0) & (found <= 1 + 1e-9)).all()


def test_identical_appearances_are_fully_consistent_and_a_swap_midway_is_not(networks: Path) -> None:
    dino = SubjectFeatureExtractor(networks / DINO.name, CPU, 64, 4)
    first, second = texture("first"), texture("second")
    same = compute_similarities(dino.features([(first, WHOLE)] * 6))
    swapped = compute_similarities(dino.features([(first, WHOLE)] * 3 + [(second, WHOLE)] * 3))
    assert same == pytest.approx(np.ones(5), abs=1e-6)
    assert swapped[:2] == pytest.approx(np.ones(2), abs=1e-6) and swapped.mean() < 1 - 1e-3
    # At the swap both cosines drop, later only the one with the first appearance.
    assert swapped[2] < swapped[3] < 1 - 1e-4


def test_features_do_not_depend_on_the_batch(networks: Path) -> None:
    appearances = [(texture(str(index)), WHOLE) for index in range(5)]
    makers = [SubjectFeatureExtractor(networks / DINO.name, CPU, 64, batch) for batch in (1, 2, 16)]
    found = [maker.features(appearances) for maker in makers]
    assert found[0] == pytest.approx(found[1], abs=1e-6) and found[0] == pytest.approx(found[2], abs=1e-6)
    assert np.linalg.norm(found[0], axis=1) == pytest.approx(np.ones(5))


def test_what_lies_around_a_subject_does_not_count(networks: Path) -> None:
    inside = np.zeros((96, 96), bool)
    inside[20:70, 30:80] = True
    mask = CroppedMask.of(inside)
    assert mask is not None
    first = texture("a")
    second = np.where(inside[..., None], first, texture("b")).astype(np.uint8)
    assert torch.equal(crop_subject(first, mask, 32), crop_subject(second, mask, 32))
    assert not torch.equal(crop_subject(first, WHOLE, 32), crop_subject(second, WHOLE, 32))


def test_a_subject_stands_in_the_middle_of_a_square_with_its_proportions() -> None:
    wide = CroppedMask(0, 0, np.ones((10, 40), bool))
    square = crop_subject(np.full((10, 40, 3), 255, np.uint8), wide, 40)
    assert square.shape == (3, 40, 40)
    assert (square[:, 15:25] > 2).all() and square[:, :14].abs().max() < 1e-5 and square[:, 26:].abs().max() < 1e-5


def test_masks_are_cut_to_their_rectangle() -> None:
    whole = np.zeros((20, 30), bool)
    assert CroppedMask.of(whole) is None
    whole[3, 4] = whole[10, 20] = True
    mask = CroppedMask.of(whole)
    assert mask is not None
    assert (mask.top, mask.left, mask.pixels.shape, mask.area_px) == (3, 4, (8, 17), 2)
    assert mask.cut(np.zeros((20, 30, 3), np.uint8)).shape == (8, 17, 3)
    overlaps = [compute_overlap(*pair) for pair in ((whole, whole), (whole, ~whole), (whole & False, whole & False))]
    assert overlaps == [1, 0, 0]


def test_crops_that_do_not_fit_and_folders_without_weights_are_one_sentence(networks: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="do not divide into the patches of 16"):
        SubjectFeatureExtractor(networks / DINO.name, CPU, 50, 4)
    with pytest.raises(InputError, match="does not hold a ViTModel"):
        SubjectFeatureExtractor(tmp_path, CPU, 64, 4)
    (tmp_path / "config.json").write_bytes((networks / DINO.name / "config.json").read_bytes())
    (tmp_path / "model.safetensors").write_bytes(b"nothing")
    with pytest.raises(InputError, match="does not hold a ViTModel"):
        SubjectFeatureExtractor(tmp_path, CPU, 64, 4)
