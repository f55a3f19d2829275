"""Files of a golden set of NeuroNCAP: what more they hold than other golden sets do."""

from typing import Any, Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.verification.golden import GoldenArrays

_NAN: Final = "nan"


def plans_of(stored: GoldenArrays, name: str, counts: list[int]) -> list[Floats]:
    """Plans of so many waypoints each, which are padded to the longest."""
    padded = stored.floats(name, len(counts), None, 2, gaps=True)
    plans = [plan[:count] for plan, count in zip(padded, counts)]
    if [len(plan) for plan in plans] != counts or not all(np.isfinite(plan).all() for plan in plans):
        raise ValueError(f"array {name} has fewer waypoints than counted, NaN or infinity in it")
    return plans


def with_nan(value: Any) -> Any:
    """Values of a JSON file, with NaN for the word ``nan``."""
    if isinstance(value, dict):
        return {name: with_nan(inner) for name, inner in value.items()}
    return float("nan") if value == _NAN else value


def beyond_single(ours: Floats, golden: Floats) -> Floats:
    """Size of a difference of numbers that both were rounded to single precision, as far as rounding cannot make it."""
    step = np.spacing(np.abs(golden).astype(np.float32)).astype(np.float64)
    return np.asarray(np.maximum(np.abs(ours - golden) - step, 0.0))
