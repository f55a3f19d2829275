"""Pairs at one instant, encounters of two tracks, and last chances in every evaluation, against golden numbers."""

from typing import Any, Final

import numpy as np

from benchmark.fairness.severity_series import measure_severity
from benchmark.geometry import Floats
from benchmark.interactions.avoidability import MANOEUVRES, STATE_COLUMNS, BaselineEgo
from benchmark.interactions.contacts import (
    AHEAD_RAD,
    BEHIND_RAD,
    EGO_MASS_KG,
    KINDS,
    ContactPairs,
    compute_bearing,
    compute_delta_v,
    compute_fatal_probability,
    is_agent_category,
    is_at_fault,
    mass_kg,
)
from benchmark.interactions.driver_simulation import DrivingSituation
from benchmark.interactions.golden_interactions import differ, is_fragile, read_interaction
from benchmark.interactions.tracks import STEP_S
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder

NEVER_S: Final = 1e6
"""Longer times come from speeds that differ by rounding alone."""


def compare_interactions(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare series and summaries."""
    stored = folder.arrays("encounters.npz")
    for facts in folder.facts("encounters.json"):
        severity, golden, here = measure_severity(read_interaction(stored, facts), 0), facts["severity"], facts["name"]
        at = comparison.at(here, "encounters: ")
        for name in ("gap", "ttc", "btn"):
            if not is_fragile(facts, name):
                _compare_series(at, name, getattr(severity, name), stored.floats(f"{here}/{name}", None, gaps=True))
        values = {
            "min_gap": severity.min_gap,
            "first_contact": severity.contact_s,
            "min_ttc": severity.min_ttc,
            "tet": severity.tet,
            "tit": severity.tit,
            "pet": severity.pet,
            "max_btn": severity.max_btn,
        }
        for name, value in values.items():
            if not is_fragile(facts, name):
                at.verdicts(f"whether there is a {name}", (value is None) != (golden[name] is None))
                if value is not None and golden[name] is not None:
                    at.numbers(name, value, golden[name])
        if not is_fragile(facts, "first"):
            at.verdicts("first", severity.first != golden["first"])


def _compare_series(comparison: Comparison, name: str, ours: Floats, golden: Floats) -> None:
    """Numbers of which some are not counted (NaN) or never come (infinite)."""
    ours, golden = (np.where(values > NEVER_S, np.inf, values) for values in (ours, golden))
    same = (np.isnan(ours) == np.isnan(golden)) & (np.isinf(ours) == np.isinf(golden))
    comparison.verdicts(f"samples with {name}", ~same)
    both = np.isfinite(ours) & np.isfinite(golden)
    comparison.numbers(name, ours[both], golden[both])


ONSET_S: Final = 0.5
"""When the manoeuvres of ``manoeuvres.npz`` start."""
_NAME_TOLERANCE: Final = 1e-3
"""A manoeuvre is named by its braking and offset, which may be rounded there."""


def compare_avoidability(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare last chances; encounters without one in the set must have no contact."""
    stored = folder.arrays("encounters.npz")
    for facts in folder.facts("encounters.json"):
        if is_fragile(facts, "last_chance"):
            continue
        base, at = (
            BaselineEgo(DrivingSituation.of(read_interaction(stored, facts))),
            comparison.at(facts["name"], "last chance: "),
        )
        threatened = "last_chance" in facts
        at.verdicts("threatened", (base.contact is None) == threatened)
        if threatened and base.contact is not None:
            _compare_last_avoidable_time(at, base, facts, facts["last_chance"])


def _compare_last_avoidable_time(
    comparison: Comparison, base: BaselineEgo, facts: dict[str, Any], golden: dict[str, Any]
) -> None:
    last_chance = base.last_chance()
    assert last_chance.contact is not None
    comparison.verdicts("time of contact", differ(last_chance.contact.time, golden["contact"]))
    comparison.verdicts("class of contact", last_chance.contact.kind.value != golden["class"])
    comparison.verdicts("time", differ(last_chance.time, golden["last_chance"]))
    start = float(base.situation.times[0])
    wanted = {name: golden[name] for name in golden if not is_fragile(facts, name)}
    if "evaluated" in wanted:
        ours, theirs = {str(number): first for number, first in last_chance.evaluated.items()}, wanted["evaluated"]
        comparison.verdicts(
            "evaluations", [ours.get(evaluation) != theirs.get(evaluation) for evaluation in sorted({*ours, *theirs})]
        )
    if "scan" in wanted:
        scan = wanted["scan"]
        onsets = start + STEP_S * np.arange(min(len(scan), len(base.situation.times)))
        firsts = [base.try_from(onset).first for onset in onsets.tolist()]
        comparison.verdicts("scan of all onsets", [a != b for a, b in zip(scan, firsts + [None] * len(scan))])
    if "survivors_at_0" in wanted:
        comparison.same("manoeuvres from the start", base.try_from(start).succeeds, wanted["survivors_at_0"])


def compare_manoeuvres(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare manoeuvres step by step, up to their end or failure."""
    stored, traces = folder.arrays("encounters.npz"), folder.arrays("manoeuvres.npz")
    encounters = {facts["name"]: facts for facts in folder.facts("encounters.json")}
    for label in sorted(traces.names):
        name, *wanted = label.rsplit("/", 2)
        near = [
            np.allclose(manoeuvre_values, np.array(wanted, float), rtol=0, atol=_NAME_TOLERANCE)
            for manoeuvre_values in MANOEUVRES
        ]
        golden = traces.floats(label, None, STATE_COLUMNS)
        tried = BaselineEgo(DrivingSituation.of(read_interaction(stored, encounters[name]))).try_from(ONSET_S)
        ours, failed = tried.states[near.index(True)], int(tried.failed[near.index(True)])
        ended, both = len(ours) if failed < 0 else failed + 1, min(len(ours), len(golden))
        comparison.verdicts("manoeuvres: when they end", len(golden) not in (ended, ended - 1), where=label)
        comparison.numbers("manoeuvres: states", ours[:both], golden[:both], where=label)


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
    pairs = ContactPairs(
        ego=_read_column(cases, "ego"),
        ego_speed=_read_column(cases, "ego_speed"),
        other=_read_column(cases, "other"),
        other_velocity=_read_column(cases, "other_velocity"),
        is_agent=np.array([is_agent_category(case["category"]) for case in cases]),
    )
    _compare_expected(comparison.at("", "contacts: "), cases, pairs)
    _compare_official(comparison.at("", "official: "), [case["official_nuplan"] for case in cases], pairs)


def _compare_expected(comparison: Comparison, cases: _Cases, pairs: ContactPairs) -> None:
    expected = [case["expected"] for case in cases]
    own, others = compute_delta_v(pairs.impact_speed, np.array([mass_kg(case["category"]) for case in cases]))
    ours = {
        "gap": pairs.gap,
        "impact_speed": pairs.impact_speed,
        "delta_v_ego": own,
        "delta_v_other": others,
        "delta_v_nuplan": pairs.delta_v_nuplan,
        "p_fatal_ego": compute_fatal_probability(own),
    }
    # Verdicts that are stable when all poses move a little.
    counted = {name: np.array([not is_fragile(case, name) for case in cases]) for name in (*ours, "ttc", "type")}
    for name, values in ours.items():
        comparison.numbers(name, values[counted[name]], _read_column(expected, name)[counted[name]])
    our_ttc, ttc = (times[counted["ttc"]] for times in (pairs.time_to_contact, _read_times(expected, "ttc")))
    comparison.same("whether they ever touch", np.isinf(our_ttc), np.isinf(ttc))
    both = np.isfinite(our_ttc) & np.isfinite(ttc)
    comparison.numbers("ttc (s)", our_ttc[both], ttc[both])
    comparison.same("type", [KINDS[kind].value for kind in pairs.kinds], _read_words(expected, "type"), counted["type"])


def _compare_official(comparison: Comparison, official: _Cases, pairs: ContactPairs) -> None:
    kinds, angle = [KINDS[kind] for kind in pairs.kinds], compute_bearing(pairs.ego, pairs.other)
    comparison.same("contact", pairs.gap == 0.0, _read_words(official, "contact"))
    comparison.same(
        "type",
        [kind.value for kind in kinds],
        [_SAME.get(official_case["type"], "unknown") for official_case in official],
    )
    verdicts = {
        "at_fault_one_lane": [is_at_fault(kind, False) for kind in kinds],
        "at_fault_several_lanes": [is_at_fault(kind, True) for kind in kinds],
        "ahead": angle < AHEAD_RAD,
        "behind": angle > BEHIND_RAD,
    }
    for name, ours in verdicts.items():
        comparison.same(name, ours, _read_words(official, name))
    near = np.isclose(pairs.time_to_contact_nuplan, _read_times(official, "ttc_stepped"), rtol=0, atol=_STEPPED_S)
    comparison.verdicts("stepped ttc", ~near)
    comparison.numbers("delta_v (m/s)", pairs.delta_v_nuplan, _read_column(official, "delta_v"))


def _read_column(cases: _Cases, name: str) -> Floats:
    return np.array([case[name] for case in cases], np.float64)


def _read_times(cases: _Cases, name: str) -> Floats:
    """Times to a contact, infinite where there is none."""
    return np.array([np.inf if case[name] is None else case[name] for case in cases], np.float64)


def _read_words(cases: _Cases, name: str) -> list[Any]:
    return [case[name] for case in cases]
