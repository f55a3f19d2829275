"""Entries of a challenge from the records of planners on them: rates, places, and what cannot be told apart.

What is drawn is the recording: scenes of all entries that were made from it are in a resample together or not at all.
A refused scene counts with all samples of its recording, and without a collision on it, so that cheating never pays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Floats
from benchmark.metrics.attacks import collect_scene_attacks
from benchmark.metrics.effect import score_adversary_contacts
from benchmark.metrics.rates import (
    HORIZONS,
    SceneSums,
    compute_ratios_over_scenes,
    find_interval,
    resample_totals,
    sum_by_scene,
)
from benchmark.metrics.scores import ScoredSamples, map_scenes_to_sources, score_record
from benchmark.records.challenge import EntryPair, ScoredQuantity
from benchmark.records.run import RunRecord


@dataclass(frozen=True, slots=True)
class RefusedScene:
    """Refused scene: the recording that it was made from, and how many samples of it would count."""

    recording: str
    samples: int


def sum_collisions(record: RunRecord, protocol: str, horizon: str, refused: Sequence[RefusedScene]) -> SceneSums:
    """(N, 1) sums of a planner's collision rate on an entry, by recording, from its record on the accepted scenes."""
    return _sum_at_horizon(score_record(record, protocol=protocol), horizon, refused)


def sum_adversary_contacts(record: RunRecord, horizon: str, refused: Sequence[RefusedScene]) -> SceneSums:
    """(N, 1) sums of the rate of first contacts with a changed vehicle under ``exact``, by recording.

    The record is of the planner on the accepted scenes and must say whom contacts are with.
    """
    return _sum_at_horizon(score_adversary_contacts(record), horizon, refused)


def sum_attributable_contacts(record: RunRecord, refused: Sequence[RefusedScene]) -> SceneSums:
    """Contribution of each recording to the rate of attributable contacts; arguments as of `sum_collisions`."""
    sources = map_scenes_to_sources(record)
    known_verdicts = [
        (sources[scene], sample.attributable)
        for scene, attack in collect_scene_attacks(record).items()
        for sample in attack.samples
        if sample.attributable is not None
    ]
    values = np.array([verdict for _, verdict in known_verdicts], np.float64).reshape(-1, 1)
    return _add_refused(sum_by_scene(values, np.ones_like(values), [name for name, _ in known_verdicts]), refused)


def _sum_at_horizon(samples: ScoredSamples, horizon: str, refused: Sequence[RefusedScene]) -> SceneSums:
    sums = samples.sums(map_scenes_to_sources(samples.record))
    column = [HORIZONS.index(horizon)]
    return _add_refused(SceneSums(sums.names, sums.numerators[:, column], sums.denominators[:, column]), refused)


def _add_refused(sums: SceneSums, refused: Sequence[RefusedScene]) -> SceneSums:
    extended_sums = sums.over(sorted({*sums.names, *(refused_scene.recording for refused_scene in refused)}))
    for refused_scene in refused:
        extended_sums.denominators[extended_sums.names.index(refused_scene.recording)] += refused_scene.samples
    return extended_sums


def average_planners(
    planners: Sequence[SceneSums], recordings: Sequence[str], seed: int
) -> tuple[ScoredQuantity, Floats]:
    """Mean of the rates of several planners, and (2000,) means in resamples, NaN where one has nothing of the entry.

    ``recordings`` are all of the challenge: the same recordings and seed draw the same resamples for every entry.
    """
    names = tuple(recordings)
    rates, draws = [], []
    for sums in planners:
        of_all = sums.over(names)
        rates.append(_ratio(of_all.numerators.sum(axis=0), of_all.denominators.sum(axis=0))[0])
        above, below = (resample_totals(part, names, seed=seed) for part in (of_all.numerators, of_all.denominators))
        draws.append(_ratio(above, below)[:, 0])
    mean, drawn = float(np.mean(rates)), np.mean(draws, axis=0)
    counted = sum(round(float(sums.denominators.sum())) for sums in planners)
    return _measured(mean, drawn, (0.0, 1.0), counted, _are_several(planners)), drawn


def measure_rate(sums: SceneSums, seed: int) -> ScoredQuantity:
    """One planner's rate, with its interval."""
    return average_planners([sums], sums.names, seed)[0]


def average_recordings(values: Mapping[str, Sequence[float]], seed: int) -> ScoredQuantity:
    """Mean of numbers by recording, with its interval over recordings."""
    flat = [(name, value) for name, of_name in values.items() for value in of_name]
    numbers = np.array([value for _, value in flat], np.float64).reshape(-1, 1)
    (rate,) = compute_ratios_over_scenes(numbers, np.ones_like(numbers), [name for name, _ in flat], seed=seed)
    return ScoredQuantity(value=rate.value, low=rate.low, high=rate.high, denominator=rate.denominator)


def compare_entries(entries: Sequence[tuple[str, float, Floats]], *, enough: bool) -> tuple[EntryPair, ...]:
    """Compare every two entries: a name, a score and (2000,) scores in the same resamples each, best first.

    ``enough`` says whether there are two recordings or more to draw from; else no two are told apart.
    """
    pairs = []
    for index, (name, score, draws) in enumerate(entries):
        for other, other_score, other_draws in entries[index + 1 :]:
            difference = score - other_score
            measured = _measured(difference, draws - other_draws, (-1.0, 1.0), len(draws), enough)
            apart = (
                measured.low is not None and measured.high is not None and (measured.low > 0.0 or measured.high < 0.0)
            )
            pairs.append(EntryPair(first=name, second=other, difference=measured, told_apart=apart))
    return tuple(pairs)


def rank_entries(names: Sequence[str], pairs: Sequence[EntryPair]) -> dict[str, tuple[int, int]]:
    """Best and worst place by name that the numbers leave open, for ranked entries, best first.

    An entry is behind all who are told apart and better, before all who are and worse.
    """
    better, worse = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    for pair in pairs:
        if pair.told_apart:
            worse[pair.first] += 1
            better[pair.second] += 1
    return {name: (1 + better[name], len(names) - worse[name]) for name in names}


def _are_several(planners: Sequence[SceneSums]) -> bool:
    return all(np.count_nonzero(sums.denominators) > 1 for sums in planners)


def _measured(value: float, draws: Floats, bounds: tuple[float, float], counted: int, enough: bool) -> ScoredQuantity:
    if not np.isfinite(value):
        return ScoredQuantity(denominator=counted)
    low, high = find_interval(draws, bounds) if enough else (None, None)
    return ScoredQuantity(value=value, low=low, high=high, denominator=counted)


def _ratio(above: Floats, below: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.divide(above, below))
