"""Pairs at one instant against the official code and the specification."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.geometry import Bools
from benchmark.interactions.contacts import (
    AHEAD_RAD,
    BEHIND_RAD,
    EGO_MASS_KG,
    KINDS,
    Pairs,
    at_fault,
    bearing,
    delta_v,
    fatal_probability,
    is_agent,
    mass_kg,
)
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

TOLERANCE: Final = 1e-9
_SAME: Final = {
    "STOPPED_EGO_COLLISION": "stopped_ego",
    "STOPPED_TRACK_COLLISION": "stopped_track",
    "ACTIVE_FRONT_COLLISION": "front",
    "ACTIVE_REAR_COLLISION": "rear",
    "ACTIVE_LATERAL_COLLISION": "lateral",
}
"""Official names of kinds."""


def compare_contacts(comparison: Comparison, path: Path) -> None:
    """Compare pairs.

    Args:
        comparison: Takes the errors.
        path: ``contacts.json``.

    Raises:
        InputError: If the file cannot be used.
    """
    facts = GoldenFacts.read(path)
    masses = facts.inner("masses")
    known = [EGO_MASS_KG, *(mass_kg(name) for name in masses)]
    golden_masses = [facts.number("ego_mass"), *(masses.number(name) for name in masses)]
    comparison.numbers("masses (kg)", np.array(known), np.array(golden_masses), TOLERANCE)
    cases = facts.objects("cases")
    pairs = _pairs(cases)
    _compare_expected(comparison, cases, pairs)
    _compare_official(comparison, cases, pairs)


def _pairs(cases: list[GoldenFacts]) -> Pairs:
    return Pairs(
        ego=np.array([case.numbers("ego", 5) for case in cases]),
        ego_speed=np.array([case.number("ego_speed") for case in cases]),
        other=np.array([case.numbers("other", 5) for case in cases]),
        other_velocity=np.array([case.numbers("other_velocity", 2) for case in cases]),
        is_agent=np.array([is_agent(case.text("category")) for case in cases]),
    )


def _compare_expected(comparison: Comparison, cases: list[GoldenFacts], pairs: Pairs) -> None:
    expected = [case.inner("expected") for case in cases]
    kilograms = np.array([mass_kg(case.text("category")) for case in cases])
    own, others = delta_v(pairs.impact_speed, kilograms)
    ours = {
        "gap": pairs.gap,
        "impact_speed": pairs.impact_speed,
        "delta_v_ego": own,
        "delta_v_other": others,
        "delta_v_nuplan": pairs.delta_v_nuplan,
        "p_fatal_ego": fatal_probability(own),
    }
    for name, values in ours.items():
        counted = _not_fragile(cases, name)
        golden = np.array([each.number(name) for each in expected])
        comparison.numbers(f"contacts: {name}", values[counted], golden[counted], TOLERANCE)
    counted = _not_fragile(cases, "ttc")
    ttc = np.array([each.number("ttc") if each.known("ttc") else np.inf for each in expected])[counted]
    found = pairs.time_to_contact[counted]
    comparison.verdicts("contacts: whether they ever touch", np.isinf(found) != np.isinf(ttc))
    both = np.isfinite(found) & np.isfinite(ttc)
    comparison.numbers("contacts: ttc (s)", found[both], ttc[both], TOLERANCE)
    counted = _not_fragile(cases, "type")
    wrong = np.array([KINDS[kind].value != each.text("type") for kind, each in zip(pairs.kinds, expected)])
    comparison.verdicts("contacts: type", wrong[counted])


def _compare_official(comparison: Comparison, cases: list[GoldenFacts], pairs: Pairs) -> None:
    official = [case.inner("official_nuplan") for case in cases]
    kinds = [KINDS[kind] for kind in pairs.kinds]
    touching = np.array([each.flag("contact") for each in official])
    comparison.verdicts("official: contact", (pairs.gap == 0.0) != touching)
    names = [_SAME.get(each.text("type"), "unknown") for each in official]
    comparison.verdicts("official: type", np.array([kind.value != name for kind, name in zip(kinds, names)]))
    for column, unsure in (("at_fault_one_lane", False), ("at_fault_several_lanes", True)):
        wrong = np.array([at_fault(kind, unsure) != each.flag(column) for kind, each in zip(kinds, official)])
        comparison.verdicts(f"official: {column}", wrong)
    angle = bearing(pairs.ego, pairs.other)
    for column, ours in (("ahead", angle < AHEAD_RAD), ("behind", angle > BEHIND_RAD)):
        comparison.verdicts(f"official: {column}", ours != np.array([each.flag(column) for each in official]))
    stepped = [each.number("ttc_stepped") if each.known("ttc_stepped") else np.inf for each in official]
    apart = ~np.isclose(pairs.time_to_contact_nuplan, stepped, rtol=0, atol=TOLERANCE)
    comparison.verdicts("official: stepped ttc", apart)
    golden = np.array([each.number("delta_v") for each in official])
    comparison.numbers("official: delta_v (m/s)", pairs.delta_v_nuplan, golden, TOLERANCE)


def _not_fragile(cases: list[GoldenFacts], name: str) -> Bools:
    """Cases whose value stands when all poses move a little."""
    return np.array([not case.fragile(name) for case in cases], np.bool_)
