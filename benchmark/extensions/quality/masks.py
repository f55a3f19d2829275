"""Masks of vehicles in one camera's video, each tied to its annotated instance. Three sources, never mixed.

A mask is kept if it overlaps the visible part of a projected 3-D vehicle box (`Definition.min_overlap`), as in the
paper; so false detections, vehicles without annotation and tracks that wandered off are gone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.quality.cut_masks import Mask, overlap
from benchmark.extensions.quality.definition import Definition
from benchmark.extensions.quality.detection import Detector
from benchmark.extensions.quality.projection import ProjectedBox, visible_parts
from benchmark.extensions.quality.segmentation import Box, Segmenter
from benchmark.geometry import Bools

FrameMasks = dict[str, Mask]
"""Masks of one frame by instance."""


@dataclass(frozen=True, slots=True)
class CameraVideo:
    """Frames of a scene from one camera, F images (height, width, 3) RGB of one size.

    Attributes:
        times_us: (F,) exposure times.
        boxes: F tuples of the vehicles' boxes in the image.
    """

    camera: str
    times_us: tuple[int, ...]
    frames: tuple[NDArray[np.uint8], ...]
    boxes: tuple[tuple[ProjectedBox, ...], ...]

    def visible(self, frame: int) -> dict[str, Bools]:
        """Visible part of each box in a frame by instance."""
        height, width = self.frames[frame].shape[:2]
        return visible_parts(self.boxes[frame], height, width)


class MaskMaker(Protocol):
    """A source of masks."""

    def masks(self, video: CameraVideo) -> list[FrameMasks]:
        """Masks of every frame.

        Args:
            video: The video.

        Returns:
            One entry a frame.
        """


@dataclass(frozen=True, slots=True)
class BoxMasks:
    """Visible parts of projected boxes themselves; no network."""

    definition: Definition

    def masks(self, video: CameraVideo) -> list[FrameMasks]:
        """Masks of one video, as `MaskMaker` promises."""
        found = []
        for frame, boxes in enumerate(video.boxes):
            height, width = video.frames[frame].shape[:2]
            whole_px = {box.instance: np.count_nonzero(box.filled(height, width)) for box in boxes}
            seen = {
                name: part
                for name, part in video.visible(frame).items()
                if np.count_nonzero(part) >= self.definition.min_visible * whole_px[name]
            }
            found.append(_large_enough(seen, self.definition.min_mask_px))
        return found


@dataclass(frozen=True, slots=True)
class TrackedMasks:
    """SAM 2 follows each subject from a prompt on, through the frames in which its box is in view.

    Where a mask leaves its box the track ends, and the next prompt begins another one. With a detector, its boxes are
    the prompts (`grounded-sam2`), each tied to the projected box that it overlaps most; without, the projected boxes
    are (`sam2-boxes`).
    """

    definition: Definition
    segmenter: Segmenter
    detector: Detector | None = None

    def masks(self, video: CameraVideo) -> list[FrameMasks]:
        """Masks of one video, as `MaskMaker` promises."""
        visible = [_in_view(video.visible(frame), self.definition.min_mask_px) for frame in range(len(video.frames))]
        prompts = [self._prompts(video, frame, parts) for frame, parts in enumerate(visible)]
        instances = sorted({name for frame in prompts for name in frame})
        found: list[dict[str, Bools]] = [{} for _ in video.frames]
        if instances:
            segments = self.segmenter.open(video.frames)
            for name in instances:
                parts = [frame.get(name) for frame in visible]
                boxes = [frame.get(name) for frame in prompts]
                followed = _followed(parts, boxes, segments.begin, segments.follow, self.definition.min_overlap)
                for frame, mask in followed.items():
                    found[frame][name] = mask
        return [_large_enough(frame, self.definition.min_mask_px) for frame in found]

    def _prompts(self, video: CameraVideo, frame: int, visible: dict[str, Bools]) -> dict[str, Box]:
        projected = {name: rectangle for name, part in visible.items() if (rectangle := _rectangle(part)) is not None}
        if self.detector is None:
            return projected
        if frame % self.definition.detect_every or not projected:
            return {}
        return tied(self.detector.boxes(video.frames[frame]), projected, self.definition.min_overlap)


def tied(detections: Sequence[Box], projected: dict[str, Box], min_overlap: float) -> dict[str, Box]:
    """Give each instance at most one detection, and each detection at most one instance, best overlaps first.

    Pairs below the least intersection over union are none. Equal overlaps go to the surer detection, then to the first
    identifier.
    """
    pairs = sorted(
        (-_box_overlap(box, rectangle), index, name)
        for index, box in enumerate(detections)
        for name, rectangle in projected.items()
    )
    found: dict[str, Box] = {}
    taken: set[int] = set()
    for negative, index, name in pairs:
        if -negative >= min_overlap and index not in taken and name not in found:
            found[name] = detections[index]
            taken.add(index)
    return found


def _followed(
    parts: Sequence[Bools | None],
    prompts: Sequence[Box | None],
    begin: Callable[[int, Box], Bools],
    follow: Callable[[int], Bools],
    min_overlap: float,
) -> dict[int, Bools]:
    """Masks of one subject by frame."""
    found, on_track = {}, False
    for frame, part in enumerate(parts):
        prompt = prompts[frame]
        if part is None:
            on_track = False
            continue
        mask = follow(frame) if on_track else None
        if mask is not None and overlap(mask, part) < min_overlap:
            mask = None
        if mask is None and prompt is not None:
            mask = begin(frame, prompt)
            if overlap(mask, part) < min_overlap:
                mask = None
        on_track = mask is not None
        if mask is not None:
            found[frame] = mask
    return found


def _in_view(parts: dict[str, Bools], min_px: int) -> dict[str, Bools]:
    return {name: part for name, part in parts.items() if np.count_nonzero(part) >= min_px}


def _large_enough(masks: dict[str, Bools], min_px: int) -> FrameMasks:
    cut = {name: Mask.of(whole) for name, whole in masks.items()}
    return {name: mask for name, mask in sorted(cut.items()) if mask is not None and mask.area_px >= min_px}


def _rectangle(part: Bools) -> Box | None:
    mask = Mask.of(part)
    if mask is None:
        return None
    height, width = mask.pixels.shape
    return float(mask.left), float(mask.top), float(mask.left + width), float(mask.top + height)


def _box_overlap(first: Box, second: Box) -> float:
    width = max(min(first[2], second[2]) - max(first[0], second[0]), 0.0)
    height = max(min(first[3], second[3]) - max(first[1], second[1]), 0.0)
    areas = ((box[2] - box[0]) * (box[3] - box[1]) for box in (first, second))
    shared = width * height
    union = sum(areas) - shared
    return shared / union if union > 0 else 0.0
