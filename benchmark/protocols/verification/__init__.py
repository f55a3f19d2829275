"""`challenger-bench verify protocols`: every protocol against verdicts of the official code and of exact polygons."""

from pathlib import Path
from typing import Final

from benchmark.protocols import PROTOCOLS
from benchmark.protocols.verification.aggregates import Aggregates
from benchmark.protocols.verification.golden_set import golden_inputs, read_golden_scene, remarks
from benchmark.protocols.verification.official import compare_official
from benchmark.protocols.verification.polygons import compare_polygons
from benchmark.verification.checks import Check, Comparison

__all__ = ["BUILT_IN", "verify_protocols"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "protocols"
"""The golden set in the package, in the same form as any other."""
_COMPARED: Final = ("exact", "uniad", "vad", "vad-23", "sparsedrive", "diffusiondrive")


def verify_protocols(golden: Path | None = None) -> list[Check]:
    """Compare every protocol with a golden set: each sample, plan and step, and the rates over all of them.

    Args:
        golden: Directory of golden numbers; the built-in set by default. Scenes may lack the verdicts of exact polygons
            (``NAME_exact.npz``), which the notes say; inputs and official verdicts belong together.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    paths = golden_inputs(BUILT_IN if golden is None else golden)
    comparison, aggregates = Comparison(), Aggregates()
    for path in paths:
        scene = read_golden_scene(path)
        outcomes = {
            name: [
                PROTOCOLS[name].evaluate(scene.truths, scene.plans[:, plan]) for plan in range(len(scene.plan_names))
            ]
            for name in _COMPARED
        }
        compare_official(comparison, scene, outcomes)
        if scene.exact is not None:
            compare_polygons(comparison, scene, outcomes["exact"])
        aggregates.add(scene, outcomes)
    aggregates.compare(comparison)
    for text in remarks(paths):
        comparison.note("samples that count", text)
    for check in comparison.checks():
        if check.quantity.endswith("(m)"):
            comparison.note(check.quantity, "the golden numbers are single precision")
    return comparison.checks()
