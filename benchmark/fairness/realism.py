"""The realism of a set of adversaries against recordings: every feature, the worst by name, and what zero looks like.

``docs/realism.md``, "What is printed". One aggregate hides one bad feature, so the headline is the worst feature and
never the mean; and a value better than that of one half of the recordings against the other is no evidence of anything.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.divergence import Histograms, quantile_bins, w1
from benchmark.fairness.features import FEATURES, ROAD_EDGE, Run
from benchmark.geometry import Floats
from benchmark.records.judgement import FeatureRealism

BOOTSTRAP_DRAWS: Final = 200
_INTERVAL: Final = (0.025, 0.975)

RunsOfScenes = Mapping[str, Sequence[Run]]
"""Runs by the name of their scene."""


@dataclass(frozen=True, slots=True)
class Realism:
    """Realism of all features.

    Attributes:
        features: By the order of `FEATURES`, then `ROAD_EDGE` where all scenes have a map.
        samples: Samples of adversaries, and of recordings.
    """

    features: tuple[FeatureRealism, ...]
    samples: tuple[int, int]

    @property
    def worst(self) -> FeatureRealism:
        """The headline: the feature whose divergence is largest."""
        return min(self.features, key=lambda feature: feature.realism)

    @property
    def mean(self) -> float:
        """Mean over features, which hides one bad feature; never printed alone."""
        return float(np.mean([feature.realism for feature in self.features]))


def realism_of(adversaries: RunsOfScenes, recorded: RunsOfScenes, seed: int = 0) -> Realism | None:
    """Compare adversaries with recordings, both by scene; ``None`` if one side has no run that counts.

    The reference is in the order of the scenes; every second scene is one half.
    """
    scenes = list(recorded)
    if not any(map(len, adversaries.values())) or not any(map(len, recorded.values())):
        return None
    everything = [run for runs in (*adversaries.values(), *recorded.values()) for run in runs]
    names = (*FEATURES, *([ROAD_EDGE] if all(ROAD_EDGE in run.values for run in everything) else []))
    halves = ({name: recorded[name] for name in scenes[first::2]} for first in (0, 1))
    even, odd = (_pooled(half, names) for half in halves)
    ours, reference = _pooled(adversaries, names), _pooled(recorded, names)
    apart = {name: w1(ours[name], reference[name]) for name in names}
    halves_apart = {name: _of_both(w1, even[name], odd[name]) for name in names}
    features = tuple(
        FeatureRealism(
            name=name,
            w1=apart[name],
            w1_of_halves=halves_apart[name],
            w1_in_halves=_times(apart[name], halves_apart[name]),
            realism=_realism(ours[name], reference[name]),
            realism_of_halves=_of_both(_realism, even[name], odd[name]),
            interval=_interval(adversaries, reference[name], name, seed),
        )
        for name in names
    )
    return Realism(features, (len(ours[FEATURES[0]]), len(reference[FEATURES[0]])))


def _realism(sample: Floats, reference: Floats) -> float:
    return 1.0 - quantile_bins(sample, reference).divergence


def _times(value: float, unit: float | None) -> float | None:
    return value / unit if unit else None


def _of_both(measure: Callable[[Floats, Floats], float], first: Floats, second: Floats) -> float | None:
    return measure(first, second) if len(first) and len(second) else None


def _pooled(runs: RunsOfScenes, names: Sequence[str]) -> dict[str, Floats]:
    return {
        name: np.concatenate([np.empty(0), *(run.values[name] for some in runs.values() for run in some)])
        for name in names
    }


def _interval(adversaries: RunsOfScenes, reference: Floats, name: str, seed: int) -> tuple[float, float] | None:
    """Scenes of the adversaries are drawn again and again; the recordings stay."""
    scenes = [np.concatenate([run.values[name] for run in runs]) for runs in adversaries.values() if runs]
    if len(scenes) < 2:
        return None
    bins = [quantile_bins(scene, reference) for scene in scenes]
    counts = np.array([each.counts for each in bins])
    rng = np.random.default_rng(seed)
    drawn = rng.integers(len(scenes), size=(BOOTSTRAP_DRAWS, len(scenes)))
    values = [1.0 - Histograms(bins[0].edges, counts[draw].sum(axis=0), bins[0].reference).divergence for draw in drawn]
    low, high = np.quantile(values, _INTERVAL).tolist()
    return low, high
