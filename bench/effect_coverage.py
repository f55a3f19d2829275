"""How often the interval of the paired effect holds the true difference, by simulation (docs/metrics.md).

Recordings have one to three adversarial variants and 24 to 40 samples. Contacts are runs of consecutive samples, as
those of real plans are: on the unchanged recording with a bystander, on a variant with its adversary besides, or no
longer. How likely a variant is to touch varies between recordings. The project's own function gives the intervals;
the percentile bootstrap over recordings stands beside it.

    python bench/effect_coverage.py [--data-sets 1000]
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmark.geometry import Floats
from benchmark.metrics.paired_interval import paired_difference
from benchmark.report.table import table_of

RECORDINGS = (5, 7, 10, 30, 150)
RESAMPLES = 999


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

    def recording(self, rng: np.random.Generator) -> tuple[float, int]:
        """Sum of a recording's differences, each variant's share alike, and its samples."""
        samples, variants = int(rng.integers(24, 41)), int(rng.integers(1, 4))
        weight = 1.0 / self.spread - 1.0
        hit = rng.beta(self.hit * weight, (1.0 - self.hit) * weight)
        unchanged = _contacts(rng, samples, self.bystander)
        total = 0.0
        for _ in range(variants):
            changed = np.zeros(samples) if rng.random() < self.lost else unchanged
            total += float((np.maximum(changed, _contacts(rng, samples, hit)) - unchanged).sum()) / variants
        return total, samples


def _contacts(rng: np.random.Generator, samples: int, probability: float) -> Floats:
    found = np.zeros(samples)
    if rng.random() < probability:
        length = int(rng.integers(1, 11))
        start = int(rng.integers(0, samples - length + 1))
        found[start : start + length] = 1.0
    return found


TRAFFIC = (
    Traffic("strong", 0.8, 0.2, 0.3, 0.1),
    Traffic("as on mini-adv-3", 0.5, 0.3, 0.3, 0.1),
    Traffic("rare", 0.12, 0.3, 0.3, 0.05),
    Traffic("very rare", 0.04, 0.3, 0.2, 0.02),
    Traffic("both ways, no difference", 0.1, 0.3, 0.4, 0.16),
)


@dataclass(frozen=True, slots=True)
class Coverage:
    """Shares of data sets.

    Attributes:
        given: With an interval.
        holds: Of those, intervals that hold the true difference.
        bootstrap: Percentile bootstraps of all data sets that hold it.
    """

    given: float
    holds: float
    bootstrap: float


def coverage(traffic: Traffic, recordings: int, data_sets: int, truth: float) -> Coverage:
    """Coverage of the true difference."""
    rng = np.random.default_rng([recordings, round(1000 * traffic.hit)])
    given, holds, bootstrap = 0, 0, 0
    for _ in range(data_sets):
        sums = np.array([traffic.recording(rng) for _ in range(recordings)])
        found = paired_difference(sums[:, 0], sums[:, 1])
        if found.low is not None and found.high is not None:
            given += 1
            holds += found.low <= truth <= found.high
        drawn = sums[rng.integers(0, recordings, (RESAMPLES, recordings))].sum(axis=1)
        low, high = np.percentile(drawn[:, 0] / drawn[:, 1], (2.5, 97.5))
        bootstrap += low <= truth <= high
    return Coverage(given / data_sets, holds / given if given else np.nan, bootstrap / data_sets)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=1000, help="Made up for each number.")
    count = parser.parse_args(arguments).data_sets
    rows = []
    for traffic in TRAFFIC:
        rng = np.random.default_rng(0)
        many = np.array([traffic.recording(rng) for _ in range(100_000)]).sum(axis=0)
        truth = float(many[0] / many[1])
        for recordings in RECORDINGS:
            found = coverage(traffic, recordings, count, truth)
            shown = "-" if np.isnan(found.holds) else f"{100 * found.holds:.1f} %"
            shares = f"{100 * found.given:.0f} %", shown, f"{100 * found.bootstrap:.1f} %"
            rows.append((traffic.name, f"{100 * truth:.2f}", str(recordings), *shares))
    heads = ("traffic", "true difference, points", "recordings", "interval given", "it holds", "plain bootstrap holds")
    print(table_of("", "95 % interval of the paired effect", heads, rows).markdown())


if __name__ == "__main__":
    main()
