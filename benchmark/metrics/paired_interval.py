"""The 95 % interval of a paired difference over recordings.

What varies is the recording, drawn with all its variants. Over few recordings the percentile bootstrap is too narrow
(`bench/effect_coverage.py`: 85 % of intervals over five to seven recordings hold the true difference), so the interval
is the t-based one of a ratio of sums over clusters: linearised residuals of each recording, n - 1 degrees of freedom.
Where hardly any recording differs nothing can be said of how much recordings vary, and there is no interval.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats

FEWEST_RECORDINGS: Final = 5
FEWEST_DIFFERING: Final = 4
"""Recordings whose two sides differ; with fewer the intervals hold less than they promise."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """A weighted mean difference between two sides of the same recordings.

    Attributes:
        value: The difference, or ``None`` without a pair.
        low: Lower end of its 95 % interval, or ``None`` where too few recordings say how much they vary.
        high: Upper end.
        recordings: Recordings with pairs.
        differing: Those of them whose two sides differ.
        enough: Recordings that would give an interval if as many of them differed as here; ``None`` where there is one
            already, or where none differs.
    """

    value: float | None
    low: float | None
    high: float | None
    recordings: int
    differing: int
    enough: int | None


def paired_difference(differences: Floats, weights: Floats) -> PairedDifference:
    """The difference and its interval.

    Args:
        differences: (N,) weighted sums of the differences of each recording's pairs.
        weights: (N,) sums of their weights, all above zero.

    Returns:
        The difference of the ratio of both sums.
    """
    count, differing = len(weights), int(np.count_nonzero(np.abs(differences) > 1e-12))
    if not count:
        return PairedDifference(None, None, None, 0, 0, None)
    total = float(weights.sum())
    value = float(differences.sum()) / total
    if count < FEWEST_RECORDINGS or differing < FEWEST_DIFFERING:
        enough = None if not differing else max(FEWEST_RECORDINGS, math.ceil(FEWEST_DIFFERING * count / differing))
        # As many as there are, of which too few differ, are not enough either.
        return PairedDifference(value, None, None, count, differing, enough and max(enough, count + 1))
    # scipy takes a second to import, and whoever only plans needs none of it.
    from scipy import stats

    residuals = differences - value * weights
    deviation = math.sqrt(count / (count - 1) * float((residuals**2).sum())) / total
    reach = float(stats.t.ppf(0.975, count - 1)) * deviation
    return PairedDifference(value, max(value - reach, -1.0), min(value + reach, 1.0), count, differing, None)
