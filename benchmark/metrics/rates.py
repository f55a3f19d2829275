"""Rates at 1, 2 and 3 s with 95 % intervals from resampling whole scenes.

Samples of one scene see the same traffic half a second apart, so the scene is what is drawn, never the sample. Where
scenes were made from one recording, their caller may name that instead: what is drawn here is whatever is named.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.protocols import CollisionProtocol, Outcomes

RESAMPLES = 2000
INTERVAL = (2.5, 97.5)
"""Percentiles of the interval."""
HORIZONS = (*HORIZON_STEPS, "avg")
"""Columns of every table; ``avg`` is the mean of the three."""


@dataclass(frozen=True, slots=True)
class Rate:
    """A ratio of sums over samples.

    Attributes:
        value: The ratio, or ``None`` where the denominator is zero.
        numerator: Sum over the samples.
        denominator: Number of samples.
        low: Lower end of the 95 % interval over scenes, or ``None`` where fewer than two scenes count.
        high: Upper end.
    """

    value: float | None
    numerator: float
    denominator: int
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number made of rates.

    Attributes:
        value: The number, or ``None`` where it does not exist.
        low: Lower end of the 95 % interval, or ``None`` where there is none.
        high: Upper end; may be infinite.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class SceneSums:
    """What each scene adds to the two sums of a rate.

    Attributes:
        names: N names of what is drawn together, sorted.
        numerators: (N, C).
        denominators: (N, C).
    """

    names: tuple[str, ...]
    numerators: Floats
    denominators: Floats

    def over(self, names: Sequence[str]) -> "SceneSums":
        """The same sums over other names: zero for those that are not here, gone for those not asked for.

        Args:
            names: N names.

        Returns:
            Sums over them.
        """
        row_of = {name: row for row, name in enumerate(self.names)}
        found = [(row, row_of[name]) for row, name in enumerate(names) if name in row_of]
        to, of = [row for row, _ in found], [row for _, row in found]
        shape = (len(names), self.numerators.shape[1])
        numerators, denominators = np.zeros(shape), np.zeros(shape)
        numerators[to], denominators[to] = self.numerators[of], self.denominators[of]
        return SceneSums(tuple(names), numerators, denominators)


def rates(
    definition: CollisionProtocol, outcomes: Outcomes, scenes: Sequence[str], *, seed: int = 0
) -> dict[str, dict[str, Rate]]:
    """Every published number of a protocol.

    Args:
        definition: The protocol.
        outcomes: Its verdicts on S samples.
        scenes: S scene names; samples of one scene are resampled together.
        seed: Seed of the resampling.

    Returns:
        Column name (``collision``, ``l2``, ...) to horizon (``1s``, ``2s``, ``3s``, ``avg``) to rate.
    """
    columns: dict[str, dict[str, Rate]] = {}
    for column, by_horizon in definition.sample_values(outcomes).items():
        values = with_average(by_horizon)
        said = ~np.isnan(values)
        weights = np.where(said, outcomes.counted[:, None], False).astype(np.float64)
        found = ratios_over_scenes(np.where(said, values, 0.0) * weights, weights, scenes, seed=seed)
        columns[column] = dict(zip(HORIZONS, found))
    return columns


def with_average(values: Floats) -> Floats:
    """Values at the three horizons and their mean.

    Args:
        values: (S, 3) at 1, 2 and 3 s.

    Returns:
        (S, 4) in the order of ``HORIZONS``.
    """
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def ratios_over_scenes(values: Floats, weights: Floats, scenes: Sequence[str], *, seed: int) -> list[Rate]:
    """Ratios of sums over samples, with intervals over scenes.

    Args:
        values: (S, C) what each sample adds to each numerator.
        weights: (S, C) what each sample adds to each denominator.
        scenes: S scene names.
        seed: Seed of the resampling; the same seed and scenes draw the same resamples for every column and planner,
            so that differences between planners can be paired.

    Returns:
        C rates. The order of the samples does not matter.
    """
    sums = sums_by_scene(values, weights, scenes)
    low, high = _interval(sums, seed)
    return [
        Rate(
            value=float(total / count) if count > 0 else None,
            numerator=float(total),
            denominator=round(float(count)),
            low=None if np.isnan(lower) else float(lower),
            high=None if np.isnan(upper) else float(upper),
        )
        for total, count, lower, upper in zip(sums.numerators.sum(axis=0), sums.denominators.sum(axis=0), low, high)
    ]


def sums_by_scene(values: Floats, weights: Floats, scenes: Sequence[str]) -> SceneSums:
    """Add samples up by scene.

    Args:
        values: (S, C) what each sample adds to each numerator.
        weights: (S, C) what each sample adds to each denominator.
        scenes: S names of what is drawn together.

    Returns:
        The sums; the order of the samples does not matter.
    """
    names = sorted(set(scenes))
    row_of = {name: row for row, name in enumerate(names)}
    rows = np.array([row_of[name] for name in scenes], dtype=np.int64)
    # Sums of floats depend on their order; within a scene the order is that of the values themselves.
    order = np.lexsort((*values.T[::-1], rows)) if len(rows) else rows
    numerators, denominators = np.zeros((len(names), values.shape[1])), np.zeros((len(names), values.shape[1]))
    np.add.at(numerators, rows[order], values[order])
    np.add.at(denominators, rows[order], weights[order])
    return SceneSums(tuple(names), numerators, denominators)


def resampled(sums: Floats, names: tuple[str, ...], *, seed: int) -> Floats:
    """Totals over resampled scenes; the same names and seed draw the same scenes.

    Args:
        sums: (N, C) what each scene adds.
        names: N names.
        seed: Seed of the resampling.

    Returns:
        (2000, C) totals.
    """
    # einsum without optimisation adds in a fixed order; a BLAS product would depend on its threads.
    return np.asarray(np.einsum("rs,sc->rc", _times_drawn(names, seed), sums))


def ends(draws: Floats, bounds: tuple[float, float]) -> tuple[float, float]:
    """The 95 % interval of a number that need not exist in every resample.

    Args:
        draws: (R,) the number in each resample; NaN where it does not exist, possibly infinite.
        bounds: Between what it lies. A resample in which it does not exist could have been anything, so that it
            counts as the lower bound for the lower end and as the upper bound for the upper one.

    Returns:
        Lower and upper end, both of them numbers that were drawn, or bounds.
    """
    low, high = (np.sort(np.where(np.isnan(draws), bound, draws)) for bound in bounds)
    last = (len(draws) - 1) / 100
    return float(low[math.floor(INTERVAL[0] * last)]), float(high[math.ceil(INTERVAL[1] * last)])


@functools.lru_cache(maxsize=32)
def _times_drawn(names: tuple[str, ...], seed: int) -> Floats:
    """(2000, N) how often each scene is in each resample."""
    rng = np.random.default_rng(content_seed("scene bootstrap", list(names), seed))
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES).astype(np.float64)
    drawn.setflags(write=False)
    return drawn


def _interval(sums: SceneSums, seed: int) -> tuple[Floats, Floats]:
    """Percentiles over resampled scenes for each column; NaN where fewer than two scenes have a denominator."""
    columns = sums.numerators.shape[1]
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    if len(sums.names) < 2:
        return low, high
    above = resampled(sums.numerators, sums.names, seed=seed)
    below = resampled(sums.denominators, sums.names, seed=seed)
    known = np.count_nonzero(sums.denominators, axis=0) >= 2
    always = known & (below > 0).all(axis=0)
    if always.any():
        low[always], high[always] = np.percentile(above[:, always] / below[:, always], INTERVAL, axis=0)
    for column in np.flatnonzero(known & ~always).tolist():
        drawn = below[:, column] > 0
        low[column], high[column] = np.percentile(above[drawn, column] / below[drawn, column], INTERVAL)
    return low, high
