"""Kerb lines and drivable cells as a golden set stores them, in place of a map."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats
from benchmark.verification.golden import GoldenArrays

_SIDE: Final = 1000


@dataclass(frozen=True, slots=True)
class GivenRoads:
    """`benchmark.truth.Roads` of one golden sample.

    Attributes:
        lines: (N, 20, 2) edges of the road surface, ego frame, metres.
        packed: (125000,) drivable cells, eight to the byte.
    """

    lines: NDArray[np.float32]
    packed: NDArray[np.uint8]

    @property
    def has_kerbs(self) -> bool:
        """A set of this form has them."""
        return True

    def kerb_lines(self) -> NDArray[np.float32]:
        """(N, 20, 2) edges."""
        return self.lines

    def drivable_cells(self) -> NDArray[np.uint8]:
        """(1000, 1000) ones where drivable."""
        return np.unpackbits(self.packed).reshape(_SIDE, _SIDE)

    def surely_drivable(self, points: Floats, margin_m: float) -> Bools:
        """Nothing is known without looking at the cells."""
        return np.zeros(len(points), dtype=np.bool_)


def read_roads(stored: GoldenArrays, samples: int) -> list[GivenRoads]:
    """The roads of each sample of a file."""
    lines = stored.floats("boundary_lines", None, 20, 2).astype(np.float32)
    offset = stored.integers("boundary_offset", samples + 1)
    packed = stored.integers("drivable_bits", samples, _SIDE * _SIDE // 8).astype(np.uint8)
    return [GivenRoads(lines[offset[index] : offset[index + 1]], packed[index]) for index in range(samples)]
