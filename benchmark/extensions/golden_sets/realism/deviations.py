"""The literature's realism deviation against the four versions of its code."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.realism.arrays import RealismArrays
from benchmark.fairness.ctg import (
    BINS,
    MEANS,
    RELATIVE_NAMES,
    SAMPLES_PER_STEP,
    Histograms,
    Mask,
    Normalisation,
    SceneTracks,
    Version,
    bin_edges,
    deviations,
    histograms,
)
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

TOLERANCE: Final = 1e-6
RELATIVE_TOLERANCE, RELATIVE_MEAN_TOLERANCE = 0.006, 0.001
RECORDED: Final = "recorded"
_EDGES: Final = "edges/"


def compare_deviations(comparison: Comparison, folder: Path) -> None:
    """Histograms, distances and means of every version, normalisation, mask and variant of the set.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    inputs = _inputs(RealismArrays.read(folder / "ctg_inputs.npz"))
    stored = RealismArrays.read(folder / "ctg_histograms.npz")
    edges = {name[len(_EDGES) :]: stored.floats(name, BINS + 1) for name in stored.names if name.startswith(_EDGES)}
    own = bin_edges()
    if not set(own) <= set(edges):
        raise InputError(f"{stored.path} lacks the edges of {', '.join(sorted(set(own) - set(edges)))}; get it again")
    for name in own:
        comparison.numbers("ctg: edges", own[name], edges[name], TOLERANCE, where=name)
    found: dict[tuple[str, str], Histograms] = {}
    for setting, variant in sorted({_split(stored, name) for name in stored.names if not name.startswith(_EDGES)}):
        if variant not in inputs:
            raise InputError(f"{stored.path} has histograms of {variant}, of which there are no tracks; get it again")
        ours = histograms(inputs[variant], *_setting(stored.path, setting), edges)
        found[setting, variant] = ours
        for name, shares in ours.items():
            label = f"{setting}/{variant}/{name}"
            golden = stored.floats(label, BINS)
            relative = name in RELATIVE_NAMES
            what = "ctg: relative histograms" if relative else "ctg: histograms of agents"
            comparison.numbers(what, shares, golden, RELATIVE_TOLERANCE if relative else TOLERANCE, where=label)
    _compare_distances(comparison, GoldenFacts.read(folder / "ctg_deviations.json"), inputs, edges, found)


def _compare_distances(
    comparison: Comparison,
    facts: GoldenFacts,
    inputs: dict[str, list[SceneTracks]],
    edges: dict[str, Floats],
    found: dict[tuple[str, str], Histograms],
) -> None:
    def of(setting: str, variant: str) -> Histograms:
        if (setting, variant) not in found:
            if variant not in inputs:
                raise InputError(f"{facts.path} is about {variant}, of which there are no tracks; get the set again")
            found[setting, variant] = histograms(inputs[variant], *_setting(facts.path, setting), edges)
        return found[setting, variant]

    if not list(facts):
        raise InputError(f"{facts.path} is about nothing; get the set again")
    for setting in facts:
        for variant in facts.inner(setting):
            golden = facts.inner(setting).inner(variant)
            ours = deviations(of(setting, variant), of(setting, RECORDED), edges)
            for name in golden:
                if name not in ours:
                    raise InputError(f"{facts.path}: {golden.where} has a {name} that {setting} does not; get it again")
                relative = name.startswith("rel_") or name == tuple(MEANS)[1]
                what = "relative" if relative else "agents'"
                quantity = f"ctg: {what} means" if name in MEANS else f"ctg: {what} distances"
                limit = (RELATIVE_MEAN_TOLERANCE if name in MEANS else RELATIVE_TOLERANCE) if relative else TOLERANCE
                values = (np.array([ours[name]]), golden.numbers(name)[None])
                comparison.numbers(quantity, *values, limit, where=f"{setting}/{variant}/{name}")


def _inputs(stored: RealismArrays) -> dict[str, list[SceneTracks]]:
    """Scenes by variant, in order of their names."""
    found: dict[str, list[SceneTracks]] = {}
    for name in sorted(stored.names):
        parts = name.split("/")
        if len(parts) != 3 or parts[2] != "position":
            continue
        position = stored.gappy(name, None, None, 2)
        yaw = stored.gappy(f"{parts[0]}/{parts[1]}/yaw", *position.shape[:2])
        if position.shape[1] <= SAMPLES_PER_STEP or not len(position):
            raise InputError(f"{stored.path}: {name} has nobody in it, or is too short; get the set again")
        found.setdefault(parts[1], []).append(SceneTracks(position, yaw))
    if RECORDED not in found:
        raise InputError(f"{stored.path} holds no recorded scenes; get the set again")
    return found


def _split(stored: RealismArrays, name: str) -> tuple[str, str]:
    parts = name.split("/")
    if len(parts) != 5:
        raise InputError(f"{stored.path}: {name} is no CODE/NORMALISATION/MASK/VARIANT/NAME; get the set again")
    return "/".join(parts[:3]), parts[3]


def _setting(path: Path, setting: str) -> tuple[Version, Normalisation, Mask]:
    try:
        version, normalisation, mask = setting.split("/")
        return Version(version), Normalisation(normalisation), Mask(mask)
    except ValueError:
        raise InputError(f"{path}: {setting} is no known CODE/NORMALISATION/MASK; get the set again") from None
