"""Masks of vehicles in one camera's video, each tied to its annotated instance, from three sources that never mix.

A mask is kept if it overlaps the visible part of a projected 3-D vehicle box (`QualityDefinition.min_overlap`), as in
the paper; so false detections, vehicles without annotation and tracks that wandered off are gone. Masks are cut to
their rectangle, so that a scene's fit into memory.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from shapely.errors import GEOSException
from shapely.geometry import MultiPoint, Polygon
from shapely.geometry import box as rectangle

from benchmark.box_projection import BOX_EDGES, compute_box_corners, interpolate_agents, intersect_near_plane, to_camera
from benchmark.extensions.quality.definition import QualityDefinition
from benchmark.extensions.quality.segmentation import Box, Detector, Segmenter
from benchmark.geometry import Bools, Floats
from benchmark.planning import CameraView
from benchmark.scene import Camera, Scene

_SUBPIXEL_BITS: Final = 6


@dataclass(frozen=True, slots=True)
class ProjectedBox:
    """One vehicle in one image: (P, 2) convex outline inside it, pixels, and distance of camera and box centre."""

    instance: str
    category: str
    polygon: Floats
    distance_m: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom, pixels."""
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def fill_mask(self, height: int, width: int) -> Bools:
        """(height, width) which pixels lie inside."""
        canvas = np.zeros((height, width), np.uint8)
        # The centre of a pixel is at its index plus one half.
        points = np.rint((self.polygon - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
        cv2.fillConvexPoly(canvas, points, (1.0,), lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
        return canvas.astype(bool)


def project_boxes(
    scene: Scene, view: CameraView, size: tuple[int, int], categories: Sequence[str], near_m: float
) -> tuple[ProjectedBox, ...]:
    """Vehicles that are there when an image of ``size`` (width, height) is taken, in the order of the scene's agents.

    Positions are interpolated between frames; boxes are cut off at ``near_m`` in front of the camera, and left out
    without a point in the image.
    """
    camera = view.camera.resized(*size)
    poses = interpolate_agents(scene, view.timestamp_us)
    boxes = []
    for agent, (position, yaw, there) in enumerate(zip(*poses)):
        if not there or scene.agents.categories[agent] not in categories:
            continue
        corners = compute_box_corners(position, float(yaw), scene.agents.size[agent])
        in_camera = to_camera(np.vstack([corners, position]), view.global_T_ego, camera)
        polygon = _project_outline(in_camera[:8], camera, near_m)
        if polygon is None:
            continue
        distance_m = float(np.linalg.norm(in_camera[8]))
        boxes.append(ProjectedBox(scene.agents.ids[agent], scene.agents.categories[agent], polygon, distance_m))
    return tuple(boxes)


def find_visible_parts(boxes: Sequence[ProjectedBox], height: int, width: int) -> dict[str, Bools]:
    """(height, width) pixels by instance that nearer boxes leave; equally near ones hide by their identifiers."""
    hidden = np.zeros((height, width), bool)
    parts = {}
    for box in sorted(boxes, key=lambda box: (box.distance_m, box.instance)):
        filled = box.fill_mask(height, width)
        parts[box.instance] = filled & ~hidden
        hidden |= filled
    return parts


def _project_outline(corners: Floats, camera: Camera, near_m: float) -> Floats | None:
    """(P, 2) convex outline of what lies in front of the camera and in the image; ``None`` if nothing does."""
    ahead = corners[:, 2] >= near_m
    if not ahead.any():
        return None
    points = [corners[ahead]]
    for first, second in BOX_EDGES:
        if ahead[first] != ahead[second]:
            points.append(intersect_near_plane(corners[first], corners[second], near_m)[None])
    projected = np.vstack(points) @ camera.intrinsic.T
    pixels = projected[:, :2] / projected[:, 2:]
    try:
        hull = MultiPoint(pixels).convex_hull
        inside = hull.intersection(rectangle(0, 0, camera.width, camera.height))
    except GEOSException:
        return None
    if not isinstance(inside, Polygon) or inside.area <= 0:
        return None
    return np.asarray(inside.exterior.coords[:-1], np.float64)


def compute_scaled_size(width: int, height: int, longer_side_px: int) -> tuple[int, int]:
    """Width and height of a picture after its longer side was brought down to a limit; never enlarged."""
    longer = max(width, height)
    if longer <= longer_side_px:
        return width, height
    return max(round(width * longer_side_px / longer), 1), max(round(height * longer_side_px / longer), 1)


def reduce_picture(image: NDArray[np.uint8], longer_side_px: int) -> NDArray[np.uint8]:
    """A (height, width, 3) picture brought down to a longer side by averaging areas, unless it is smaller."""
    height, width = image.shape[:2]
    size = compute_scaled_size(width, height, longer_side_px)
    return image if size == (width, height) else np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


@dataclass(frozen=True, slots=True)
class CroppedMask:
    """Pixels of one subject within a rectangle of an image; its border rows and columns are not empty."""

    top: int
    left: int
    pixels: Bools

    @classmethod
    def of(cls, whole: Bools) -> Self | None:
        """Cut a (height, width) mask of a whole image; ``None`` if it is empty."""
        rows, columns = np.flatnonzero(whole.any(axis=1)), np.flatnonzero(whole.any(axis=0))
        if not len(rows):
            return None
        top, left = int(rows[0]), int(columns[0])
        return cls(top, left, whole[top : rows[-1] + 1, left : columns[-1] + 1].copy())

    @property
    def area_px(self) -> int:
        """How many pixels."""
        return int(np.count_nonzero(self.pixels))

    def cut(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """View of the mask's rectangle in a (height, width, 3) image, background included."""
        height, width = self.pixels.shape
        return image[self.top : self.top + height, self.left : self.left + width]


def compute_overlap(first: Bools, second: Bools) -> float:
    """Intersection over union of two masks of one image; 0 where both are empty."""
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else 0.0


FrameMasks = dict[str, CroppedMask]
"""Masks of one frame by instance."""


@dataclass(frozen=True, slots=True)
class CameraVideo:
    """F images (height, width, 3) RGB of one size from one camera, with exposure times and boxes in each."""

    camera: str
    times_us: tuple[int, ...]
    frames: tuple[NDArray[np.uint8], ...]
    boxes: tuple[tuple[ProjectedBox, ...], ...]

    def visible(self, frame: int) -> dict[str, Bools]:
        """Visible part of each box in a frame by instance."""
        height, width = self.frames[frame].shape[:2]
        return find_visible_parts(self.boxes[frame], height, width)


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

    definition: QualityDefinition

    def masks(self, video: CameraVideo) -> list[FrameMasks]:
        """Masks of one video, as `MaskMaker` promises."""
        frame_masks = []
        for frame, boxes in enumerate(video.boxes):
            height, width = video.frames[frame].shape[:2]
            whole_px = {box.instance: np.count_nonzero(box.fill_mask(height, width)) for box in boxes}
            visible = {
                name: part
                for name, part in video.visible(frame).items()
                if np.count_nonzero(part) >= self.definition.min_visible * whole_px[name]
            }
            frame_masks.append(_select_large_enough(visible, self.definition.min_mask_px))
        return frame_masks


@dataclass(frozen=True, slots=True)
class TrackedMasks:
    """SAM 2 follows each subject from a prompt on, through the frames in which its box is in view.

    Where a mask leaves its box the track ends, and the next prompt begins another one. Prompts are a detector's boxes
    (`grounded-sam2`), each tied to the projected box that it overlaps most, or the projected boxes (`sam2-boxes`).
    """

    definition: QualityDefinition
    segmenter: Segmenter
    detector: Detector | None = None

    def masks(self, video: CameraVideo) -> list[FrameMasks]:
        """Masks of one video, as `MaskMaker` promises."""
        visible = [
            _select_in_view(video.visible(frame), self.definition.min_mask_px) for frame in range(len(video.frames))
        ]
        prompts = [self._prompts(video, frame, parts) for frame, parts in enumerate(visible)]
        instances = sorted({name for frame in prompts for name in frame})
        frame_masks: list[dict[str, Bools]] = [{} for _ in video.frames]
        if instances:
            segments = self.segmenter.open(video.frames)
            for name in instances:
                parts = [frame.get(name) for frame in visible]
                boxes = [frame.get(name) for frame in prompts]
                followed = _follow_subject(parts, boxes, segments.begin, segments.follow, self.definition.min_overlap)
                for frame, mask in followed.items():
                    frame_masks[frame][name] = mask
        return [_select_large_enough(frame, self.definition.min_mask_px) for frame in frame_masks]

    def _prompts(self, video: CameraVideo, frame: int, visible: dict[str, Bools]) -> dict[str, Box]:
        projected = {
            name: rectangle for name, part in visible.items() if (rectangle := _bounding_box(part)) is not None
        }
        if self.detector is None:
            return projected
        if frame % self.definition.detect_every or not projected:
            return {}
        return match_detections(self.detector.boxes(video.frames[frame]), projected, self.definition.min_overlap)


def match_detections(detections: Sequence[Box], projected: dict[str, Box], min_overlap: float) -> dict[str, Box]:
    """Match detections and instances one to one, best overlaps first, above the least intersection over union.

    Equal overlaps go to the surer detection, then to the first identifier.
    """
    pairs = sorted(
        (-_box_overlap(box, rectangle), index, name)
        for index, box in enumerate(detections)
        for name, rectangle in projected.items()
    )
    matches: dict[str, Box] = {}
    matched: set[int] = set()
    for negative, index, name in pairs:
        if -negative >= min_overlap and index not in matched and name not in matches:
            matches[name] = detections[index]
            matched.add(index)
    return matches


def _follow_subject(
    parts: Sequence[Bools | None],
    prompts: Sequence[Box | None],
    begin: Callable[[int, Box], Bools],
    follow: Callable[[int], Bools],
    min_overlap: float,
) -> dict[int, Bools]:
    """Masks of one subject by frame."""
    masks, on_track = {}, False
    for frame, part in enumerate(parts):
        prompt = prompts[frame]
        if part is None:
            on_track = False
            continue
        mask = follow(frame) if on_track else None
        if mask is not None and compute_overlap(mask, part) < min_overlap:
            mask = None
        if mask is None and prompt is not None:
            mask = begin(frame, prompt)
            if compute_overlap(mask, part) < min_overlap:
                mask = None
        on_track = mask is not None
        if mask is not None:
            masks[frame] = mask
    return masks


def _select_in_view(parts: dict[str, Bools], min_px: int) -> dict[str, Bools]:
    return {name: part for name, part in parts.items() if np.count_nonzero(part) >= min_px}


def _select_large_enough(masks: dict[str, Bools], min_px: int) -> FrameMasks:
    cut = {name: CroppedMask.of(full_mask) for name, full_mask in masks.items()}
    return {name: mask for name, mask in sorted(cut.items()) if mask is not None and mask.area_px >= min_px}


def _bounding_box(part: Bools) -> Box | None:
    mask = CroppedMask.of(part)
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
