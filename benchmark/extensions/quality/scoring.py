"""One scene, scored: every subject of every camera, and the frames as wholes."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.extensions.quality.consistency import SubjectFeatures, similarities
from benchmark.extensions.quality.cut_masks import Mask
from benchmark.extensions.quality.definition import Definition
from benchmark.extensions.quality.imaging import ImagingQuality
from benchmark.extensions.quality.masks import BoxMasks, CameraVideo, FrameMasks, MaskMaker, TrackedMasks
from benchmark.extensions.quality.projection import boxes_in_view, reduced
from benchmark.machine.devices import single_precision
from benchmark.records.quality_schema import SceneRows, SubjectRow, Sum, VideoRow
from benchmark.untrusted.pictures import read_picture
from benchmark.weights.catalogue import DINO, GROUNDING_DINO, MUSIQ, SAM2

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.planning import CameraView
    from benchmark.scene import Scene

_TURNED: Final = 0.02
"""An image whose proportions differ by more than this from its camera's is not that camera's."""


@dataclass(frozen=True, slots=True)
class Networks:
    """Source of masks, DINO and MUSIQ: everything that looks at pixels."""

    masks: MaskMaker
    features: SubjectFeatures
    imaging: ImagingQuality


def load_networks(definition: Definition, folders: Mapping[str, Path], place: torch.device) -> Networks:
    """Load the source of masks, DINO and MUSIQ of a definition, with weights by name (`needed_for`)."""
    masks: MaskMaker = BoxMasks(definition)
    if definition.masks != "boxes":
        from benchmark.extensions.quality.detection import Detector
        from benchmark.extensions.quality.segmentation import Segmenter

        detector = None
        if definition.masks == "grounded-sam2":
            thresholds = definition.box_threshold, definition.text_threshold
            detector = Detector(folders[GROUNDING_DINO.name], place, definition.prompt, *thresholds)
        masks = TrackedMasks(definition, Segmenter(folders[SAM2.name], place), detector)
    return Networks(
        masks=masks,
        features=SubjectFeatures(folders[DINO.name], place, definition.crop_px, definition.batch),
        imaging=ImagingQuality(
            folders[MUSIQ.name] / MUSIQ.files[0].name, place, definition.imaging_longer_px, definition.batch
        ),
    )


def score_scene(data: "DataSet", name: str, definition: Definition, networks: Networks) -> SceneRows:
    """Score a scene; its rows depend on nothing but the scene and the definition."""
    scene = data.scene(name)
    videos = data.videos(name, sweeps=definition.frames == "all")
    if not any(videos.values()):
        raise InputError(f"scene {name} of {data.root} has no camera images, so that there is nothing to score")
    subjects: list[SubjectRow] = []
    rows: list[VideoRow] = []
    with single_precision():
        for camera, views in videos.items():
            video = _camera_video(scene, camera, views, definition)
            subjects += _subjects(scene, video, networks)
            rows.append(_whole_frames(name, video, views, definition, networks.imaging))
    return SceneRows(scene=name, subjects=subjects, videos=rows)


def _camera_video(scene: "Scene", camera: str, views: "Sequence[CameraView]", definition: Definition) -> CameraVideo:
    """Read one camera's images in time order and project the vehicles into them."""
    frames: list[NDArray[np.uint8]] = []
    boxes = []
    for view in views:
        image = _load(view, definition)
        height, width = image.shape[:2]
        proportion = (width / height) / (view.camera.width / view.camera.height)
        if abs(proportion - 1) > _TURNED:
            raise InputError(
                f"image {view.path} is {width} x {height} pixels, which does not have the proportions of its camera "
                f"({view.camera.width} x {view.camera.height}); correct the size in sample_data or the image"
            )
        frame = reduced(image, definition.longer_side_px)
        if frames and frame.shape != frames[0].shape:
            raise InputError(f"image {view.path} has another size than the others of {camera} of {scene.name}; fix it")
        frames.append(frame)
        size = frame.shape[1], frame.shape[0]
        boxes.append(boxes_in_view(scene, view, size, definition.categories, definition.near_m))
    return CameraVideo(camera, tuple(view.timestamp_us for view in views), tuple(frames), tuple(boxes))


def image_file(view: "CameraView", definition: Definition) -> Path:
    """The file that is scored for a view: the view's own, or the PNG file of the same name beside it."""
    return view.path if definition.files == "own" else view.path.with_suffix(".png")


def _load(view: "CameraView", definition: Definition) -> NDArray[np.uint8]:
    path = image_file(view, definition)
    if path == view.path:
        return view.load()
    if not path.is_file():
        raise InputError(
            f"there is no lossless frame {path} beside {view.path.name}; render the split with --lossless, or leave "
            "--lossless out here"
        )
    return read_picture(path)


def _subjects(scene: "Scene", video: CameraVideo, networks: Networks) -> list[SubjectRow]:
    masks = networks.masks.masks(video)
    seen = [
        (name, frame, mask)
        for name in sorted({name for masked in masks for name in masked})
        for frame, mask in _appearances(masks, name)
    ]
    if not seen:
        return []
    features = networks.features.features([(video.frames[frame], mask) for _, frame, mask in seen])
    quality = networks.imaging.scores([mask.cut(video.frames[frame]) for _, frame, mask in seen])
    category = dict(zip(scene.agents.ids, scene.agents.categories))
    rows = []
    for name in dict.fromkeys(name for name, _, _ in seen):
        at = [index for index, (of, _, _) in enumerate(seen) if of == name]
        frames = [seen[index][1] for index in at]
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
                mean_area_px=sum(seen[index][2].area_px for index in at) / len(at),
                consistency=Sum.of(similarities(features[at]).tolist()),
                imaging=Sum.of([quality[index] for index in at]),
            )
        )
    return rows


def _appearances(masks: Sequence[FrameMasks], name: str) -> list[tuple[int, Mask]]:
    return [(frame, masked[name]) for frame, masked in enumerate(masks) if name in masked]


def _whole_frames(
    scene: str,
    video: CameraVideo,
    views: "Sequence[CameraView]",
    definition: Definition,
    imaging: ImagingQuality,
) -> VideoRow:
    height, width = video.frames[0].shape[:2]
    suffixes = (image_file(view, definition).suffix.lower().lstrip(".") for view in views)
    return VideoRow(
        scene=scene,
        camera=video.camera,
        frames=len(video.frames),
        width=width,
        height=height,
        formats=dict(sorted(Counter(suffixes).items())),
        imaging=Sum.of(imaging.scores(video.frames)),
    )
