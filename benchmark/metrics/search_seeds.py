"""A rate over splits that differ in the seed of their search alone: its spread, and what it rests on.

Recordings and seeds were both drawn. A search is seeded by recording, vehicle and seed, so what a seed does to one
recording says nothing of another: the chance of the search comes in once for each recording and seed. An interval over
recordings therefore holds that chance already, for one seed and for all of them together; the deviation over seeds, and
the interval over seeds, say what drawing the search again does on these very recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats
from benchmark.metrics.rates import INTERVAL, Rate, SceneSums, resample_totals

STUDENT_975: Final = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131, 2.120,
    2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
"""97.5 % points of Student's distribution with 1, 2, ... degrees of freedom; beyond the last the normal one's."""
_NORMAL_975: Final = 1.960


@dataclass(frozen=True, slots=True)
class SeedRate:
    """The rate on the split of one seed, with its interval over recordings."""

    seed: int
    rate: Rate


@dataclass(frozen=True, slots=True)
class SeedSpread:
    """One planner on the splits of several seeds.

    The interval of ``mean`` draws recordings, each with what all seeds made of it. ``deviation`` is that of the rates
    (n - 1), ``None`` with fewer than two; ``low`` to ``high`` is the 95 % interval of the mean over seeds alone: the
    recordings stay as they are.
    """

    seeds: tuple[SeedRate, ...]
    mean: Rate
    deviation: float | None
    low: float | None
    high: float | None
    recordings: int


def combine_seeds(sums: dict[int, SceneSums], *, seed: int = 0) -> SeedSpread:
    """Put the rates of several seeds of the search together, given as (N, 1) sums by recording."""
    order = sorted(sums)
    names = tuple(sorted({name for one in sums.values() for name in one.names}))
    sides = [sums[seed_rates].over(names) for seed_rates in order]
    above = np.hstack([side.numerators for side in sides])
    below = np.hstack([side.denominators for side in sides])
    drawn = _ratios(resample_totals(above, names, seed=seed), resample_totals(below, names, seed=seed))
    values = _ratios(above.sum(axis=0), below.sum(axis=0))
    seed_rates = tuple(
        SeedRate(which, _build_rate(values[place], above[:, place], below[:, place], drawn[:, place]))
        for place, which in enumerate(order)
    )
    known = values[np.isfinite(values)]
    mean = float(known.mean()) if len(known) else float("nan")
    deviation = float(known.std(ddof=1)) if len(known) > 1 else None
    half = None if deviation is None else student_975(len(known) - 1) * deviation / len(known) ** 0.5
    return SeedSpread(
        seeds=seed_rates,
        mean=_build_rate(mean, above, below, _average_seeds(drawn)),
        deviation=deviation,
        low=None if half is None else max(mean - half, 0.0),
        high=None if half is None else min(mean + half, 1.0),
        recordings=len(names),
    )


def student_975(freedom: int) -> float:
    """97.5 % point of Student's distribution with ``freedom`` degrees of freedom; of the normal one from 31 on."""
    return STUDENT_975[freedom - 1] if freedom <= len(STUDENT_975) else _NORMAL_975


def _build_rate(value: Floats | float, above: Floats, below: Floats, drawn: Floats) -> Rate:
    """A rate with its interval over the recordings that have counted samples, if there are two of them."""
    known = drawn[np.isfinite(drawn)]
    with_samples = np.count_nonzero(np.atleast_2d(below.T).sum(axis=0))
    low, high = np.percentile(known, INTERVAL) if with_samples > 1 and len(known) else (None, None)
    return Rate(
        value=float(value) if np.isfinite(value) else None,
        numerator=float(above.sum()),
        denominator=round(float(below.sum())),
        low=None if low is None else float(low),
        high=None if high is None else float(high),
    )


def _ratios(above: Floats, below: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(above / below)


def _average_seeds(drawn: Floats) -> Floats:
    """(R,) mean over the seeds that have samples in a resample."""
    there = np.isfinite(drawn)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(there, drawn, 0.0).sum(axis=1) / there.sum(axis=1))


def format_seeds(seeds: Sequence[int]) -> str:
    """Seeds for a sentence: ``0, 1, 2``."""
    return ", ".join(map(str, sorted(seeds)))
