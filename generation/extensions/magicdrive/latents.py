"""The latent of a clip: its size, and views and patches taken apart and put together."""

from dataclasses import dataclass
from typing import Self

from torch import Tensor

from generation.extensions.magicdrive.layers import parted

PIXELS_PER_CELL = 8
"""Of an image, along a side of a latent cell."""


@dataclass(frozen=True, slots=True)
class LatentSize:
    """Size of a clip's latent: t latent frames, h rows and w columns of cells.

    The network computes with ``padded_rows``; the added ones are cropped.
    """

    frames: int
    rows: int
    columns: int
    padded_rows: int

    @classmethod
    def of(cls, frames: int, height: int, width: int, rows_multiple: int = 1) -> Self:
        """Latent of a clip of frames and pixels; t is a quarter of the frames, rounded up twice.

        Rows of tokens are padded to a multiple of ``rows_multiple``, as `MagicDriveConfig` says.
        """
        rows, columns = height // PIXELS_PER_CELL, width // PIXELS_PER_CELL
        token_rows, token_columns = -(-rows // 2), -(-columns // 2)
        missing = -token_rows % rows_multiple if token_rows * token_columns % rows_multiple else 0
        padded = 2 * (token_rows + missing) if missing else rows
        return cls((frames + 3) // 4, rows, columns, padded)

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tokens."""
        return -(-self.padded_rows // 2), -(-self.columns // 2)

    @property
    def tokens(self) -> int:
        """Tokens of a view's latent frame."""
        return self.grid[0] * self.grid[1]


def unpacked_views(latent: Tensor, views: int) -> Tensor:
    """Latents of the views apart, (b, views, channels, t, h, w).

    ``latent`` is (b, channels * views, t, h, w), channel-major and view-minor.
    """
    return parted(latent, 1, -1, views).transpose(1, 2)


def packed_views(latent: Tensor) -> Tensor:
    """The inverse of `unpacked_views`."""
    return latent.transpose(1, 2).flatten(1, 2)


def unpatched(patches: Tensor, size: LatentSize) -> Tensor:
    """(b, V, t, S, 2 * 2 * channels), row, column and channel in this order, to (b, V, channels, t, h, w)."""
    cells = parted(parted(patches, -1, 2, 2, -1), 3, *size.grid)
    whole = cells.permute(0, 1, 7, 2, 3, 5, 4, 6).flatten(6, 7).flatten(4, 5)
    return whole[..., : size.rows, : size.columns]
