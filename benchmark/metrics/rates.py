"""Rates at 1, 2 and 3 s, and paired differences over recordings, with 95 % intervals from resampling whole scenes.

Samples of one scene see the same traffic half a second apart, so the scene is what is drawn, never the sample. Where
scenes were made from one recording, the caller may pass recordings instead.
"""

import functools
import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import HORIZON_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.machine.storage import content_seed
from benchmark.protocols import CollisionProtocol, ProtocolOutcomes, compute_published_values

FEWEST_RECORDINGS: Final = 5
FEWEST_DIFFERING: Final = 4
"""Recordings whose two sides differ, of fewer than ten: all of five, if asked for, are only the data sets in which the
adversaries happened to do much, and their intervals hold too seldom (90 % rather than 95 %)."""
FEWEST_DIFFERING_OF_TEN: Final = 5
"""The same of ten recordings and more: intervals of only four that differ hold nearly always and say nothing."""


@dataclass(frozen=True, slots=True)
class PairedDifference:
    """Weighted mean difference between two sides of the same recordings.

    ``value`` is ``None`` without a pair, ``recordings`` is the number of pairs.

    ``low`` to ``high`` is its 95 % interval, ``None`` where too few recordings say how much they vary. ``differing``
    are recordings whose two sides differ; ``enough`` would give an interval if as many differed as here, ``None`` where
    there is one already, or where none differs.
    """

    value: float | None
    low: float | None
    high: float | None
    recordings: int
    differing: int
    enough: int | None


def compute_paired_difference(
    differences: Floats, weights: Floats, *, differs: Bools | None = None, most: float = 1.0
) -> PairedDifference:
    """The ratio of both sums, and its interval.

    ``differences`` are (N,) weighted sums over each recording's pairs, ``weights`` (N,) sums of their weights, all
    above zero. ``differs`` are (N,) recordings that count as differing, by default those whose difference is not zero;
    no difference is larger than ``most``.
    """
    differs = np.abs(differences) > 1e-12 if differs is None else differs
    count, differing = len(weights), int(np.count_nonzero(differs))
    if not count:
        return PairedDifference(None, None, None, 0, 0, None)
    total = float(weights.sum())
    value = float(differences.sum()) / total
    if count < FEWEST_RECORDINGS or differing < fewest_differing(count):
        return PairedDifference(value, None, None, count, differing, _count_enough_recordings(count, differing))
    # scipy takes a second to import, and planning does not need it.
    from scipy import stats

    residuals = differences - value * weights
    deviation = math.sqrt(count / (count - 1) * float((residuals**2).sum())) / total
    reach = float(stats.t.ppf(0.975, count - 1)) * deviation
    return PairedDifference(value, max(value - reach, -most), min(value + reach, most), count, differing, None)


def count_needed_recordings(difference: PairedDifference) -> int | None:
    """How many recordings would leave 0 out of the interval, if the difference and its spread stayed as they are.

    ``None`` where the interval leaves it out already, and where no number can be told: without a difference, or before
    there is an interval and nothing differs.
    """
    value, low, high = difference.value, difference.low, difference.high
    if value is None or low is None or high is None:
        return difference.enough
    if not value or low > 0.0 or high < 0.0:
        return None
    from scipy import stats

    # An end may be cut where no difference is larger.
    reach, count = max(value - low, high - value), difference.recordings
    spread = reach / float(stats.t.ppf(0.975, count - 1)) * math.sqrt(count)
    needed = max(count + 1, math.floor(float(stats.norm.ppf(0.975) * spread / value) ** 2))
    while float(stats.t.ppf(0.975, needed - 1)) * spread >= abs(value) * math.sqrt(needed):
        needed += 1
    return needed


def fewest_differing(recordings: int) -> int:
    """How many of so many recordings must differ between their two sides for an interval."""
    return FEWEST_DIFFERING if recordings < 10 else FEWEST_DIFFERING_OF_TEN


def _count_enough_recordings(count: int, differing: int) -> int | None:
    """The least number of recordings above ``count`` that gives an interval if the same share of them differs."""
    if not differing:
        return None
    # Ten or more recordings all need the same number, so the search ends.
    number = max(FEWEST_RECORDINGS, count + 1)
    while number * differing < fewest_differing(number) * count:
        number += 1
    return number


RESAMPLES = 2000
INTERVAL = (2.5, 97.5)
"""Percentiles of the interval."""
_MAX_CACHED = 20_000
"""Intervals that are remembered of scenes that are drawn together."""
HORIZONS = (*HORIZON_STEPS, "avg")
"""Columns of every table; ``avg`` is the mean of the three."""


@dataclass(frozen=True, slots=True)
class Rate:
    """Ratio of sums over samples.

    ``value`` is ``None`` where the denominator is zero, the ends of the 95 % interval over scenes where fewer than two
    scenes count.

    Attributes:
        value: The ratio.
        numerator: Sum over the samples that count.
        denominator: How many count.
        low: Lower end of the interval.
        high: Upper end.
    """

    value: float | None
    numerator: float
    denominator: int
    low: float | None
    high: float | None


NO_RATE: Final = Rate(None, 0.0, 0, None, None)
"""Of nothing that is known."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Number made of rates, with a 95 % interval.

    ``value`` is ``None`` where it does not exist, the ends where there is no interval; ``high`` may be infinite.
    """

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class SceneSums:
    """Sums of numerators and denominators, (N, C) each, of each of N sorted names that are drawn together."""

    names: tuple[str, ...]
    numerators: Floats
    denominators: Floats

    def over(self, names: Sequence[str]) -> "SceneSums":
        """The same sums over other names: zero for those that are not here, gone for those not asked for."""
        if self.names == tuple(names):
            return self
        row_of = {name: row for row, name in enumerate(self.names)}
        row_pairs = [(row, row_of[name]) for row, name in enumerate(names) if name in row_of]
        to, of = [row for row, _ in row_pairs], [row for _, row in row_pairs]
        shape = (len(names), self.numerators.shape[1])
        numerators, denominators = np.zeros(shape), np.zeros(shape)
        numerators[to], denominators[to] = self.numerators[of], self.denominators[of]
        return SceneSums(tuple(names), numerators, denominators)


def rates(
    definition: CollisionProtocol, outcomes: ProtocolOutcomes, scenes: Sequence[str], *, seed: int = 0
) -> dict[str, dict[str, Rate]]:
    """Every published number of a protocol, from its verdicts on S samples: rates by column, then horizon.

    Columns are ``collision``, ``l2``, ..., horizons ``1s``, ``2s``, ``3s``, ``avg``. A sample that says nothing at a
    horizon (NaN) is in neither sum there; in those of the average where it does at all three. Samples of one scene are
    resampled together.
    """
    columns: dict[str, dict[str, Rate]] = {}
    for column, by_horizon in compute_published_values(definition, outcomes).items():
        values = append_average(by_horizon)
        is_known = ~np.isnan(values)
        weights = np.where(is_known, outcomes.counted[:, None], False).astype(np.float64)
        values, own = np.where(is_known, values, 0.0) * weights, scenes
        if outcomes.known is not None and not is_known.all():
            # A scene without annotated surroundings is not drawn either.
            rows = np.flatnonzero(is_known.any(axis=1)).tolist()
            values, weights, own = values[rows], weights[rows], [scenes[row] for row in rows]
        column_rates = compute_ratios_over_scenes(values, weights, own, seed=seed)
        columns[column] = dict(zip(HORIZONS, column_rates))
    return columns


def append_average(values: Floats) -> Floats:
    """(S, 3) values at 1, 2 and 3 s and their mean: (S, 4) in the order of ``HORIZONS``."""
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def compute_ratios_over_scenes(values: Floats, weights: Floats, scenes: Sequence[str], *, seed: int) -> list[Rate]:
    """Ratios of sums over samples, with intervals over scenes.

    ``values`` and ``weights`` are (S, C): what each sample adds to each numerator and denominator. The same seed and
    scenes draw the same resamples for every column and planner, so that differences between planners can be paired. The
    order of the samples does not matter.
    """
    return compute_ratios_of_sums(sum_by_scene(values, weights, scenes), seed=seed)


def compute_ratios_of_sums(sums: SceneSums, *, seed: int) -> list[Rate]:
    """`compute_ratios_over_scenes` of what was added up by scene."""
    low, high = _compute_intervals(sums, seed)
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


def sum_by_scene(values: Floats, weights: Floats, scenes: Sequence[str]) -> SceneSums:
    """Add (S, C) numerators and (S, C) denominators up by scene; the order of the samples does not matter."""
    names = sorted(set(scenes))
    row_of = {name: row for row, name in enumerate(names)}
    rows = np.array([row_of[name] for name in scenes], dtype=np.int64)
    # Sums of floats depend on their order; within a scene the order is that of the values themselves.
    order = np.lexsort((*values.T[::-1], rows)) if len(rows) else rows
    counts = np.bincount(rows, minlength=len(names))
    return SceneSums(tuple(names), _add_runs(values[order], counts), _add_runs(weights[order], counts))


def _add_runs(values: Floats, counts: NDArray[np.int64]) -> Floats:
    """(N, C) sums of runs of the (S, C) rows, ``counts`` rows each, every run from its first row to its last."""
    totals = np.zeros((len(counts), values.shape[1]))
    starts = np.cumsum(counts) - counts
    for place in range(int(counts.max(initial=0))):
        longer = np.flatnonzero(counts > place)
        totals[longer] += values[starts[longer] + place]
    return totals


def resample_totals(sums: Floats, names: tuple[str, ...], *, seed: int) -> Floats:
    """(2000, C) totals over resampled scenes; the same names and seed draw the same scenes."""
    drawn = _draw_scene_counts(names, seed)
    exact = _adds_exactly(sums, len(names))
    if exact.all():
        return np.asarray(drawn @ sums)
    if sums.shape[1] == 1 or not exact.any():
        return _multiply_in_order(drawn, sums)
    totals = np.empty((len(drawn), sums.shape[1]))
    totals[:, exact], totals[:, ~exact] = (
        drawn @ sums[:, exact],
        _multiply_in_order(drawn, sums[:, ~exact], alone=False),
    )
    return totals


def _adds_exactly(sums: Floats, scenes: int) -> Bools:
    """(C,) whether a column has whole numbers alone, so few that their totals are exact in any order."""
    with np.errstate(invalid="ignore"):
        is_integer = (np.rint(sums) == sums).all(axis=0)
        return np.asarray(is_integer & (np.abs(sums).max(axis=0, initial=0.0) * scenes < 2**53))


def _multiply_in_order(drawn: Floats, sums: Floats, *, alone: bool = True) -> Floats:
    """The product, added in a fixed order: a BLAS product would depend on its threads.

    einsum without optimisation adds one scene after the other, but for a column that is ``alone``.
    """
    if sums.shape[1] == 1 and not alone:
        return np.asarray(np.einsum("rs,sc->rc", drawn, np.repeat(sums, 2, axis=1)))[:, :1]
    # The order is that of the memory, too.
    return np.asarray(np.einsum("rs,sc->rc", drawn, np.ascontiguousarray(sums)))


def find_interval(draws: Floats, bounds: tuple[float, float]) -> tuple[float, float]:
    """The 95 % interval of a number that need not exist in every resample; both ends are drawn numbers, or bounds.

    ``draws`` are (R,), NaN where it does not exist, possibly infinite. A resample in which it does not exist could have
    been anything, so that it counts as the lower bound for the lower end and as the upper bound for the upper one.
    """
    low, high = find_intervals(draws[None], bounds)
    return float(low[0]), float(high[0])


def find_intervals(draws: Floats, bounds: tuple[float, float]) -> tuple[Floats, Floats]:
    """`find_interval` of C numbers, drawn as (C, R): (C,) lower and (C,) upper ends."""
    last = (draws.shape[1] - 1) / 100
    ranks = math.floor(INTERVAL[0] * last), math.ceil(INTERVAL[1] * last)
    unknown = np.isnan(draws)
    if not unknown.any():
        partitioned = np.partition(draws, ranks, axis=1)
        return partitioned[:, ranks[0]], partitioned[:, ranks[1]]
    low, high = (np.where(unknown, bound, draws) for bound in bounds)
    return np.partition(low, ranks[0], axis=1)[:, ranks[0]], np.partition(high, ranks[1], axis=1)[:, ranks[1]]


@functools.lru_cache(maxsize=8)
def _draw_scene_counts(names: tuple[str, ...], seed: int) -> Floats:
    """(2000, N) how often each scene is in each resample."""
    drawn = _draw_compact_counts(names, seed).astype(np.float64)
    drawn.setflags(write=False)
    return drawn


@functools.lru_cache(maxsize=128)
def _draw_compact_counts(names: tuple[str, ...], seed: int) -> NDArray[Any]:
    """The same in an eighth of the memory: drawing takes ten times as long as turning them into numbers to multiply.

    Scenes that a planner collides in are other ones for each planner.
    """
    rng = np.random.default_rng(content_seed("scene bootstrap", list(names), seed))
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES)
    small = drawn.astype(np.uint8)
    return small if np.array_equal(small, drawn) else drawn


def _compute_intervals(sums: SceneSums, seed: int) -> tuple[Floats, Floats]:
    """Percentiles over resampled scenes for each column; NaN where fewer than two scenes have a denominator.

    Columns that are alike, as displacements under several protocols are, are resampled once.
    """
    columns = sums.numerators.shape[1]
    if len(sums.names) < 2:
        return np.full(columns, np.nan), np.full(columns, np.nan)
    both = np.ascontiguousarray(np.stack([sums.numerators, sums.denominators]).transpose(2, 0, 1))
    where = _get_cached_intervals(sums.names, seed, columns == 1)
    keys = [hashlib.sha256(column).digest() for column in both]
    wanted = {key: column for column, key in enumerate(keys) if key not in where}
    if wanted:
        chosen = list(wanted.values())
        # The first column is repeated for a single one: a lone column is summed in another order.
        beside = chosen if len(chosen) > 1 or columns == 1 else [*chosen, *chosen]
        bounds = _compute_percentiles(sums.numerators[:, beside], sums.denominators[:, beside], sums.names, seed)
        where |= dict(zip(wanted, zip(*(part.tolist() for part in bounds))))
    low, high = zip(*(where[key] for key in keys))
    if len(where) > _MAX_CACHED:
        where.clear()
    return np.array(low), np.array(high)


@functools.lru_cache(maxsize=64)
def _get_cached_intervals(names: tuple[str, ...], seed: int, alone: bool) -> dict[bytes, tuple[float, float]]:
    """Intervals of columns that were asked for, by the hash of what scenes add to them."""
    return {}


def _compute_percentiles(
    numerators: Floats, denominators: Floats, names: tuple[str, ...], seed: int
) -> tuple[Floats, Floats]:
    """`_compute_intervals` of columns none of which was asked for before."""
    columns = numerators.shape[1]
    low, high = np.full(columns, np.nan), np.full(columns, np.nan)
    different, which = np.unique(denominators, axis=1, return_inverse=True)
    if different.shape[1] == 1 and columns > 1:
        different = np.repeat(different, 2, axis=1)
    # One resample per row: percentiles of contiguous values take half the time.
    above = np.ascontiguousarray(resample_totals(numerators, names, seed=seed).T)
    below = np.ascontiguousarray(resample_totals(different, names, seed=seed).T)[which.ravel()]
    known = np.count_nonzero(denominators, axis=0) >= 2
    always = known & (below > 0).all(axis=1)
    if always.any():
        low[always], high[always] = np.percentile(above[always] / below[always], INTERVAL, axis=1)
    for column in np.flatnonzero(known & ~always).tolist():
        drawn = below[column] > 0
        low[column], high[column] = np.percentile(above[column, drawn] / below[column, drawn], INTERVAL)
    return low, high
