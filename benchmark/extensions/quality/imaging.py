"""Imaging quality: MUSIQ's score of pictures, 0 to 1, prepared as VBench prepares frames."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.extensions.quality.musiq import Musiq, multiscale_patches

_FULL_SCORE: Final = 100.0
"""VBench divides by it."""


class ImagingQuality:
    """MUSIQ's scores of pictures.

    Args:
        longer_px: Larger pictures are brought down to this longer side.
        batch: Pictures that go through the network together.
    """

    def __init__(self, weights: Path, device: torch.device, longer_px: int, batch: int) -> None:
        self._network = Musiq.load(weights).to(device)
        self._weights, self._device, self._longer_px, self._batch = weights, device, longer_px, batch

    @torch.inference_mode()
    def scores(self, pictures: Sequence[NDArray[np.uint8]]) -> list[float]:
        """Score (height, width, 3) RGB pictures of any sizes: about 0 (bad) to 1 (good) each."""
        found: list[float] = []
        grid = self._network.config.grid
        for start in range(0, len(pictures), self._batch):
            some = [prepared(picture, self._longer_px).to(self._device) for picture in pictures[start:][: self._batch]]
            scores = self._network([multiscale_patches(picture, grid) for picture in some])
            found += (scores.double() / _FULL_SCORE).tolist()
        if not np.isfinite(found).all():
            raise InputError(f"the weights in {self._weights} give scores that are no numbers; get them again")
        return found


def prepared(picture: NDArray[np.uint8], longer_px: int) -> Tensor:
    """A (height, width, 3) RGB picture as MUSIQ wants it, (3, height, width).

    Above a longer side it is brought down bilinearly without smoothing, rounded to 8 bits, then scaled to -1 to 1.
    """
    found = torch.tensor(picture, dtype=torch.float32).permute(2, 0, 1)
    height, width = found.shape[1:]
    if max(height, width) > longer_px:
        scale = longer_px / max(height, width)
        size = max(int(scale * height), 1), max(int(scale * width), 1)
        found = functional.interpolate(found[None], size, mode="bilinear", align_corners=False)[0].round()
    return found / 255 * 2 - 1
