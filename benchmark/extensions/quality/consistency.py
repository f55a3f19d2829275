"""Subject consistency: how alike DINO finds a subject's appearances, by VBench's formula."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.extensions.quality.cut_masks import Mask
from benchmark.extensions.quality.pretrained import load_pretrained
from benchmark.geometry import Floats

_MEAN: Final = (0.485, 0.456, 0.406)
_DEVIATION: Final = (0.229, 0.224, 0.225)
"""Pixel values that DINO was trained with, of 1."""


class SubjectFeatures:
    """DINO's features of masked subjects, each brought to a square of ``crop_px``.

    Args:
        folder: Weights of ``facebook/dino-vitb16``.
        batch: Subjects that go through the network together.
    """

    def __init__(self, folder: Path, device: torch.device, crop_px: int, batch: int) -> None:
        self._network: Any = load_pretrained("ViTModel", folder, device, add_pooling_layer=False)
        self._folder, self._device, self._crop_px, self._batch = folder, device, crop_px, batch
        patch = self._network.config.patch_size
        if crop_px % patch:
            raise InputError(f"crops of {crop_px} pixels cannot be cut into the patches of {patch} that {folder} wants")

    @torch.inference_mode()
    def features(self, appearances: Sequence[tuple[NDArray[np.uint8], Mask]]) -> Floats:
        """(A, D) features of unit length of A appearances, each an image and the mask in it."""
        found = []
        for start in range(0, len(appearances), self._batch):
            squares = [subject_square(*appearance, self._crop_px) for appearance in appearances[start:][: self._batch]]
            pixels = torch.stack(squares).to(self._device)
            states = self._network(pixel_values=pixels, interpolate_pos_encoding=True).last_hidden_state
            found.append(functional.normalize(states[:, 0].double(), dim=-1).cpu())
        features = np.asarray(torch.cat(found)) if found else np.zeros((0, 0))
        if not np.isfinite(features).all():
            raise InputError(f"the weights in {self._folder} give features that are no numbers; get them again")
        return features


def similarities(features: Floats) -> Floats:
    """VBench's value of each appearance after the first.

    Args:
        features: (A, D) of unit length, one subject's appearances in time order.

    Returns:
        (A - 1,) mean of the cosines with the appearance before and with the first one, negative cosines as zero.
            Empty for a single appearance: there is nothing that it could be consistent with.
    """
    if len(features) < 2:
        return np.zeros(0)
    with_first = np.einsum("ad,d->a", features[1:], features[0])
    with_previous = np.einsum("ad,ad->a", features[1:], features[:-1])
    return np.asarray((np.maximum(with_first, 0.0) + np.maximum(with_previous, 0.0)) / 2)


def subject_square(image: NDArray[np.uint8], mask: Mask, side_px: int) -> Tensor:
    """A subject alone, in the middle of a (3, side, side) square, as DINO wants it.

    The image is (height, width, 3) RGB.

    The background has the mean colour, which is zero for the network. The rectangle of the mask is padded to a square,
    so that shapes keep their proportions, and resized bilinearly without smoothing.
    """
    mean = torch.tensor(_MEAN)[:, None, None]
    found = torch.tensor(mask.cut(image), dtype=torch.float32).permute(2, 0, 1)
    found = torch.where(torch.tensor(mask.pixels)[None], found, 255 * mean)
    height, width = found.shape[1:]
    side = max(height, width)
    top, left = (side - height) // 2, (side - width) // 2
    square = (255 * mean).expand(3, side, side).clone()
    square[:, top : top + height, left : left + width] = found
    resized = functional.interpolate(square[None], (side_px, side_px), mode="bilinear", align_corners=False)[0]
    return (resized / 255 - mean) / torch.tensor(_DEVIATION)[:, None, None]
