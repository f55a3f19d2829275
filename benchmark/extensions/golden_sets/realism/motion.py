"""Motion features and their divergences: from stored samples, and from the tracks on."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.fairness.features import FEATURES, FeatureRun, Integers, extract_recorded_runs, extract_runs
from benchmark.fairness.realism import equal_bins, quantile_bins, w1
from benchmark.geometry import Floats
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

CATEGORY: Final = "vehicle.car"
FEATURE_TOLERANCE: Final = 1e-6
RECORDED, HALVES = "recorded", "halves"
_NOT_VARIANTS: Final = ("chosen", "features", "arrays")

Pools = dict[str, Floats]


def compare_arrays(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare divergences of made-up samples."""
    stored = folder.arrays("plain_arrays.npz")
    for number, golden in enumerate(folder.facts("plain_divergences.json")["arrays"]):
        sample, reference = stored.floats(f"a{number}", None), stored.floats(f"r{number}", None)
        _compare_divergences(comparison.at(f"pair {number}", "arrays: "), sample, reference, golden)


def compare_motion(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare features of recorded and changed tracks, and the divergences of both kinds of samples."""
    facts, stored = folder.facts("plain_divergences.json"), folder.arrays("plain_features.npz")
    if facts["features"] != list(FEATURES):
        raise ValueError(f"plain_divergences.json must be about {', '.join(FEATURES)}")
    variants = [name for name in facts if name not in _NOT_VARIANTS]
    ours: dict[tuple[str, str], list[FeatureRun]] = {}
    for scene, agent in facts["chosen"].items():
        tracks, keyframes = _read_recording(folder.arrays(f"{scene}.npz"))
        ours[RECORDED, scene] = extract_recorded_runs(tracks, keyframes, CATEGORY)
        for variant in variants:
            if variant not in (RECORDED, HALVES):
                changed = tracks.agents.copy()
                changed[agent] = stored.floats(f"{variant}/{scene}/{agent}/boxes", len(tracks.seconds), 5)
                ours[variant, scene] = extract_runs(replace(tracks, agents=changed), keyframes, agent)
    pooled = {key: _compare_runs(comparison, stored, key, runs) for key, runs in ours.items()}
    for column, kind in enumerate(("stored", "computed")):
        pools, at = {key: both[column] for key, both in pooled.items()}, f"divergences of {kind} features: "
        for variant in variants:
            _compare_pools(comparison.at(variant, at), variant, facts[variant], pools, list(facts["chosen"]))


def _read_recording(stored: GoldenArrays) -> tuple[ContinuousTracks, Integers]:
    """Recording of a file: all objects, and the indices of the keyframes."""
    seconds, categories = stored.floats("seconds", None), tuple(stored.texts("categories"))
    shape = (len(categories), len(seconds))
    ego, agents = stored.floats("ego", len(seconds), 5), stored.floats("agents", *shape, 5)
    tracks = ContinuousTracks(seconds, ego, agents, stored.verdicts("valid", *shape), categories)
    return tracks, stored.integers("keyframes", None)


def _compare_runs(
    comparison: Comparison, stored: GoldenArrays, key: tuple[str, str], runs: list[FeatureRun]
) -> tuple[Pools, Pools]:
    """Samples by feature, the stored ones and ours, after they were compared.

    Ours are the stored ones where both agree: a car that drives straight has rates of 1e-17 rad/s with signs of
    rounding, and the quantiles of such a feature lie between them.
    """
    variant, scene = key
    run_counts: dict[int, int] = defaultdict(int)
    expected = {"/".join(name.split("/")[:4]) for name in stored.names if name.endswith("/time")}
    expected = {name for name in expected if name.startswith(f"{variant}/{scene}/")}
    golden: dict[str, list[Floats]] = {name: [] for name in FEATURES}
    ours: dict[str, list[Floats]] = {name: [] for name in FEATURES}
    labels = set()
    for run in runs:
        label = f"{variant}/{scene}/{run.agent}/{run_counts[run.agent]}"
        run_counts[run.agent] += 1
        labels.add(label)
        at, known = comparison.at(label, "features: "), label in expected
        same = known and at.series("time (s)", run.times, stored.floats(f"{label}/time", None))
        for name in FEATURES:
            values = run.values[name]
            if known:
                golden[name].append(theirs := stored.floats(f"{label}/{name}", None))
                at.series(name, values, theirs)
                if same:
                    values = np.where(np.abs(theirs - values) <= FEATURE_TOLERANCE, theirs, values)
            ours[name].append(values)
    wrong = [label not in labels or label not in expected for label in sorted(labels | expected)]
    comparison.verdicts("features: which runs count", wrong, where=f"{variant}/{scene}")
    first, second = ({name: _concatenate(values) for name, values in of.items()} for of in (golden, ours))
    return first, second


def pool_features(runs: Iterable[FeatureRun]) -> Pools:
    """All samples of runs, by feature."""
    runs = list(runs)
    return {name: _concatenate([run.values[name] for run in runs]) for name in FEATURES}


def _concatenate(parts: list[Floats]) -> Floats:
    return np.concatenate(parts) if parts else np.empty(0)


def _compare_pools(
    comparison: Comparison, variant: str, golden: dict[str, Any], pools: dict[tuple[str, str], Pools], scenes: list[str]
) -> None:
    # Even scenes against odd ones give the noise floor.
    halves = variant == HALVES
    of, against = (scenes[::2], scenes[1::2]) if halves else (scenes, scenes)
    shares: dict[str, list[float]] = {"realism": [], "realism_equal_width": []}
    for name in FEATURES:
        sample = _concatenate([pools[RECORDED if halves else variant, scene][name] for scene in of])
        reference = _concatenate([pools[RECORDED, scene][name] for scene in against])
        _compare_divergences(comparison.at(f"{variant} {name}"), sample, reference, golden[name])
        shares["realism"].append(1 - quantile_bins(sample, reference).divergence)
        shares["realism_equal_width"].append(1 - equal_bins(sample, reference).divergence)
    for name, values in shares.items():
        comparison.numbers(name, np.mean(values), golden[name])


def _compare_divergences(comparison: Comparison, sample: Floats, reference: Floats, golden: dict[str, Any]) -> None:
    quantile, equal = quantile_bins(sample, reference), equal_bins(sample, reference)
    comparison.numbers("w1", w1(sample, reference), golden["w1"])
    comparison.series("quantile edges", quantile.edges, np.array(golden["quantile_edges"], np.float64))
    comparison.numbers("range", equal.edges, [golden["low"], golden["high"]])
    for bins, counts, name in ((quantile, "quantile_counts", "jsd_quantile"), (equal, "counts", "jsd")):
        exact = True
        for own, column in ((bins.counts, counts), (bins.reference, f"{counts}_reference")):
            theirs = np.array(golden[column], np.float64)
            comparison.series(counts, own, theirs)
            exact &= np.array_equal(own, theirs)
        if exact:
            comparison.numbers(name, bins.divergence, golden[name])
