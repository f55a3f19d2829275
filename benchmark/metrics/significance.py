"""Is a difference more than chance: paired comparisons with 95 % intervals.

What is drawn is the *recorded* scene, together with everything made from it: the recording, its rendering and all its
adversarial versions are in a resample together or not at all. So the pairing carries into the interval, and ten
adversarial versions of one recording are not taken for ten independent observations.

Two planners on one split are compared on the samples that both planned. One planner on two splits is compared twice:
over all scenes of both, and over the recorded scenes that both splits have.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.rates import HORIZONS, Estimate, SceneSums, find_intervals, resample_totals
from benchmark.metrics.scores import ScoredSamples, describe_record, map_scenes_to_sources

RowIndices = NDArray[np.int64]
IntervalBounds = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class RateComparison:
    """Two collision rates, ``None`` where no sample counts, and the second less the first."""

    first: float | None
    second: float | None
    difference: Estimate


@dataclass(frozen=True, slots=True)
class SplitComparison:
    """One planner on two splits; first is the baseline.

    Attributes:
        privileged: Whether it saw what no car sees.
        miniature: Whether it shows the pipeline and ranks nothing.
        everything: Horizon to comparison over all scenes of both.
        paired: Horizon to comparison over the recorded scenes that both have (``sources``).
        only_baseline: Scenes of the first split of which the second has none.
        only_split: Scenes of the second split whose recording the first does not have.
        failed: Samples of both without a plan; they are in no rate.
    """

    planner: str
    privileged: bool
    miniature: bool
    protocol: str
    baseline_split: str
    split: str
    everything: dict[str, RateComparison]
    paired: dict[str, RateComparison]
    sources: tuple[str, ...]
    only_baseline: tuple[str, ...]
    only_split: tuple[str, ...]
    failed: int


@dataclass(frozen=True, slots=True)
class PlannerComparison:
    """Two planners on the same samples; ``samples`` count for both.

    A planner is ``privileged`` if it saw what no car sees, a miniature if it ranks nothing. Left out are samples that
    one or both ``failed`` on, and ``unshared`` scenes that only one of them ran on.
    """

    planners: tuple[str, str]
    privileged: tuple[bool, bool]
    miniatures: tuple[bool, bool]
    protocol: str
    split: str
    by_horizon: dict[str, RateComparison]
    samples: int
    failed: int
    unshared: tuple[str, ...]


def compare_splits(
    baseline: ScoredSamples, other: ScoredSamples, *, seed: int = 0, horizons: Sequence[str] = HORIZONS
) -> SplitComparison:
    """Compare a planner with itself on another split: same planner, weights, data set and protocol.

    Where the other record does not say what a scene was made from, it is the baseline's scene with the longest name
    that is the same or ends there at a hyphen.
    """
    first, second = baseline.record, other.record
    _require_one_planner(baseline, other)
    own = map_scenes_to_sources(first)
    known = set(own.values())
    source_of = {scene: _resolve_source(source, known) for scene, source in map_scenes_to_sources(second).items()}
    sums = baseline.sums(own), other.sums(source_of)
    shared = known & set(source_of.values())
    return SplitComparison(
        planner=first.planner,
        privileged=first.run.planner.privileged,
        miniature=first.run.planner.miniature,
        protocol=baseline.protocol,
        baseline_split=first.run.split,
        split=second.run.split,
        everything=_compare_rates(*sums, sorted(known | set(source_of.values())), seed, horizons),
        paired=_compare_rates(*sums, sorted(shared), seed, horizons),
        sources=tuple(sorted(shared)),
        only_baseline=tuple(sorted(scene for scene, source in own.items() if source not in shared)),
        only_split=tuple(sorted(scene for scene, source in source_of.items() if source not in shared)),
        failed=len(baseline.failed) + len(other.failed),
    )


def compare_planners(
    first: ScoredSamples, second: ScoredSamples, *, seed: int = 0, horizons: Sequence[str] = HORIZONS
) -> PlannerComparison:
    """Compare two planners on the samples that both planned, on the same split."""
    runs = first.record.run, second.record.run
    if (first.record.judged_content, runs[0].split, first.protocol) != (
        second.record.judged_content,
        runs[1].split,
        second.protocol,
    ):
        raise InputError(
            f"{describe_record(first.record)} and {describe_record(second.record)} are not of the same data, split and "
            "protocol; compare planners on the same samples"
        )
    mine, theirs = _find_common_rows(first, second)
    unit_of = map_scenes_to_sources(first.record)
    sums = (
        first.sums(unit_of, mine),
        second.sums({**map_scenes_to_sources(second.record), **unit_of}, theirs),
    )
    return PlannerComparison(
        planners=(first.record.planner, second.record.planner),
        privileged=(runs[0].planner.privileged, runs[1].planner.privileged),
        miniatures=(runs[0].planner.miniature, runs[1].planner.miniature),
        protocol=first.protocol,
        split=runs[0].split,
        by_horizon=_compare_rates(*sums, list(sums[0].names), seed, horizons),
        samples=len(mine),
        failed=_count_common_failures(first, second),
        unshared=tuple(sorted(set(runs[0].scenes) ^ set(runs[1].scenes))),
    )


def _find_common_rows(first: ScoredSamples, second: ScoredSamples) -> tuple[RowIndices, RowIndices]:
    """Rows of the samples that count for both, of the first and of the second."""
    if first.tokens == second.tokens:
        rows = np.flatnonzero(first.counted & second.counted)
        return rows, rows
    row_of = {name: row for row, name in enumerate(second.tokens)}
    both = [(row, row_of[name]) for row, name in enumerate(first.tokens) if name in row_of]
    both = [(mine, theirs) for mine, theirs in both if first.counted[mine] and second.counted[theirs]]
    rows = np.array(both, dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


def _count_common_failures(first: ScoredSamples, second: ScoredSamples) -> int:
    """How many samples that both ran on one of them failed on."""
    failed = first.failed | second.failed
    if not failed:
        return 0
    ran = [{*scored.tokens, *scored.failed} for scored in (first, second)]
    return len(failed & ran[0] & ran[1])


def _require_one_planner(baseline: ScoredSamples, other: ScoredSamples) -> None:
    first, second = baseline.record.run, other.record.run
    places = f"{describe_record(baseline.record)} and {describe_record(other.record)}"
    if first.planner.name != second.planner.name or first.data.name != second.data.name:
        raise InputError(f"{places} differ in planner or data set; compare splits of one planner")
    if first.planner.weights_sha256 != second.planner.weights_sha256:
        raise InputError(
            f"{places} ran with different weights; to compare, run challenger-bench eval again for the older one"
        )
    if baseline.protocol != other.protocol:
        raise InputError(f"{places} use protocols {baseline.protocol} and {other.protocol}; compare within one")


def _resolve_source(source: str, known: set[str]) -> str:
    """The known name that a name is, or that it begins with up to a hyphen; else the name."""
    shorter = source
    while shorter not in known and "-" in shorter:
        shorter = shorter.rpartition("-")[0]
    return shorter if shorter in known else source


def _compare_rates(
    first: SceneSums, second: SceneSums, names: Sequence[str], seed: int, horizons: Sequence[str]
) -> dict[str, RateComparison]:
    """Comparison at each of H horizons over the named recordings."""
    sides = first.over(names), second.over(names)
    # A single recording with counted samples cannot be resampled.
    enough = all(np.count_nonzero(side.denominators[:, 0]) > 1 for side in sides)
    columns = [HORIZONS.index(horizon) for horizon in horizons]
    rates = [_ratio(side.numerators.sum(axis=0), side.denominators.sum(axis=0))[columns] for side in sides]
    difference = rates[1] - rates[0]
    differences: list[IntervalBounds] = [(None, None)] * len(columns)
    if enough:
        draws_of_sides = [
            _draw_rates(side.names, seed, *map(_freeze, (side.numerators, side.denominators))) for side in sides
        ]
        drawn = [draws[columns] for draws in draws_of_sides]
        apart = drawn[1] - drawn[0]
        differences = _find_intervals(apart, (-1.0, 1.0))
    return {
        horizon: RateComparison(
            first=_number(rates[0][column]),
            second=_number(rates[1][column]),
            difference=_build_estimate(difference[column], differences[column]),
        )
        for column, horizon in enumerate(horizons)
    }


def _freeze(values: Floats) -> tuple[bytes, int]:
    """An array of two dimensions that something may be remembered by."""
    return values.tobytes(), values.shape[1]


@functools.lru_cache(maxsize=256)
def _draw_rates(
    names: tuple[str, ...], seed: int, numerators: tuple[bytes, int], denominators: tuple[bytes, int]
) -> Floats:
    """(4, 2000) rates over resampled recordings; every horizon has the same denominator.

    A planner is compared with all others, mostly on the same samples: it is resampled once.
    """
    above, below = (np.frombuffer(data).reshape(-1, width) for data, width in (numerators, denominators))
    drawn = _ratio(resample_totals(above, names, seed=seed), resample_totals(below[:, :1], names, seed=seed)).T
    drawn = np.ascontiguousarray(drawn)
    drawn.setflags(write=False)
    return drawn


def _find_intervals(draws: Floats, bounds: tuple[float, float]) -> list[IntervalBounds]:
    """An interval for each of (H, 2000) draws."""
    low, high = find_intervals(draws, bounds)
    return list(zip(low.tolist(), high.tolist(), strict=True))


def _build_estimate(value: Floats, interval: IntervalBounds) -> Estimate:
    """An estimate; empty where the value does not exist."""
    number = _number(value)
    return Estimate(None, None, None) if number is None else Estimate(number, *interval)


def _number(value: Floats) -> float | None:
    return float(value) if np.isfinite(value) else None


def _ratio(above: Floats, below: Floats) -> Floats:
    """Quotients; infinite or NaN where the denominator is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.divide(above, below))
