"""How far apart two distributions of one quantity are."""

import numpy as np

from benchmark.geometry import Floats


def wasserstein(first: Floats, second: Floats) -> float:
    """1-Wasserstein distance of two samples of one quantity, by their quantiles, in the unit of the values."""
    at = (np.arange(2000) + 0.5) / 2000
    quantiles = [
        np.interp(at * (values.size - 1), np.arange(values.size), np.sort(values, axis=None))
        for values in (np.asarray(first), np.asarray(second))
    ]
    return float(np.abs(quantiles[0] - quantiles[1]).mean())
