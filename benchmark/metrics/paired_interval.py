"""The 95 % interval of a paired difference over recordings.

What varies is the recording, drawn with all its variants. Over few recordings the percentile bootstrap is too narrow
(`docs/studies/intervals.md`: at 5 to 7 recordings at most 89 % of its intervals hold the true difference), so the
interval is the t-based one of a ratio of sums over clusters: linearised residuals of each recording, n - 1 degrees of
freedom. Where hardly any recording differs nothing can be said of how much recordings vary, and there is no interval.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats

FEWEST_RECORDINGS: Final = 5
FEWEST_DIFFERING: Final = 4
"""Recordings whose two sides differ, of fewer than ten: all of five, if asked for, are only the data sets in which the
adversaries happened to do much, and their intervals hold too seldom (90 % rather than 95 %)."""
FEWEST_DIFFERING_OF_TEN: Final = 5
"""The same of ten recordings and more: intervals of only four that differ hold nearly always and say nothing."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """Weighted mean difference between two sides of the same recordings.

    Attributes:
        value: The difference, or ``None`` without a pair.
        low: Lower end of its 95 % interval, or ``None`` where too few recordings say how much they vary.
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
    """The ratio of both sums, and its interval.

    Args:
        differences: (N,) weighted sums of the differences of each recording's pairs.
        weights: (N,) sums of their weights, all above zero.
    """
    count, differing = len(weights), int(np.count_nonzero(np.abs(differences) > 1e-12))
    if not count:
        return PairedDifference(None, None, None, 0, 0, None)
    total = float(weights.sum())
    value = float(differences.sum()) / total
    if count < FEWEST_RECORDINGS or differing < fewest_differing(count):
        return PairedDifference(value, None, None, count, differing, _enough(count, differing))
    # scipy takes a second to import, and whoever only plans needs none of it.
    from scipy import stats

    residuals = differences - value * weights
    deviation = math.sqrt(count / (count - 1) * float((residuals**2).sum())) / total
    reach = float(stats.t.ppf(0.975, count - 1)) * deviation
    return PairedDifference(value, max(value - reach, -1.0), min(value + reach, 1.0), count, differing, None)


def fewest_differing(recordings: int) -> int:
    """How many of so many recordings must differ between their two sides for an interval."""
    return FEWEST_DIFFERING if recordings < 10 else FEWEST_DIFFERING_OF_TEN


def _enough(count: int, differing: int) -> int | None:
    """The least number of recordings above ``count`` that gives an interval if the same share of them differs."""
    if not differing:
        return None
    # All of ten recordings or more ask for the same, so that the search ends.
    number = max(FEWEST_RECORDINGS, count + 1)
    while number * differing < fewest_differing(number) * count:
        number += 1
    return number
