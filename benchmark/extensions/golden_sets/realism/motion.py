"""Motion features and their divergences: from stored samples, and from the tracks on."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.realism.arrays import RealismArrays
from benchmark.fairness.divergence import Histograms, equal_bins, quantile_bins, w1
from benchmark.fairness.features import FEATURES, Run, recorded_runs, runs_of
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

CATEGORY: Final = "vehicle.car"
FEATURE_TOLERANCE: Final = 1e-6
STORED_TOLERANCE, COMPUTED_TOLERANCE = 1e-9, 1e-6
RECORDED, HALVES = "recorded", "halves"
_NOT_VARIANTS: Final = ("chosen", "features", "arrays", HALVES, RECORDED)
_ON_EDGES: Final = 1.0
"""A value that sits on an edge may be counted on either side of it."""

Pools = dict[str, Floats]


def compare_arrays(comparison: Comparison, folder: Path) -> None:
    """Divergences of made-up samples.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = RealismArrays.read(folder / "plain_arrays.npz")
    facts = GoldenFacts.read(folder / "plain_divergences.json")
    for number, golden in enumerate(facts.objects("arrays")):
        sample, reference = stored.floats(f"a{number}", None), stored.floats(f"r{number}", None)
        if not len(sample) or not len(reference):
            raise InputError(f"{stored.path}: pair {number} is empty; get the set again")
        _compare_divergences(comparison, "arrays", sample, reference, golden, f"pair {number}")


def compare_motion(comparison: Comparison, folder: Path) -> None:
    """Features of recorded and changed tracks, and the divergences of both kinds of samples.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    facts = GoldenFacts.read(folder / "plain_divergences.json")
    stored = RealismArrays.read(folder / "plain_features.npz")
    chosen = facts.inner("chosen")
    scenes = list(chosen)
    if facts.texts("features") != list(FEATURES) or not scenes:
        raise InputError(f"{facts.path} must be about {', '.join(FEATURES)} of at least one scene; get the set again")
    variants = [name for name in facts if name not in _NOT_VARIANTS]
    ours: dict[tuple[str, str], list[Run]] = {}
    for scene in scenes:
        tracks, keyframes = RealismArrays.read(folder / f"{scene}.npz").scene()
        agent = chosen.whole(scene)
        if not 0 <= agent < len(tracks):
            raise InputError(f"{facts.path}: {scene} has no object {agent}; get the set again")
        ours[RECORDED, scene] = recorded_runs(tracks, keyframes, CATEGORY)
        for variant in variants:
            changed = tracks.agents.copy()
            changed[agent] = stored.floats(f"{variant}/{scene}/{agent}/boxes", len(tracks.seconds), 5)
            ours[variant, scene] = runs_of(replace(tracks, agents=changed), keyframes, agent)
    pooled = {key: _compare_runs(comparison, stored, key, runs) for key, runs in ours.items()}
    for kind, tolerance, column in (("stored", STORED_TOLERANCE, 0), ("computed", COMPUTED_TOLERANCE, 1)):
        pools = {key: both[column] for key, both in pooled.items()}
        _compare_pools(comparison, facts, kind, tolerance, pools, scenes)


def _compare_runs(
    comparison: Comparison, stored: RealismArrays, key: tuple[str, str], runs: list[Run]
) -> tuple[Pools, Pools]:
    """Samples by feature, the stored ones and ours, after they were compared.

    Ours are the stored ones where both agree: a car that drives straight has rates of 1e-17 rad/s, whose signs are
    those of a processor's rounding, and it is them that the quantiles of such a feature lie between.
    """
    variant, scene = key
    seen: dict[int, int] = defaultdict(int)
    expected = {"/".join(name.split("/")[:4]) for name in stored.names if name.endswith("/time")}
    expected = {name for name in expected if name.startswith(f"{variant}/{scene}/")}
    golden: dict[str, list[Floats]] = {name: [] for name in FEATURES}
    ours: dict[str, list[Floats]] = {name: [] for name in FEATURES}
    found = set()
    for run in runs:
        label = f"{variant}/{scene}/{run.agent}/{seen[run.agent]}"
        seen[run.agent] += 1
        found.add(label)
        if label not in expected:
            for name in FEATURES:
                ours[name].append(run.values[name])
            continue
        times = stored.floats(f"{label}/time", None)
        same = times.shape == run.times.shape
        error = np.abs(times - run.times) if same else np.full(times.shape, np.inf)
        comparison.errors("features: time (s)", error, FEATURE_TOLERANCE, where=label)
        for name in FEATURES:
            values = stored.floats(f"{label}/{name}", len(times))
            error = np.abs(values - run.values[name]) if same else np.full(times.shape, np.inf)
            comparison.errors(f"features: {name}", error, FEATURE_TOLERANCE, where=label)
            golden[name].append(values)
            ours[name].append(
                np.where(error <= FEATURE_TOLERANCE, values, run.values[name]) if same else run.values[name]
            )
    wrong = np.array([label not in found or label not in expected for label in sorted(found | expected)], np.bool_)
    comparison.verdicts("features: which runs count", wrong, where=f"{variant}/{scene}")
    first, second = ({name: _joined(values) for name, values in of.items()} for of in (golden, ours))
    return first, second


def pooled_features(runs: Iterable[Run]) -> Pools:
    """All samples of runs, by feature."""
    runs = list(runs)
    return {name: _joined([run.values[name] for run in runs]) for name in FEATURES}


def _joined(parts: list[Floats]) -> Floats:
    return np.concatenate(parts) if parts else np.empty(0)


def _compare_pools(
    comparison: Comparison,
    facts: GoldenFacts,
    kind: str,
    tolerance: float,
    pools: dict[tuple[str, str], Pools],
    scenes: list[str],
) -> None:
    def pool(variant: str, some: list[str], name: str) -> Floats:
        return _joined([pools[variant, scene][name] for scene in some])

    for variant in [name for name in facts if name not in ("chosen", "features", "arrays")]:
        golden, label = facts.inner(variant), f"divergences of {kind} features"
        shares = {"realism": [], "realism_equal_width": []}  # type: dict[str, list[float]]
        for name in FEATURES:
            # Even scenes against odd ones stand for what zero looks like.
            of, against = (scenes[::2], scenes[1::2]) if variant == HALVES else (scenes, scenes)
            sample = pool(RECORDED if variant == HALVES else variant, of, name)
            reference = pool(RECORDED, against, name)
            if not len(sample) or not len(reference):
                raise InputError(f"{facts.path}: {variant} has no samples of {name}; get the set again")
            _compare_divergences(
                comparison, label, sample, reference, golden.inner(name), f"{variant} {name}", tolerance
            )
            shares["realism"].append(1 - quantile_bins(sample, reference).divergence)
            shares["realism_equal_width"].append(1 - equal_bins(sample, reference).divergence)
        for name, values in shares.items():
            found = np.array([np.mean(values)])
            comparison.numbers(f"{label}: {name}", found, golden.numbers(name)[None], tolerance, where=variant)


def _compare_divergences(
    comparison: Comparison,
    label: str,
    sample: Floats,
    reference: Floats,
    golden: GoldenFacts,
    where: str,
    tolerance: float = STORED_TOLERANCE,
) -> None:
    quantile, equal = quantile_bins(sample, reference), equal_bins(sample, reference)
    distance = np.array([w1(sample, reference)])
    comparison.numbers(f"{label}: w1", distance, golden.numbers("w1")[None], tolerance, where=where)
    edges = golden.numbers("quantile_edges", None)
    same = edges.shape == quantile.edges.shape
    error = np.abs(quantile.edges - edges) if same else np.full(1, np.inf)
    comparison.errors(f"{label}: quantile edges", error, tolerance, where=where)
    ends = np.array([golden.number("low"), golden.number("high")])
    comparison.numbers(f"{label}: range", equal.edges, ends, tolerance, where=where)
    for bins, counts, name in ((quantile, "quantile_counts", "jsd_quantile"), (equal, "counts", "jsd")):
        exact = _compare_counts(comparison, label, bins, golden, counts, where, tolerance)
        if exact:
            value = np.array([bins.divergence])
            comparison.numbers(f"{label}: {name}", value, golden.numbers(name)[None], tolerance, where=where)


def _compare_counts(
    comparison: Comparison,
    label: str,
    ours: Histograms,
    golden: GoldenFacts,
    name: str,
    where: str,
    tolerance: float,
) -> bool:
    """Whether the counts are the same; from tracks on they may differ by one where a value sits on an edge."""
    allowed = 0.0 if tolerance == STORED_TOLERANCE else _ON_EDGES
    exact = True
    for counts, column in ((ours.counts, name), (ours.reference, f"{name}_reference")):
        theirs = golden.numbers(column, None)
        error = np.abs(counts - theirs) if theirs.shape == counts.shape else np.full(1, np.inf)
        comparison.errors(f"{label}: {name}", error, allowed, where=where)
        exact &= not error.any()
    return exact
