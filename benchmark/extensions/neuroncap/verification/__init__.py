"""`challenger-bench verify neuroncap`: the engine against numbers of the published code.

The car sub-step by sub-step, contacts, commands, scenarios and their draws, aggregates, and whole runs with their
recorded plans.
"""

from pathlib import Path
from typing import Final

from benchmark.extensions.neuroncap.verification.decisions import compare_commands, compare_contacts
from benchmark.extensions.neuroncap.verification.drawn import compare_scenarios
from benchmark.extensions.neuroncap.verification.driving import compare_driving
from benchmark.extensions.neuroncap.verification.loops import compare_loops, loop_files
from benchmark.extensions.neuroncap.verification.tables import compare_aggregates
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import readable_set

__all__ = ["BUILT_IN", "verify_neuroncap"]

BUILT_IN: Final = Path(__file__).parent / "golden" / "neuroncap"
"""The golden set in the package, in the same form as any other."""
FILES: Final = (
    "vehicle.npz",
    "contact.npz",
    "command.npz",
    "scenarios.json",
    "aggregate.json",
    "loops/index.json",
)


def verify_neuroncap(golden: Path | None = None) -> list[Check]:
    """Compare NeuroNCAP's engine with a golden set.

    Args:
        golden: Directory of golden numbers; the built-in set by default.

    Returns:
        One check for each quantity, over all files.

    Raises:
        InputError: If the set cannot be used.
    """
    folder = readable_set(BUILT_IN if golden is None else golden, "neuroncap", *FILES)
    loop_files(folder / "loops")
    comparison = Comparison()
    compare_driving(comparison, folder / "vehicle.npz")
    compare_contacts(comparison, folder / "contact.npz")
    compare_commands(comparison, folder / "command.npz")
    compare_scenarios(comparison, folder / "scenarios.json")
    compare_aggregates(comparison, folder / "aggregate.json")
    compare_loops(comparison, folder / "loops")
    return comparison.checks()
