"""Masks cut to their rectangle, so that a scene's masks fit into memory."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools


@dataclass(frozen=True, slots=True)
class Mask:
    """Pixels of an image that belong to one subject.

    Attributes:
        pixels: (height, width) of the rectangle; its border rows and columns are not empty.
    """

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


def overlap(first: Bools, second: Bools) -> float:
    """Intersection over union of two masks of one image; 0 where both are empty."""
    union = np.count_nonzero(first | second)
    return float(np.count_nonzero(first & second) / union) if union else 0.0
