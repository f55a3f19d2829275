"""Images of cameras on a scene's timeline: the files' bytes, unless it is asked that they be encoded anew."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import cv2
import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.extensions.mcap.timeline import Primitives, Timeline
from benchmark.planning import CameraView
from benchmark.untrusted.files import PICTURE, read_file

ImageChoice = Literal["keyframes", "all", "none"]
_FORMATS: Final = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png", ".webp": "webp"}
"""Names of formats that viewers know, by the suffix of a file."""


@dataclass(frozen=True, slots=True)
class CameraImages:
    """Images of a scene.

    Attributes:
        views: By camera, in time order.
        quality: 1 to 100, of WebP pictures that are made of them; ``None`` for the files as they are.
    """

    views: Mapping[str, Sequence[CameraView]]
    quality: int | None = None

    @property
    def first_us(self) -> tuple[int, ...]:
        """When the first image of each camera was taken."""
        return tuple(int(views[0].timestamp_us) for views in self.views.values() if views)

    def encode(self, view: CameraView) -> tuple[bytes, str]:
        """An image's bytes and their format; `InputError` if the file is missing or, where it is opened, broken."""
        if self.quality is None:
            return read_file(view.path, PICTURE), _FORMATS[view.path.suffix.lower()]
        picture = cv2.cvtColor(view.load(), cv2.COLOR_RGB2BGR)
        return cv2.imencode(".webp", picture, [cv2.IMWRITE_WEBP_QUALITY, self.quality])[1].tobytes(), "webp"

    def count_bytes(self) -> int:
        """Bytes of all images; where they are encoded anew about, from the first of each camera."""
        if self.quality is None:
            return sum(view.path.stat().st_size for views in self.views.values() for view in views)
        return sum(len(self.encode(views[0])[0]) * len(views) for views in self.views.values() if views)


def find_images(dataset: DataSet, name: str, choice: ImageChoice, quality: int | None = None) -> CameraImages:
    """Images of a scene, none where the data set has none of the files.

    `InputError` if it has only some of them, or files that no viewer shows.
    """
    views = {} if choice == "none" else dataset.videos(name, sweeps=choice == "all")
    paths = [view.path for of_camera in views.values() for view in of_camera]
    missing = [path for path in paths if not path.is_file()]
    if len(missing) == len(paths):
        return CameraImages({}, quality)
    if missing:
        raise InputError(
            f"image {missing[0]} of scene {name} is missing; complete the data set, or leave images out with --images "
            "none"
        )
    for path in paths:
        if path.suffix.lower() not in _FORMATS:
            raise InputError(f"image {path} is none that viewers show ({', '.join(_FORMATS)}); use --images none")
    return CameraImages(views, quality)


def add_images(timeline: Timeline, make: Primitives, images: CameraImages) -> None:
    """Each image with its calibration; read when it is written."""
    for name, views in images.views.items():
        frame, topic = name.lower(), f"/{name.lower()}"
        for view in views:
            time_us, camera = int(view.timestamp_us), view.camera
            intrinsic = np.asarray(camera.intrinsic, np.float64)
            calibration = make.messages.CameraCalibration(
                timestamp=make.time(time_us),
                frame_id=frame,
                width=camera.width,
                height=camera.height,
                K=intrinsic.ravel().tolist(),
                R=np.eye(3).ravel().tolist(),
                P=np.column_stack([intrinsic, np.zeros(3)]).ravel().tolist(),
            )
            timeline.add(time_us, f"{topic}/camera_info", calibration)

            def load(view: CameraView = view, time_us: int = time_us, frame: str = frame) -> Any:
                data, kind = images.encode(view)
                return make.messages.CompressedImage(
                    timestamp=make.time(time_us), frame_id=frame, data=data, format=kind
                )

            timeline.add_later(time_us, f"{topic}/image_rect_compressed", load)
