"""`challenger-bench verify severity`: contacts, encounters and last chances against golden numbers.

Kinds and blame of contacts, nuPlan's change of velocity and its stepped time to contact are official; the rest is from
another implementation of `docs/severity.md`.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.golden_sets.severity.quantities import (
    compare_avoidability,
    compare_contacts,
    compare_interactions,
    compare_manoeuvres,
)
from benchmark.interactions.golden_interactions import SAME_TIME_S
from benchmark.verification.golden_sets import GoldenSet

BUILT_IN: Final = Path(__file__).parent / "golden" / "severity"
"""The golden set in the package, in the same form as any other."""
GOLDEN: Final = GoldenSet(
    name="severity",
    files=("contacts.json", "encounters.json", "encounters.npz", "manoeuvres.npz"),
    compare=(compare_contacts, compare_interactions, compare_avoidability, compare_manoeuvres),
    quantities={
        "masses (kg)": 1e-9,
        "contacts: *": 1e-9,
        "official: *": 1e-9,
        "encounters: first_contact": SAME_TIME_S,
        "encounters: tet": SAME_TIME_S,
        "encounters: pet": SAME_TIME_S,
        "encounters: *": 1e-6,
        "manoeuvres: states": 1e-6,
    },
    built_in=BUILT_IN,
)
