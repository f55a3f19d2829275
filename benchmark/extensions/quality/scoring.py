"""Scores of a scene: subject consistency (DINO, VBench's formula) of each camera's subjects, and MUSIQ's, 0 to 1."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.extensions.quality.definition import QualityDefinition
from benchmark.extensions.quality.masks import (
    BoxMasks,
    CameraVideo,
    CroppedMask,
    FrameMasks,
    MaskMaker,
    TrackedMasks,
    project_boxes,
    reduce_picture,
)
from benchmark.extensions.quality.musiq import Musiq, cut_multiscale_patches
from benchmark.extensions.quality.segmentation import load_pretrained
from benchmark.geometry import Floats
from benchmark.machine.devices import single_precision
from benchmark.records.quality import ExactSum, SceneQualityRows, SubjectRow, VideoRow
from benchmark.untrusted.http_images import read_picture
from benchmark.weights.catalogue import DINO, GROUNDING_DINO, MUSIQ, SAM2

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.planning import CameraView
    from benchmark.scene import Scene

_MEAN: Final = (0.485, 0.456, 0.406)
_DEVIATION: Final = (0.229, 0.224, 0.225)
"""Pixel values that DINO was trained with, of 1."""


class SubjectFeatureExtractor:
    """Features of masked subjects in squares of ``crop_px``, by ``facebook/dino-vitb16``, a ``batch`` at a time."""

    def __init__(self, folder: Path, device: torch.device, crop_px: int, batch: int) -> None:
        self._network: Any = load_pretrained("ViTModel", folder, device, add_pooling_layer=False)
        self._folder, self._device, self._crop_px, self._batch = folder, device, crop_px, batch
        patch = self._network.config.patch_size
        if crop_px % patch:
            raise InputError(f"crops of {crop_px} pixels do not divide into the patches of {patch} that {folder} needs")

    @torch.inference_mode()
    def features(self, appearances: Sequence[tuple[NDArray[np.uint8], CroppedMask]]) -> Floats:
        """(A, D) features of unit length of A appearances, each an image and the mask in it."""
        parts = []
        for start in range(0, len(appearances), self._batch):
            squares = [crop_subject(*appearance, self._crop_px) for appearance in appearances[start:][: self._batch]]
            pixels = torch.stack(squares).to(self._device)
            states = self._network(pixel_values=pixels, interpolate_pos_encoding=True).last_hidden_state
            parts.append(functional.normalize(states[:, 0].double(), dim=-1).cpu())
        features = np.asarray(torch.cat(parts)) if parts else np.zeros((0, 0))
        if not np.isfinite(features).all():
            raise InputError(f"the weights in {self._folder} give features that are not finite; fetch them again")
        return features


def compute_similarities(features: Floats) -> Floats:
    """(A - 1,) mean cosines with the appearance before and with the first one (VBench), negative ones as zero.

    ``features`` are (A, D) of unit length, one subject's in time order; a single one could be consistent with nothing.
    """
    if len(features) < 2:
        return np.zeros(0)
    with_first = np.einsum("ad,d->a", features[1:], features[0])
    with_previous = np.einsum("ad,ad->a", features[1:], features[:-1])
    return np.asarray((np.maximum(with_first, 0.0) + np.maximum(with_previous, 0.0)) / 2)


def crop_subject(image: NDArray[np.uint8], mask: CroppedMask, side_px: int) -> Tensor:
    """A subject alone, in the middle of a (3, side, side) square, as DINO wants it.

    The background has the mean colour, which is zero for the network. The rectangle of the mask is padded to a square,
    so that shapes keep their proportions, and resized bilinearly without smoothing.
    """
    mean = torch.tensor(_MEAN)[:, None, None]
    subject = torch.tensor(mask.cut(image), dtype=torch.float32).permute(2, 0, 1)
    subject = torch.where(torch.tensor(mask.pixels)[None], subject, 255 * mean)
    height, width = subject.shape[1:]
    side = max(height, width)
    top, left = (side - height) // 2, (side - width) // 2
    square = (255 * mean).expand(3, side, side).clone()
    square[:, top : top + height, left : left + width] = subject
    resized = functional.interpolate(square[None], (side_px, side_px), mode="bilinear", align_corners=False)[0]
    return (resized / 255 - mean) / torch.tensor(_DEVIATION)[:, None, None]


_FULL_SCORE: Final = 100.0
"""VBench divides by it."""


class ImagingQuality:
    """MUSIQ's scores of pictures, a ``batch`` at a time, brought down to a longer side of ``longer_px``."""

    def __init__(self, weights: Path, device: torch.device, longer_px: int, batch: int) -> None:
        self._network = Musiq.load(weights).to(device)
        self._weights, self._device, self._longer_px, self._batch = weights, device, longer_px, batch

    @torch.inference_mode()
    def scores(self, pictures: Sequence[NDArray[np.uint8]]) -> list[float]:
        """Score (height, width, 3) RGB pictures of any sizes: about 0 (bad) to 1 (good) each."""
        values: list[float] = []
        grid = self._network.config.grid
        for start in range(0, len(pictures), self._batch):
            some = [
                prepare_picture(picture, self._longer_px).to(self._device)
                for picture in pictures[start:][: self._batch]
            ]
            scores = self._network([cut_multiscale_patches(picture, grid) for picture in some])
            values += (scores.double() / _FULL_SCORE).tolist()
        if not np.isfinite(values).all():
            raise InputError(f"the weights in {self._weights} give scores that are not finite; fetch them again")
        return values


def prepare_picture(picture: NDArray[np.uint8], longer_px: int) -> Tensor:
    """(3, height, width), -1 to 1, of an RGB picture; larger ones are resized bilinearly, rounded to 8 bits."""
    pixels = torch.tensor(picture, dtype=torch.float32).permute(2, 0, 1)
    height, width = pixels.shape[1:]
    if max(height, width) > longer_px:
        scale = longer_px / max(height, width)
        size = max(int(scale * height), 1), max(int(scale * width), 1)
        pixels = functional.interpolate(pixels[None], size, mode="bilinear", align_corners=False)[0].round()
    return pixels / 255 * 2 - 1


_TURNED: Final = 0.02
"""An image whose proportions differ by more than this from its camera's is not that camera's."""


@dataclass(frozen=True, slots=True)
class QualityNetworks:
    """Source of masks, DINO and MUSIQ: everything that looks at pixels."""

    masks: MaskMaker
    features: SubjectFeatureExtractor
    imaging: ImagingQuality


def load_networks(definition: QualityDefinition, folders: Mapping[str, Path], place: torch.device) -> QualityNetworks:
    """Load the source of masks, DINO and MUSIQ of a definition, with weights by name (`list_required_weights`)."""
    masks: MaskMaker = BoxMasks(definition)
    if definition.masks != "boxes":
        from benchmark.extensions.quality.segmentation import Detector, Segmenter

        detector = None
        if definition.masks == "grounded-sam2":
            thresholds = definition.box_threshold, definition.text_threshold
            detector = Detector(folders[GROUNDING_DINO.name], place, definition.prompt, *thresholds)
        masks = TrackedMasks(definition, Segmenter(folders[SAM2.name], place), detector)
    return QualityNetworks(
        masks=masks,
        features=SubjectFeatureExtractor(folders[DINO.name], place, definition.crop_px, definition.batch),
        imaging=ImagingQuality(
            folders[MUSIQ.name] / MUSIQ.files[0].name, place, definition.imaging_longer_px, definition.batch
        ),
    )


def score_scene(
    data: "DataSet", name: str, definition: QualityDefinition, networks: QualityNetworks
) -> SceneQualityRows:
    """Score a scene; its rows depend on nothing but the scene and the definition."""
    scene = data.scene(name)
    videos = data.videos(name, sweeps=definition.frames == "all")
    if not any(videos.values()):
        raise InputError(f"scene {name} of {data.root} has no camera images to score; leave it out")
    subjects: list[SubjectRow] = []
    rows: list[VideoRow] = []
    with single_precision():
        for camera, views in videos.items():
            video = _read_video(scene, camera, views, definition)
            subjects += _score_subjects(scene, video, networks)
            rows.append(_score_frames(name, video, views, definition, networks.imaging))
    return SceneQualityRows(scene=name, subjects=subjects, videos=rows)


def _read_video(
    scene: "Scene", camera: str, views: "Sequence[CameraView]", definition: QualityDefinition
) -> CameraVideo:
    """Read one camera's images in time order and project the vehicles into them."""
    frames: list[NDArray[np.uint8]] = []
    boxes = []
    for view in views:
        image = _read_image(view, definition)
        height, width = image.shape[:2]
        proportion = (width / height) / (view.camera.width / view.camera.height)
        if abs(proportion - 1) > _TURNED:
            raise InputError(
                f"image {view.path} is {width} x {height} pixels, which does not have the proportions of its camera "
                f"({view.camera.width} x {view.camera.height}); correct the size in sample_data or the image"
            )
        frame = reduce_picture(image, definition.longer_side_px)
        if frames and frame.shape != frames[0].shape:
            raise InputError(f"image {view.path} differs in size from others of {camera} of {scene.name}; fix it")
        frames.append(frame)
        size = frame.shape[1], frame.shape[0]
        boxes.append(project_boxes(scene, view, size, definition.categories, definition.near_m))
    return CameraVideo(camera, tuple(view.timestamp_us for view in views), tuple(frames), tuple(boxes))


def find_image_file(view: "CameraView", definition: QualityDefinition) -> Path:
    """The file that is scored for a view: the view's own, or the PNG file of the same name beside it."""
    return view.path if definition.files == "own" else view.path.with_suffix(".png")


def _read_image(view: "CameraView", definition: QualityDefinition) -> NDArray[np.uint8]:
    path = find_image_file(view, definition)
    if path == view.path:
        return view.load()
    if not path.is_file():
        raise InputError(
            f"there is no lossless frame {path} beside {view.path.name}; render the split with --lossless, or leave "
            "--lossless out here"
        )
    return read_picture(path)


def _score_subjects(scene: "Scene", video: CameraVideo, networks: QualityNetworks) -> list[SubjectRow]:
    masks = networks.masks.masks(video)
    appearances = [
        (name, frame, mask)
        for name in sorted({name for masked in masks for name in masked})
        for frame, mask in _find_appearances(masks, name)
    ]
    if not appearances:
        return []
    features = networks.features.features([(video.frames[frame], mask) for _, frame, mask in appearances])
    quality = networks.imaging.scores([mask.cut(video.frames[frame]) for _, frame, mask in appearances])
    category = dict(zip(scene.agents.ids, scene.agents.categories))
    rows = []
    for name in dict.fromkeys(name for name, _, _ in appearances):
        at = [index for index, (of, _, _) in enumerate(appearances) if of == name]
        frames = [appearances[index][1] for index in at]
        rows.append(
            SubjectRow(
                scene=scene.name,
                camera=video.camera,
                instance=name,
                category=category[name],
                adversary=name in scene.adversaries,
                appearances=len(at),
                returns=sum(later > earlier + 1 for earlier, later in pairwise(frames)),
                first_us=video.times_us[frames[0]],
                last_us=video.times_us[frames[-1]],
                mean_area_px=sum(appearances[index][2].area_px for index in at) / len(at),
                consistency=ExactSum.of(compute_similarities(features[at]).tolist()),
                imaging=ExactSum.of([quality[index] for index in at]),
            )
        )
    return rows


def _find_appearances(masks: Sequence[FrameMasks], name: str) -> list[tuple[int, CroppedMask]]:
    return [(frame, masked[name]) for frame, masked in enumerate(masks) if name in masked]


def _score_frames(
    scene: str,
    video: CameraVideo,
    views: "Sequence[CameraView]",
    definition: QualityDefinition,
    imaging: ImagingQuality,
) -> VideoRow:
    height, width = video.frames[0].shape[:2]
    suffixes = (find_image_file(view, definition).suffix.lower().lstrip(".") for view in views)
    return VideoRow(
        scene=scene,
        camera=video.camera,
        frames=len(video.frames),
        width=width,
        height=height,
        formats=dict(sorted(Counter(suffixes).items())),
        imaging=ExactSum.of(imaging.scores(video.frames)),
    )
