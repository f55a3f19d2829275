"""The literature's realism deviation against the four versions of its code."""

from typing import Final

from benchmark.fairness.ctg import (
    BINS,
    MEANS,
    RELATIVE_NAMES,
    CtgMask,
    CtgNormalisation,
    CtgVersion,
    Histograms,
    SceneTracks,
    bin_edges,
    compute_deviations,
    compute_histograms,
)
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

RECORDED: Final = "recorded"
_EDGES: Final = "edges/"


def compare_deviations(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare histograms, distances and means of every version, normalisation, mask and variant of the set."""
    inputs, stored = _read_tracks(folder.arrays("ctg_inputs.npz")), folder.arrays("ctg_histograms.npz")
    edges = {name[len(_EDGES) :]: stored.floats(name, BINS + 1) for name in stored.names if name.startswith(_EDGES)}
    for name, own in bin_edges().items():
        comparison.numbers("ctg: edges", own, edges[name], where=name)
    histograms_by_setting: dict[tuple[str, str], Histograms] = {}

    def of(setting: str, variant: str) -> Histograms:
        if (setting, variant) not in histograms_by_setting:
            version, normalisation, mask = setting.split("/")
            chosen = (CtgVersion(version), CtgNormalisation(normalisation), CtgMask(mask))
            histograms_by_setting[setting, variant] = compute_histograms(inputs[variant], *chosen, edges)
        return histograms_by_setting[setting, variant]

    kinds = {tuple(name.rsplit("/", 2)[:2]) for name in stored.names if not name.startswith(_EDGES)}
    for setting, variant in sorted(kinds):
        for name, shares in of(setting, variant).items():
            label = f"{setting}/{variant}/{name}"
            kind = "relative histograms" if name in RELATIVE_NAMES else "histograms of agents"
            comparison.numbers(f"ctg: {kind}", shares, stored.floats(label, BINS), where=label)
    for setting, variants in folder.facts("ctg_deviations.json").items():
        for variant, golden in variants.items():
            ours = compute_deviations(of(setting, variant), of(setting, RECORDED), edges)
            for name, value in golden.items():
                kind = "relative" if name.startswith("rel_") or name == tuple(MEANS)[1] else "agents'"
                quantity = f"ctg: {kind} {'means' if name in MEANS else 'distances'}"
                comparison.numbers(quantity, ours[name], value, where=f"{setting}/{variant}/{name}")


def _read_tracks(stored: GoldenArrays) -> dict[str, list[SceneTracks]]:
    """Scenes by variant, in order of their names; NaN where an object is absent."""
    tracks: dict[str, list[SceneTracks]] = {}
    for name in sorted(name for name in stored.names if name.endswith("/position")):
        scene, variant, _ = name.split("/")
        position = stored.floats(name, None, None, 2, gaps=True)
        yaw = stored.floats(f"{scene}/{variant}/yaw", *position.shape[:2], gaps=True)
        tracks.setdefault(variant, []).append(SceneTracks(position, yaw))
    return tracks
