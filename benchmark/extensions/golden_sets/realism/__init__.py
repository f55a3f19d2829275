"""`challenger-bench verify realism`: features, divergences and the literature's deviation against golden numbers.

``ctg_*`` are numbers of the official code in four versions, ``plain_*`` those of numpy and scipy by the definitions in
`docs/realism.md`, ``scene-*`` the recordings that they were computed from.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.realism.deviations import compare_deviations
from benchmark.extensions.golden_sets.realism.motion import compare_arrays, compare_motion
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import readable_set

__all__ = ["BUILT_IN", "verify_realism"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "realism"
"""The golden set in the package, in the same form as any other; its scenes are made up."""
FILES: Final = (
    "ctg_inputs.npz",
    "ctg_histograms.npz",
    "ctg_deviations.json",
    "plain_arrays.npz",
    "plain_features.npz",
    "plain_divergences.json",
    "scene-*.npz",
)


def verify_realism(golden: Path | None = None) -> list[Check]:
    """Compare realism with a golden set.

    Args:
        golden: Directory of golden numbers; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    folder = readable_set(BUILT_IN if golden is None else golden, "realism", *FILES)
    comparison = Comparison()
    compare_arrays(comparison, folder)
    compare_motion(comparison, folder)
    compare_deviations(comparison, folder)
    return comparison.checks()
