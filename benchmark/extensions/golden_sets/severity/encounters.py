"""Encounters of two tracks: series and what is said of them."""

from typing import Final

import numpy as np

from benchmark.fairness.encounter import severity_of
from benchmark.geometry import Floats
from benchmark.interactions.golden import encounter, fragile
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

NEVER_S: Final = 1e6
"""Longer times come from speeds that differ by rounding alone."""


def compare_encounters(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare series and summaries."""
    stored = folder.arrays("encounters.npz")
    for facts in folder.facts("encounters.json"):
        found, golden, here = severity_of(encounter(stored, facts), 0), facts["severity"], facts["name"]
        at = comparison.at(here, "encounters: ")
        for name in ("gap", "ttc", "btn"):
            if not fragile(facts, name):
                _compare_series(at, name, getattr(found, name), stored.floats(f"{here}/{name}", None, gaps=True))
        values = {
            "min_gap": found.min_gap,
            "first_contact": found.contact_s,
            "min_ttc": found.min_ttc,
            "tet": found.tet,
            "tit": found.tit,
            "pet": found.pet,
            "max_btn": found.max_btn,
        }
        for name, value in values.items():
            if not fragile(facts, name):
                at.verdicts(f"whether there is a {name}", (value is None) != (golden[name] is None))
                if value is not None and golden[name] is not None:
                    at.numbers(name, value, golden[name])
        if not fragile(facts, "first"):
            at.verdicts("first", found.first != golden["first"])


def _compare_series(comparison: Comparison, name: str, ours: Floats, golden: Floats) -> None:
    """Numbers of which some are not counted (NaN) or never come (infinite)."""
    ours, golden = (np.where(values > NEVER_S, np.inf, values) for values in (ours, golden))
    same = (np.isnan(ours) == np.isnan(golden)) & (np.isinf(ours) == np.isinf(golden))
    comparison.verdicts(f"samples with {name}", ~same)
    both = np.isfinite(ours) & np.isfinite(golden)
    comparison.numbers(name, ours[both], golden[both])
