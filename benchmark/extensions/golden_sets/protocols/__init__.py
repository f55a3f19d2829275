"""`challenger-bench verify protocols`: every protocol against verdicts of the official code and of exact polygons."""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.protocols.aggregate_file import FurtherAggregates
from benchmark.extensions.golden_sets.protocols.aggregates import Aggregates
from benchmark.extensions.golden_sets.protocols.golden_set import GoldenScene, golden_inputs, read_golden_scene, remarks
from benchmark.extensions.golden_sets.protocols.official import compare_official
from benchmark.extensions.golden_sets.protocols.official_more import compare_further, judged_further
from benchmark.extensions.golden_sets.protocols.polygons import compare_polygons
from benchmark.protocols import PROTOCOLS, STANDARD, Outcomes
from benchmark.verification.checks import Check, Comparison

__all__ = ["BUILT_IN", "verify_protocols"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "protocols"
"""The golden set in the package, in the same form as any other."""


def verify_protocols(golden: Path | None = None) -> list[Check]:
    """Compare every protocol with a golden set: each sample, plan and step, and the rates over all of them.

    A set is of one of two forms, which may be mixed: with verdicts of the protocols that every run is judged by, or
    with roads and the past beside the boxes and verdicts of the further ones.

    Args:
        golden: Directory of golden numbers; the built-in set by default. Scenes may lack the verdicts of exact polygons
            (``NAME_exact.npz``), which the notes say; inputs and official verdicts belong together.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    paths = golden_inputs(BUILT_IN if golden is None else golden)
    comparison, aggregates, further = Comparison(), Aggregates(), FurtherAggregates()
    with_roads: set[str] = set()
    for path in paths:
        scene = read_golden_scene(path)
        if scene.with_roads:
            outcomes = judged_further(scene)
            compare_further(comparison, scene, outcomes)
            further.add(scene, outcomes)
            with_roads.add(scene.name)
        else:
            outcomes = _judged(scene)
            compare_official(comparison, scene, outcomes)
            if scene.exact is not None:
                compare_polygons(comparison, scene, outcomes["exact"])
            aggregates.add(scene, outcomes)
    aggregates.compare(comparison)
    further.compare(comparison, paths[0].parent)
    for text in remarks(paths, with_roads):
        comparison.note(comparison.checks()[0].quantity, text)
    for check in comparison.checks():
        if check.quantity.endswith("(m)") and check.quantity.split()[0] in STANDARD:
            comparison.note(check.quantity, "the golden numbers are single precision")
    return comparison.checks()


def _judged(scene: GoldenScene) -> dict[str, list[Outcomes]]:
    """Verdicts on each plan of the protocols that every run is judged by."""
    plans = [scene.plans[:, plan] for plan in range(len(scene.plan_names))]
    return {name: [PROTOCOLS[name].evaluate(scene.truths, each) for each in plans] for name in STANDARD}
