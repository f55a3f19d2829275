"""Pairs at one instant against the official code and the specification."""

from typing import Any, Final

import numpy as np

from benchmark.geometry import Floats
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
from benchmark.interactions.golden import fragile
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

_SAME: Final = {
    "STOPPED_EGO_COLLISION": "stopped_ego",
    "STOPPED_TRACK_COLLISION": "stopped_track",
    "ACTIVE_FRONT_COLLISION": "front",
    "ACTIVE_REAR_COLLISION": "rear",
    "ACTIVE_LATERAL_COLLISION": "lateral",
}
"""Official names of kinds."""
_STEPPED_S: Final = 1e-9
_Cases = list[dict[str, Any]]


def compare_contacts(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare pairs."""
    facts = folder.facts("contacts.json")
    cases, masses = facts["cases"], facts["masses"]
    comparison.numbers("masses (kg)", [EGO_MASS_KG, *map(mass_kg, masses)], [facts["ego_mass"], *masses.values()])
    pairs = Pairs(
        ego=_column(cases, "ego"),
        ego_speed=_column(cases, "ego_speed"),
        other=_column(cases, "other"),
        other_velocity=_column(cases, "other_velocity"),
        is_agent=np.array([is_agent(case["category"]) for case in cases]),
    )
    _compare_expected(comparison.at("", "contacts: "), cases, pairs)
    _compare_official(comparison.at("", "official: "), [case["official_nuplan"] for case in cases], pairs)


def _compare_expected(comparison: Comparison, cases: _Cases, pairs: Pairs) -> None:
    expected = [case["expected"] for case in cases]
    own, others = delta_v(pairs.impact_speed, np.array([mass_kg(case["category"]) for case in cases]))
    ours = {
        "gap": pairs.gap,
        "impact_speed": pairs.impact_speed,
        "delta_v_ego": own,
        "delta_v_other": others,
        "delta_v_nuplan": pairs.delta_v_nuplan,
        "p_fatal_ego": fatal_probability(own),
    }
    # What stands when all poses move a little.
    counted = {name: np.array([not fragile(case, name) for case in cases]) for name in (*ours, "ttc", "type")}
    for name, values in ours.items():
        comparison.numbers(name, values[counted[name]], _column(expected, name)[counted[name]])
    found, ttc = (times[counted["ttc"]] for times in (pairs.time_to_contact, _times(expected, "ttc")))
    comparison.same("whether they ever touch", np.isinf(found), np.isinf(ttc))
    both = np.isfinite(found) & np.isfinite(ttc)
    comparison.numbers("ttc (s)", found[both], ttc[both])
    comparison.same("type", [KINDS[kind].value for kind in pairs.kinds], _words(expected, "type"), counted["type"])


def _compare_official(comparison: Comparison, official: _Cases, pairs: Pairs) -> None:
    kinds, angle = [KINDS[kind] for kind in pairs.kinds], bearing(pairs.ego, pairs.other)
    comparison.same("contact", pairs.gap == 0.0, _words(official, "contact"))
    comparison.same("type", [kind.value for kind in kinds], [_SAME.get(each["type"], "unknown") for each in official])
    verdicts = {
        "at_fault_one_lane": [at_fault(kind, False) for kind in kinds],
        "at_fault_several_lanes": [at_fault(kind, True) for kind in kinds],
        "ahead": angle < AHEAD_RAD,
        "behind": angle > BEHIND_RAD,
    }
    for name, ours in verdicts.items():
        comparison.same(name, ours, _words(official, name))
    near = np.isclose(pairs.time_to_contact_nuplan, _times(official, "ttc_stepped"), rtol=0, atol=_STEPPED_S)
    comparison.verdicts("stepped ttc", ~near)
    comparison.numbers("delta_v (m/s)", pairs.delta_v_nuplan, _column(official, "delta_v"))


def _column(cases: _Cases, name: str) -> Floats:
    return np.array([case[name] for case in cases], np.float64)


def _times(cases: _Cases, name: str) -> Floats:
    """Times to a contact, infinite where there is none."""
    return np.array([np.inf if case[name] is None else case[name] for case in cases], np.float64)


def _words(cases: _Cases, name: str) -> list[Any]:
    return [case[name] for case in cases]
