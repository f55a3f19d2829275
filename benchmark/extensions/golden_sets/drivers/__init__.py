"""`challenger-bench verify drivers`: reference drivers against the official models and against the specification.

On a straight road the official code has the word (speeds, positions, braking, scores, verdicts, its tables of crashes);
along recorded paths the numbers are of another implementation of `docs/severity.md`.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.drivers.recorded import compare_interactions, compare_scenes
from benchmark.extensions.golden_sets.drivers.tables import compare_functions, compare_straight, compare_tables
from benchmark.verification.golden_sets import GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "drivers"
"""The golden set in the package, in the same form as any other."""
GOLDEN: Final = GoldenSet(
    name="drivers",
    files=(
        "straight.npz",
        "functions.npz",
        "tables_*.npz",
        "encounters.npz",
        "encounters.json",
        "scenes.npz",
        "scenes.json",
    ),
    compare=(compare_functions, compare_straight, compare_tables, compare_interactions, compare_scenes),
    quantities={
        "function *": 1e-9,
        "straight, *": 1e-9,
        "tables of following: gap (m)": 1e-9,
        # Runs start on a tie, so that a gap that is a nanometre longer or shorter counts too.
        "tables of following: impact (m/s)": 1e-6,
        "tables of following: ?fs_max": 1e-6,
        "tables of *: share of cells that differ": 0.005,
        "encounters: *": 1e-6,
        "scenes: *": 1e-6,
    },
    built_in=BUILT_IN,
)
