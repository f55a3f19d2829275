"""How far two samples of a feature are apart: Wasserstein-1, and Jensen-Shannon divergences over two kinds of bins.

``docs/realism.md``, "Divergences". Bins between the quantiles of the recordings see what bins of equal width are blind
to: annotation noise stretches the range of recorded accelerations so far that nearly everything falls into three bins.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats

QUANTILES: Final = np.arange(1, 20) * 0.05
BINS: Final = 20
_RANGE: Final = (0.001, 0.999)
_NARROWEST: Final = 1e-9
_PSEUDO_COUNT: Final = 0.5

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Histograms:
    """Counts of a sample and of the recordings in the same bins; edges are the inner ones, or the range's two ends."""

    edges: Floats
    counts: Integers
    reference: Integers

    @property
    def divergence(self) -> float:
        """Jensen-Shannon divergence to the base 2, after half a count more in each bin; 0 to 1."""
        first, second = (
            (counts + _PSEUDO_COUNT) / (counts + _PSEUDO_COUNT).sum() for counts in (self.counts, self.reference)
        )
        middle = 0.5 * (first + second)
        bits = first * np.log2(first / middle) + second * np.log2(second / middle)
        return float(0.5 * bits.sum())


def w1(sample: Floats, reference: Floats) -> float:
    """Wasserstein-1 distance of raw samples, at least one each, in the unit of the feature."""
    from scipy.stats import wasserstein_distance

    return float(wasserstein_distance(sample, reference))


def quantile_bins(sample: Floats, reference: Floats) -> Histograms:
    """Bins between the distinct 5 % quantiles of the reference; the two outer ones are open."""
    edges = np.unique(np.quantile(reference, QUANTILES))
    counts, theirs = (
        np.bincount(np.searchsorted(edges, values, side="right"), minlength=len(edges) + 1)
        for values in (sample, reference)
    )
    return Histograms(edges, counts, theirs)


def equal_bins(sample: Floats, reference: Floats) -> Histograms:
    """20 bins of equal width over the middle 99.8 % of the reference; what is outside counts in the last ones."""
    low, high = np.quantile(reference, _RANGE).tolist()
    if high - low < _NARROWEST:
        low, high = low - 0.5, high + 0.5
    counts, theirs = (
        np.histogram(np.clip(values, low, high), bins=BINS, range=(low, high))[0] for values in (sample, reference)
    )
    return Histograms(np.array([low, high]), counts, theirs)
