"""Rates at 1, 2 and 3 s with 95 % intervals from resampling whole scenes.

Samples of one scene see the same traffic half a second apart, so the scene is what is drawn, never the sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Floats
from benchmark.protocols import CollisionProtocol, Outcomes
from benchmark.storage import content_seed

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
    weights = np.repeat(outcomes.counted[:, None].astype(float), len(HORIZONS), axis=1)
    columns: dict[str, dict[str, Rate]] = {}
    for column, values in definition.sample_values(outcomes).items():
        with_average = np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)
        found = ratios_over_scenes(with_average * weights, weights, scenes, seed=seed)
        columns[column] = dict(zip(HORIZONS, found))
    return columns


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
    names = sorted(set(scenes))
    row_of = {name: row for row, name in enumerate(names)}
    rows = np.array([row_of[name] for name in scenes], dtype=np.int64)
    # Sums of floats depend on their order; within a scene the order is that of the values themselves.
    order = np.lexsort((*values.T[::-1], rows)) if len(rows) else rows
    numerators, denominators = np.zeros((len(names), values.shape[1])), np.zeros((len(names), values.shape[1]))
    np.add.at(numerators, rows[order], values[order])
    np.add.at(denominators, rows[order], weights[order])
    low, high = _interval(numerators, denominators, names, seed)
    return [
        Rate(
            value=float(total / count) if count > 0 else None,
            numerator=float(total),
            denominator=round(float(count)),
            low=None if np.isnan(lower) else float(lower),
            high=None if np.isnan(upper) else float(upper),
        )
        for total, count, lower, upper in zip(numerators.sum(axis=0), denominators.sum(axis=0), low, high)
    ]


def _interval(numerators: Floats, denominators: Floats, names: Sequence[str], seed: int) -> tuple[Floats, Floats]:
    """Percentiles over resampled scenes for each column; NaN where fewer than two scenes have a denominator."""
    columns = numerators.shape[1]
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    if len(names) < 2:
        return low, high
    rng = np.random.default_rng(content_seed("scene bootstrap", list(names), seed))
    times_drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES).astype(np.float64)
    # einsum without optimisation adds in a fixed order; a BLAS product would depend on its threads.
    above = np.einsum("rs,sc->rc", times_drawn, numerators)
    below = np.einsum("rs,sc->rc", times_drawn, denominators)
    for column in range(columns):
        if np.count_nonzero(denominators[:, column]) < 2:
            continue
        drawn = below[:, column] > 0
        low[column], high[column] = np.percentile(above[drawn, column] / below[drawn, column], INTERVAL)
    return low, high
