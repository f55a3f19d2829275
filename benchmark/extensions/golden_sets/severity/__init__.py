"""`challenger-bench verify severity`: contacts, encounters and last chances against golden numbers.

Kinds and blame of contacts, nuPlan's change of velocity and its stepped time to contact are the official code's; the
rest are the numbers of another implementation of the definitions in `docs/severity.md`.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.severity.chances import compare_last_chances, compare_manoeuvres
from benchmark.extensions.golden_sets.severity.contacts import compare_contacts
from benchmark.extensions.golden_sets.severity.encounters import compare_encounters
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import readable_set

__all__ = ["BUILT_IN", "verify_severity"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "severity"
"""The golden set in the package, in the same form as any other."""
FILES: Final = ("contacts.json", "encounters.json", "encounters.npz", "manoeuvres.npz")


def verify_severity(golden: Path | None = None) -> list[Check]:
    """Compare severities with a golden set.

    Args:
        golden: Directory of golden numbers; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    folder = readable_set(BUILT_IN if golden is None else golden, "severity", *FILES)
    comparison = Comparison()
    compare_contacts(comparison, folder / "contacts.json")
    compare_encounters(comparison, folder)
    compare_last_chances(comparison, folder)
    compare_manoeuvres(comparison, folder)
    return comparison.checks()
