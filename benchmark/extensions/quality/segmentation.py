"""SAM 2 follows a subject through one camera's video from a box; Grounding DINO boxes what a text names.

Preparation of images in transformers needs torchvision, so that SAM 2's stands here: resize to the network's square,
ImageNet's mean and deviation, boxes scaled alike.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from benchmark.geometry import Bools
from benchmark.weights.pretrained import OptionalLibrary

_TRANSFORMERS: Final = OptionalLibrary("transformers", extra="quality", needed_by="video quality")


def load_pretrained(name: str, folder: Path, device: torch.device, **settings: Any) -> Any:
    """Network of transformers, for evaluation in single precision, or a processor, of class ``name``."""
    pretrained = _TRANSFORMERS.load(name, folder, **settings)
    return pretrained.to(device) if isinstance(pretrained, torch.nn.Module) else pretrained


def transformers_version() -> str:
    """Version of transformers; raises `InputError` where it is not installed."""
    return _TRANSFORMERS.version()


Box = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels."""
_MEAN: Final = (0.485, 0.456, 0.406)
_DEVIATION: Final = (0.229, 0.224, 0.225)
_BOX_CORNERS: Final = (2, 3)
"""Point labels of SAM 2 for the upper left and the lower right corner of a box."""
_KEPT_FEATURES: Final = 64
"""Frames whose image features are kept for the other subjects of a video."""


class Segmenter:
    """SAM 2 with the weights in a folder: ``facebook/sam2.1-hiera-large``, or another size for video."""

    def __init__(self, folder: Path, device: torch.device) -> None:
        self.network: Any = load_pretrained("Sam2VideoModel", folder, device)
        self.device = device

    @property
    def side_px(self) -> int:
        """Side of the square that frames are brought to."""
        side = self.network.config.prompt_encoder_config.image_size
        return int(side if isinstance(side, int) else side[0])

    def open(self, frames: Sequence[NDArray[np.uint8]]) -> "VideoSegments":
        """Prepare a video of (height, width, 3) RGB frames, all of one size, in which subjects can be followed."""
        return VideoSegments(self, frames)


class VideoSegments:
    """One video. Subjects are followed one at a time: what one is does not depend on which others there are."""

    def __init__(self, segmenter: Segmenter, frames: Sequence[NDArray[np.uint8]]) -> None:
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        self._segmenter = segmenter
        self._height, self._width = frames[0].shape[:2]
        video = torch.stack([prepare_frame(frame, segmenter.side_px) for frame in frames])
        self._session: Any = Sam2VideoInferenceSession(
            video=video,
            video_height=self._height,
            video_width=self._width,
            inference_device=segmenter.device,
            inference_state_device=segmenter.device,
            video_storage_device="cpu",
            dtype=torch.float32,
            max_vision_features_cache_size=_KEPT_FEATURES,
        )

    def begin(self, frame: int, box: Box) -> Bools:
        """Forget the last subject and begin with the one in a box of a frame; gives its (height, width) mask there."""
        session, side = self._session, self._segmenter.side_px
        session.reset_tracking_data()
        scale = torch.tensor([side / self._width, side / self._height])
        corners = torch.tensor(box, dtype=torch.float32).reshape(1, 1, 2, 2) * scale
        labels = torch.tensor(_BOX_CORNERS, dtype=torch.int32).reshape(1, 1, 2)
        subject = session.obj_id_to_idx(1)
        session.add_point_inputs(subject, frame, {"point_coords": corners, "point_labels": labels})
        session.obj_with_new_inputs = [1]
        return self.follow(frame)

    @torch.inference_mode()
    def follow(self, frame: int) -> Bools:
        """Mask of the subject, (height, width), empty where unseen; frames are asked for one after the other."""
        logits: Tensor = self._segmenter.network(self._session, frame_idx=frame).pred_masks
        size = (self._height, self._width)
        full_size = functional.interpolate(logits.float().reshape(1, 1, *logits.shape[-2:]), size, mode="bilinear")
        return np.asarray((full_size[0, 0] > 0).cpu())


def prepare_frame(frame: NDArray[np.uint8], side_px: int) -> Tensor:
    """A (height, width, 3) RGB frame as SAM 2 wants it, (3, side, side); proportions are not kept."""
    pixels = torch.tensor(frame, dtype=torch.float32).permute(2, 0, 1)[None]
    resized = functional.interpolate(pixels, (side_px, side_px), mode="bilinear", antialias=True)[0].round()
    mean, deviation = (torch.tensor(values)[:, None, None] for values in (_MEAN, _DEVIATION))
    return (resized / 255 - mean) / deviation


class Detector:
    """Grounding DINO (``IDEA-Research/grounding-dino-base``); prompts are lower case with a full stop."""

    def __init__(
        self, folder: Path, device: torch.device, prompt: str, box_threshold: float, text_threshold: float
    ) -> None:
        self._processor: Any = load_pretrained("GroundingDinoProcessor", folder, device)
        self._network: Any = load_pretrained("GroundingDinoForObjectDetection", folder, device)
        self._device, self._prompt = device, prompt
        self._box_threshold, self._text_threshold = box_threshold, text_threshold

    @torch.inference_mode()
    def boxes(self, image: NDArray[np.uint8]) -> list[Box]:
        """Boxes of the prompt inside a (height, width, 3) RGB image, the surest first."""
        from PIL import Image

        height, width = image.shape[:2]
        inputs = self._processor(images=Image.fromarray(image), text=self._prompt, return_tensors="pt").to(self._device)
        detections = self._processor.post_process_grounded_object_detection(
            self._network(**inputs),
            inputs["input_ids"],
            threshold=self._box_threshold,
            text_threshold=self._text_threshold,
            target_sizes=[(height, width)],
        )[0]
        order = torch.argsort(detections["scores"], descending=True, stable=True).tolist()
        boxes = detections["boxes"].cpu().double().numpy()[order]
        boxes = np.clip(boxes.reshape(-1, 2, 2), 0.0, (width, height)).reshape(-1, 4)
        return [
            (float(left), float(top), float(right), float(bottom))
            for left, top, right, bottom in boxes
            if right > left and bottom > top
        ]
