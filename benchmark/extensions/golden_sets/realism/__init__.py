"""`challenger-bench verify realism`: features, divergences and the literature's deviation against golden numbers.

``ctg_*`` are of official code in four versions, ``plain_*`` of numpy and scipy by the definitions in `docs/realism.md`,
``scene-*`` their recordings.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.realism.deviations import compare_deviations
from benchmark.extensions.golden_sets.realism.motion import FEATURE_TOLERANCE, compare_arrays, compare_motion
from benchmark.verification.golden_sets import GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "realism"
"""The golden set in the package, in the same form as any other; its scenes are made up."""
GOLDEN: Final = GoldenSet(
    name="realism",
    files=(
        "ctg_inputs.npz",
        "ctg_histograms.npz",
        "ctg_deviations.json",
        "plain_arrays.npz",
        "plain_features.npz",
        "plain_divergences.json",
        "scene-*.npz",
    ),
    compare=(compare_arrays, compare_motion, compare_deviations),
    quantities={
        "features: *": FEATURE_TOLERANCE,
        # From tracks on, a value that sits on an edge may be counted on either side of it.
        "divergences of computed features: *counts": 1.0,
        "*: *counts": 0.0,
        "divergences of computed features: *": 1e-6,
        "divergences of stored features: *": 1e-9,
        "arrays: *": 1e-9,
        "ctg: relative means": 0.001,
        "ctg: relative *": 0.006,
        "ctg: *": 1e-6,
    },
    built_in=BUILT_IN,
)
