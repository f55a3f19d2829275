"""Conditions of MagicDriveDiT for one clip: boxes, map, cameras, ego motion and words, as tensors.

Section numbers are those of the model's specification. V views are in the model's order (`MODEL_CAMERAS`), T are
frames, n is the number of distinct objects in the clip (at least 1, padded where there is none). Lengths are metres,
in the lidar frame of their own frame (x right, y forward, z up).
"""

from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self

import torch
from torch import Tensor

MODEL_CAMERAS: Final = (
    "CAM_FRONT_LEFT",
    "CAM_FRONT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK_RIGHT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
)
"""View order inside the model: once around the car, so that neighbours in the list are neighbours in the world."""
TEXT_TOKENS: Final = 300
"""Length to which prompts are padded or cut."""
ABSENT_CLASS: Final = -1
"""Class of a box slot whose object is not there in a frame."""


@dataclass(frozen=True, slots=True)
class TextStates:
    """Encoded prompt (section 4.1): (300, d) last hidden states, d 4096 with T5 v1.1 XXL, and the mask of tokens."""

    hidden: Tensor
    mask: Tensor

    def to(self, device: torch.device | str) -> "TextStates":
        """The same states on another device."""
        return TextStates(self.hidden.to(device), self.mask.to(device))


@dataclass(frozen=True, slots=True)
class ClipConditions:
    """Everything one call of the model is given about one clip (section 2), without the batch dimension.

    Attributes:
        bboxes: (1 or V, T, n, 8, 3) float32 corners; 0 where the object is absent. One view stands for all.
        classes: (1 or V, T, n) int64 class 0..9, -1 where absent.
        masks: (V, T, n) int64; 1 used by this view, 0 absent or not seen by it, -1 present but hidden.
        box_latent: (n, C) float32, one Gaussian vector per object, the same in all frames and views.
        cams: (V, T, 1, 3, 7) float32, the intrinsic matrix at 1600x900 beside the camera->lidar transform (3x4).
        rel_pos: (T, 4, 4) float32, transform from the first lidar frame to this one.
        maps: (T, 8, 200, 200) bool masks from above, [channel, lidar x (right), lidar y (forward)]; 400 x 400 cells
            where the image is higher than 224 pixels.
        fps: 12 for video, 120 for a single image.
        negative_text: A negative prompt; ``None`` for the model's own null prompt.
    """

    bboxes: Tensor
    classes: Tensor
    masks: Tensor
    box_latent: Tensor
    cams: Tensor
    rel_pos: Tensor
    maps: Tensor
    text: TextStates
    fps: float
    height: int
    width: int
    negative_text: TextStates | None = None

    def __post_init__(self) -> None:
        views, frames, boxes = self.masks.shape
        for name, wanted in (
            ("bboxes", (self.bboxes.shape[0], frames, boxes, 8, 3)),
            ("classes", (self.bboxes.shape[0], frames, boxes)),
            ("box_latent", (boxes, self.box_latent.shape[-1])),
            ("cams", (views, frames, 1, 3, 7)),
            ("rel_pos", (frames, 4, 4)),
        ):
            shape = tuple(getattr(self, name).shape)
            if shape != wanted:
                raise ValueError(f"{name} has shape {shape}, not {wanted}")
        if self.bboxes.shape[0] not in (1, views):
            raise ValueError(f"boxes are given for {self.bboxes.shape[0]} views; give them for 1 or {views}")
        if self.maps.shape[0] != frames:
            raise ValueError(f"maps are given for {self.maps.shape[0]} frames, not {frames}")

    @property
    def views(self) -> int:
        """Number of cameras."""
        return int(self.masks.shape[0])

    @property
    def frames(self) -> int:
        """Number of frames."""
        return int(self.masks.shape[1])

    @property
    def boxes(self) -> int:
        """Number of box slots."""
        return int(self.masks.shape[2])

    def to(self, device: torch.device | str) -> Self:
        """Copy of the conditions with its tensors on another device."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        moved: dict[str, Any] = {
            name: value.to(device) for name, value in values.items() if isinstance(value, Tensor | TextStates)
        }
        return replace(self, **moved)
