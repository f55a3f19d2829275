"""Arrays of a golden file of protocols: flags stored as numbers, rasters as bits, names."""

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Bools
from benchmark.protocols.raster import CELLS
from benchmark.verification.golden import GoldenArrays


class ProtocolArrays(GoldenArrays):
    """Arrays of one file; flags that are stored as numbers and rasters that are stored as bits are unpacked."""

    def flags(self, name: str, *shape: int | None) -> Bools:
        """Zeros and ones; arguments and errors as in `floats`."""
        values = self.floats(name, *shape)
        if not np.isin(values, (0.0, 1.0)).all():
            raise InputError(f"array {name} in {self.path} holds numbers other than 0 and 1; make the file again")
        return np.asarray(values != 0.0)

    def rasters(self, name: str, samples: int) -> NDArray[np.uint8]:
        """Rasters packed eight cells to the byte.

        Args:
            name: Name of the array.
            samples: How many samples it is about.

        Returns:
            (samples, 6, 200, 200) ones where occupied.

        Raises:
            InputError: If it is absent, of another shape or does not hold bytes.
        """
        packed = self.packed(name, samples, PLAN_STEPS, CELLS * CELLS // 8)
        return np.unpackbits(packed, axis=-1).reshape(samples, PLAN_STEPS, CELLS, CELLS)

    def packed(self, name: str, *shape: int | None) -> NDArray[np.uint8]:
        """Bytes that hold eight cells each; arguments and errors as in `floats`."""
        packed = self.integers(name, *shape)
        if packed.min(initial=0) < 0 or packed.max(initial=0) > 255:
            raise InputError(f"array {name} in {self.path} holds numbers that are no bytes; make the file again")
        return packed.astype(np.uint8)

    def labels(self, name: str, length: int | None = None) -> list[str]:
        """Names; arguments and errors as in `floats`."""
        return [str(label) for label in self._taken(name, "U", "names", (length,))]
