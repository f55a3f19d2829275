"""`challenger-bench verify drivers`: reference drivers against the official models and against the specification.

On a straight road the official code has the word (speeds, positions, braking, scores, verdicts, and its own tables of
crashes); along recorded paths, where it has none, the numbers are those of another implementation of the definitions in
`docs/severity.md`.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.drivers.recorded import compare_encounters, compare_scenes
from benchmark.extensions.golden_sets.drivers.straight_road import compare_functions, compare_straight
from benchmark.extensions.golden_sets.drivers.tables import compare_tables
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import readable_set

__all__ = ["BUILT_IN", "verify_drivers"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "drivers"
"""The golden set in the package, in the same form as any other."""
FILES: Final = (
    "straight.npz",
    "functions.npz",
    "tables_*.npz",
    "encounters.npz",
    "encounters.json",
    "scenes.npz",
    "scenes.json",
)


def verify_drivers(golden: Path | None = None) -> list[Check]:
    """Compare the reference drivers with a golden set.

    Args:
        golden: Directory of golden numbers; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    folder = readable_set(BUILT_IN if golden is None else golden, "drivers", *FILES)
    comparison = Comparison()
    compare_functions(comparison, folder / "functions.npz")
    compare_straight(comparison, folder / "straight.npz")
    for table in sorted(folder.glob("tables_*.npz")):
        compare_tables(comparison, table)
    compare_encounters(comparison, folder)
    compare_scenes(comparison, folder)
    return comparison.checks()
