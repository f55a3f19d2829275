"""Masks: boxes, tracks from prompts, detections tied to instances, and the real SAM 2 and Grounding DINO, tiny."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmark.extensions.quality.definition import QualityDefinition
from benchmark.extensions.quality.masks import BoxMasks, CameraVideo, ProjectedBox, TrackedMasks, match_detections
from benchmark.extensions.quality.segmentation import Box, Detector, Segmenter, prepare_frame
from benchmark.geometry import Bools
from benchmark.weights.catalogue import GROUNDING_DINO, SAM2
from tests.benchmark.extensions.quality.small_networks import SAM2_SIDE_PX
from tests.benchmark.extensions.quality.synthetic_videos import texture

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


def test_a_track_that_leaves_its_box_begins_again() -> None:
    follower = Follower(lost=frozenset({2}))
    masks = tracked(follower).masks(video(*[(box("a", 30),)] * 4))
    assert follower.calls[1:] == ["begin 0", "follow 1", "follow 2", "begin 2", "follow 3"] and all(masks)


def test_without_vehicles_in_view_no_video_is_prepared() -> None:
    follower = Follower()
    assert tracked(follower).masks(video((), ())) == [{}, {}] and follower.calls == []


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
