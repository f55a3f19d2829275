"""How often the interval of the paired effect holds the true difference, by simulation (docs/metrics.md).

Recordings have one to three adversarial variants and 24 to 40 samples. Contacts are runs of consecutive samples, as
those of real plans are: on the unchanged recording with a bystander, on a variant with its adversary besides, or no
longer. How likely a variant is to touch varies between recordings. The project's own function gives the intervals;
the percentile bootstrap over recordings stands beside it. Two minutes on one core.

    python bench/effect_coverage.py [--data-sets 10000]
"""

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.geometry import Bools, Floats
from benchmark.metrics.paired_interval import paired_difference
from benchmark.report.table import table_of

RECORDINGS = (5, 7, 10, 30, 150)
RESAMPLES = 999
BOOTSTRAPPED = 1000
"""Data sets of which the bootstrap is made too."""
MOST_SAMPLES, MOST_VARIANTS = 40, 3
_AT_ONCE = 100_000
"""Recordings in memory."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """How often contacts come and go.

    Attributes:
        name: For the table.
        hit: Mean probability that a variant's adversary is touched.
        spread: How much that differs between recordings: 0 not at all, towards 1 always or never.
        bystander: Probability that the unchanged recording has a contact.
        lost: Probability that a variant loses it.
    """

    name: str
    hit: float
    spread: float
    bystander: float
    lost: float

    def recordings(self, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
        """(N,) sums of each recording's differences, each variant's share alike, and (N,) its samples."""
        samples, variants = rng.integers(24, MOST_SAMPLES + 1, count), rng.integers(1, MOST_VARIANTS + 1, count)
        weight = 1.0 / self.spread - 1.0
        hit = rng.beta(self.hit * weight, (1.0 - self.hit) * weight, count)
        unchanged = _contacts(rng, samples, np.full(count, self.bystander))[:, None]
        shape = count, MOST_VARIANTS
        kept = unchanged & (rng.random(shape) >= self.lost)[..., None]
        touched = _contacts(rng, np.broadcast_to(samples[:, None], shape), np.broadcast_to(hit[:, None], shape))
        differences = (kept | touched).sum(axis=2) - unchanged.sum(axis=2)
        there = np.arange(MOST_VARIANTS) < variants[:, None]
        return (differences * there).sum(axis=1) / variants, samples.astype(np.float64)


def _contacts(rng: np.random.Generator, samples: NDArray[np.int64], probability: Floats) -> Bools:
    """(..., MOST_SAMPLES) one run of samples or none, of so many samples each."""
    length = rng.integers(1, 11, samples.shape)
    start = rng.integers(0, samples - length + 1)
    there = rng.random(samples.shape) < probability
    place = np.arange(MOST_SAMPLES)
    return np.asarray(there[..., None] & (place >= start[..., None]) & (place < (start + length)[..., None]), np.bool_)


TRAFFIC = (
    Traffic("strong", 0.8, 0.2, 0.3, 0.1),
    Traffic("as on mini-adv-3", 0.5, 0.3, 0.3, 0.1),
    Traffic("rare", 0.12, 0.3, 0.3, 0.05),
    Traffic("very rare", 0.04, 0.3, 0.2, 0.02),
    Traffic("both ways, hardly a difference", 0.1, 0.3, 0.4, 0.16),
)
FURTHER = tuple(
    Traffic(f"{hit}, {spread}, {bystander}", hit, spread, bystander, 0.08)
    for hit, spread, bystander in itertools.product((0.08, 0.25, 0.4, 0.65), (0.1, 0.5), (0.1, 0.3))
)
"""Of which the extremes are said."""
FEWEST_GIVEN = 0.1
"""Where a smaller share of data sets gets an interval, these are too few and too particular to speak of coverage."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of data sets.

    Attributes:
        given: With an interval.
        holds: Of those, intervals that hold the true difference.
        bootstrap: Percentile bootstraps of the first data sets, of any, that hold it.
    """

    given: float
    holds: float
    bootstrap: float


def coverage(traffic: Traffic, recordings: int, data_sets: int, truth: float) -> Coverage:
    """Coverage of the true difference."""
    rng = np.random.default_rng([recordings, round(1000 * traffic.hit)])
    sums, weights = (part.reshape(data_sets, recordings) for part in _many(traffic, rng, data_sets * recordings))
    found = [paired_difference(*data_set) for data_set in zip(sums, weights, strict=True)]
    held = [one.low <= truth <= one.high for one in found if one.low is not None and one.high is not None]
    bootstrap = []
    for own, weight in zip(sums[:BOOTSTRAPPED], weights[:BOOTSTRAPPED], strict=True):
        drawn = rng.integers(0, recordings, (RESAMPLES, recordings))
        low, high = np.percentile(own[drawn].sum(axis=1) / weight[drawn].sum(axis=1), (2.5, 97.5))
        bootstrap.append(low <= truth <= high)
    return Coverage(len(held) / data_sets, float(np.mean(held)) if held else np.nan, float(np.mean(bootstrap)))


def true_difference(traffic: Traffic) -> float:
    """The difference over half a million recordings."""
    sums, weights = _many(traffic, np.random.default_rng(0), 500_000)
    return float(sums.sum() / weights.sum())


def _many(traffic: Traffic, rng: np.random.Generator, count: int) -> tuple[Floats, Floats]:
    parts = [traffic.recordings(rng, min(_AT_ONCE, count - start)) for start in range(0, count, _AT_ONCE)]
    return np.concatenate([sums for sums, _ in parts]), np.concatenate([weights for _, weights in parts])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=10_000, help="Made up for each number.")
    count = parser.parse_args(arguments).data_sets
    rows = []
    for traffic in TRAFFIC:
        truth = true_difference(traffic)
        for recordings in RECORDINGS:
            found = coverage(traffic, recordings, count, truth)
            shown = "-" if np.isnan(found.holds) else f"{100 * found.holds:.1f} %"
            shares = f"{100 * found.given:.0f} %", shown, f"{100 * found.bootstrap:.1f} %"
            rows.append((traffic.name, f"{100 * truth:.2f}", str(recordings), *shares))
    heads = ("traffic", "true difference, points", "recordings", "interval given", "it holds", "plain bootstrap holds")
    print(table_of("", "95 % interval of the paired effect", heads, rows).markdown())
    further = [
        coverage(traffic, recordings, count // 2, true_difference(traffic))
        for traffic in FURTHER
        for recordings in RECORDINGS[:-1]
    ]
    held = [100 * one.holds for one in further if one.given >= FEWEST_GIVEN]
    print(
        f"{len(FURTHER)} further kinds of traffic: {min(held):.1f} to {max(held):.1f} % hold, "
        f"{sum(share <= 97.0 for share in held)} of {len(held)} cells at most 97 %."
    )


if __name__ == "__main__":
    main()
