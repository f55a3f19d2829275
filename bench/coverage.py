"""How often 95 % intervals hold what they are about, by simulation: the tables of docs/metrics.md.

Data sets are made up whose true rates are known, and the project's own functions give the intervals. One scene has 34
samples; a scene of rate q collides on each with probability q. How different scenes are is a Beta distribution of q
whose mean is the true rate.

    python bench/coverage.py [--data-sets 2000]
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats
from benchmark.metrics.drawn_seeds import over_seeds
from benchmark.metrics.rates import SceneSums, ratios_over_scenes
from benchmark.report.table import table_of

SAMPLES = 34
SCENES = (5, 10, 20, 45, 150)


@dataclass(frozen=True, slots=True)
class Difficulty:
    """How rates differ between scenes.

    Attributes:
        name: For the table.
        rate: The true rate.
        spread: Share of the largest variance that a mean allows: 0, all scenes are alike; 1, each collides always or
            never.
        hard: Share of scenes that collide at all.
    """

    name: str
    rate: float
    spread: float
    hard: float = 1.0

    def drawn(self, rng: np.random.Generator, count: int) -> Floats:
        """(count,) rates of scenes."""
        mean, weight = self.rate / self.hard, 1.0 / self.spread - 1.0
        rates = rng.beta(mean * weight, (1.0 - mean) * weight, count)
        return np.asarray(np.where(rng.random(count) < self.hard, rates, 0.0))


DIFFICULTIES = (
    Difficulty("17 %", 0.17, 0.3),
    Difficulty("5 %", 0.05, 0.3),
    Difficulty("1 %, in a tenth of the scenes", 0.01, 0.3, hard=0.1),
    Difficulty("0.3 %, in a tenth of the scenes", 0.003, 0.3, hard=0.1),
)


def coverage_over_scenes(difficulty: Difficulty, scenes: int, data_sets: int) -> float:
    """Share of data sets whose interval over scenes holds the true rate; no interval holds nothing."""
    rng = np.random.default_rng([scenes, round(1e6 * difficulty.rate)])
    names = [f"scene-{number:04d}" for number in range(scenes) for _ in range(SAMPLES)]
    held = 0
    for _ in range(data_sets):
        rates = np.repeat(difficulty.drawn(rng, scenes), SAMPLES)
        values = (rng.random(len(rates)) < rates).astype(np.float64)[:, None]
        (found,) = ratios_over_scenes(values, np.ones_like(values), names, seed=0)
        held += found.low is not None and found.high is not None and found.low <= difficulty.rate <= found.high
    return held / data_sets


@dataclass(frozen=True, slots=True)
class SeedCoverage:
    """Shares of data sets whose intervals hold what is asked.

    Attributes:
        one_seed: Over recordings, of one seed: the rate of all recordings and seeds.
        all_seeds: Over recordings, of the mean of the seeds: the same.
        over_seeds: Over seeds: the same, which it is not about.
        these: Over seeds: the rate that endless seeds would give on these recordings.
        deviation: Mean deviation over seeds.
    """

    one_seed: float
    all_seeds: float
    over_seeds: float
    these: float
    deviation: float


def coverage_over_seeds(
    difficulty: Difficulty, seed_spread: float, recordings: int, seeds: int, data_sets: int
) -> SeedCoverage:
    """Coverage where every seed makes other scenes of the same recordings.

    Args:
        difficulty: Of recordings.
        seed_spread: How different the scenes of one recording are, as `Difficulty.spread`.
        recordings: How many.
        seeds: How many.
        data_sets: To make up.

    Returns:
        The shares. A seed makes none to three scenes of a recording, one and a half in the mean.
    """
    rng = np.random.default_rng([recordings, seeds, round(1e6 * difficulty.rate), round(1e6 * seed_spread)])
    names = tuple(f"scene-{number:04d}" for number in range(recordings))
    held, deviations = np.zeros(4), []
    for _ in range(data_sets):
        hard = np.clip(difficulty.drawn(rng, recordings), 1e-9, 1.0 - 1e-9)
        sums = {seed: _one_seed(rng, hard, seed_spread, names) for seed in range(seeds)}
        found = over_seeds(sums)
        ends = (found.seeds[0].rate, found.mean)
        spread = (found.low, found.high)
        held += [
            *(_holds(rate.low, rate.high, difficulty.rate) for rate in ends),
            _holds(*spread, difficulty.rate),
            _holds(*spread, float(hard.mean())),
        ]
        deviations.append(found.deviation or 0.0)
    shares = held / data_sets
    one_seed, all_seeds, over, these = map(float, shares)
    return SeedCoverage(one_seed, all_seeds, over, these, float(np.mean(deviations)))


def _one_seed(rng: np.random.Generator, hard: Floats, spread: float, names: tuple[str, ...]) -> SceneSums:
    weight = 1.0 / spread - 1.0
    scenes = rng.binomial(3, 0.5, len(hard))
    collisions = np.zeros(len(hard))
    for place in range(3):
        rates = rng.beta(hard * weight, (1.0 - hard) * weight)
        collisions += np.where(scenes > place, rng.binomial(SAMPLES, rates), 0)
    return SceneSums(names, collisions[:, None], (SAMPLES * scenes)[:, None].astype(np.float64))


def _holds(low: float | None, high: float | None, value: float) -> bool:
    return low is not None and high is not None and low <= value <= high


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data-sets", type=int, default=200, help="Made up for each number.")
    count = parser.parse_args(arguments).data_sets

    def percent(share: float) -> str:
        return f"{100 * share:.0f} %"

    rows = [
        (each.name, *(percent(coverage_over_scenes(each, scenes, count)) for scenes in SCENES)) for each in DIFFICULTIES
    ]
    heads = ("true rate", *(f"{scenes} scenes" for scenes in SCENES))
    print(table_of("", "interval over scenes holds the true rate", heads, rows).markdown())
    rows = []
    for recordings, seeds in ((10, 3), (20, 3), (45, 3), (150, 3), (45, 2), (45, 5), (45, 10)):
        for spread in (0.1, 0.5):
            one = coverage_over_seeds(Difficulty("", 0.1, 0.3), spread, recordings, seeds, count)
            shares = (one.one_seed, one.all_seeds, one.over_seeds, one.these)
            shown = (*map(percent, shares), f"{100 * one.deviation:.1f}")
            rows.append((str(recordings), str(seeds), {0.1: "alike", 0.5: "unlike"}[spread], *shown))
    heads = (
        "recordings", "seeds", "scenes of a recording", "over scenes, one seed", "over scenes, all seeds",
        "over seeds: the true rate", "over seeds: these recordings", "deviation, points",
    )  # fmt: skip
    print(table_of("", "several seeds, true rate 10 %", heads, rows, text_columns=3).markdown())


if __name__ == "__main__":
    main()
