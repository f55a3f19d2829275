"""Encounters of two tracks: series and what is said of them."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.fairness.encounter import Severity, severity_of
from benchmark.geometry import Floats
from benchmark.interactions.golden import TrackArrays
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

TOLERANCE: Final = 1e-6
SAME_TIME_S: Final = 1e-9
NEVER_S: Final = 1e6
"""Longer times come from speeds that differ by rounding alone."""


class EncounterArrays(TrackArrays):
    """Tracks and series of encounters."""

    def series(self, name: str, length: int) -> Floats:
        """Numbers of which some are not counted (NaN) or never come (infinite)."""
        return np.asarray(self._taken(name, "f", "numbers", (length,)), np.float64)


def compare_encounters(comparison: Comparison, folder: Path) -> None:
    """Compare series and summaries.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = EncounterArrays.read(folder / "encounters.npz")
    for facts in GoldenFacts.read_list(folder / "encounters.json"):
        name = facts.text("name")
        ours = severity_of(stored.encounter(name, facts.text("category")), 0)
        for quantity in ("gap", "ttc", "btn"):
            if not facts.fragile(quantity):
                golden = stored.series(f"{name}/{quantity}", len(ours.times))
                _compare_series(comparison, quantity, getattr(ours, quantity), golden, name)
        _compare_summary(comparison, ours, facts, name)


def _compare_series(comparison: Comparison, quantity: str, ours: Floats, golden: Floats, where: str) -> None:
    ours, golden = (np.where(values > NEVER_S, np.inf, values) for values in (ours, golden))
    same = (np.isnan(ours) == np.isnan(golden)) & (np.isinf(ours) == np.isinf(golden))
    comparison.verdicts(f"encounters: samples with {quantity}", ~same, where=where)
    both = np.isfinite(ours) & np.isfinite(golden)
    comparison.numbers(f"encounters: {quantity}", ours[both], golden[both], TOLERANCE, where=where)


def _compare_summary(comparison: Comparison, ours: Severity, facts: GoldenFacts, where: str) -> None:
    golden = facts.inner("severity")
    values = {
        "min_gap": (ours.min_gap, TOLERANCE),
        "first_contact": (ours.contact_s, SAME_TIME_S),
        "min_ttc": (ours.min_ttc, TOLERANCE),
        "tet": (ours.tet, SAME_TIME_S),
        "tit": (ours.tit, TOLERANCE),
        "pet": (ours.pet, SAME_TIME_S),
        "max_btn": (ours.max_btn, TOLERANCE),
    }
    for name, (value, tolerance) in values.items():
        if facts.fragile(name):
            continue
        theirs = golden.number(name) if golden.known(name) else None
        comparison.verdicts(f"encounters: whether there is a {name}", np.array([(value is None) != (theirs is None)]))
        if value is not None and theirs is not None:
            found = (np.array([value]), np.array([theirs]))
            comparison.numbers(f"encounters: {name}", *found, tolerance, where=where)
    if not facts.fragile("first"):
        first = golden.text("first") if golden.known("first") else None
        comparison.verdicts("encounters: first", np.array([ours.first != first]), where=where)
