"""Files of a golden set of NeuroNCAP: what more they hold than other golden sets do."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.verification.golden import GoldenArrays
from benchmark.verification.golden_facts import GoldenFacts

CODE_TOLERANCE: Final = 5e-6
"""Of what the published code computes partly in single precision."""
TOLERANCE: Final = 1e-9
"""Of what it computes in double precision."""
_NAN: Final = "nan"


class NcapArrays(GoldenArrays):
    """Arrays of one file."""

    def plans(self, name: str, counts: list[int]) -> list[Floats]:
        """Plans in single precision, padded to the longest.

        Args:
            name: Array of (S, N, 2).
            counts: Waypoints of each.

        Returns:
            S plans of their own lengths.

        Raises:
            InputError: If there are fewer waypoints than counted, or they are not finite.
        """
        padded = self._taken(name, "f", "numbers", (len(counts), None, 2))
        plans = [np.asarray(plan[:count], np.float64) for plan, count in zip(padded, counts)]
        if any(not 1 <= count <= padded.shape[1] for count in counts):
            raise InputError(f"{self.path} counts waypoints that {name} does not have; fetch or make the file again")
        if not all(np.isfinite(plan).all() for plan in plans):
            raise InputError(f"array {name} in {self.path} has NaN or infinity in a plan; fetch or make the file again")
        return plans


class NcapFacts(GoldenFacts):
    """An object of a JSON file, in which NaN is the word ``nan``."""

    def number_or_nan(self, name: str) -> float:
        """A number or NaN."""
        return float("nan") if self._taken(name) == _NAN else self.number(name)

    def table(self, name: str) -> Mapping[str, Any]:
        """An object as it is, with NaN for the word."""
        value = self._taken(name)
        if not isinstance(value, dict):
            raise self._wrong(self.path, f"{self.where} / {name}", "is no object with names")
        return dict(_with_nan(value))

    def rows(self, name: str) -> list[Any]:
        """A list as it is."""
        value = self._taken(name)
        if not isinstance(value, list):
            raise self._wrong(self.path, f"{self.where} / {name}", "is no list")
        return value


def _with_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _with_nan(inner) for name, inner in value.items()}
    return float("nan") if value == _NAN else value


def beyond_single(ours: Floats, golden: Floats) -> Floats:
    """Size of a difference of numbers that both were rounded to single precision, as far as rounding cannot make it."""
    step = np.spacing(np.abs(golden).astype(np.float32)).astype(np.float64)
    return np.asarray(np.maximum(np.abs(ours - golden) - step, 0.0))
