"""Last chances of encounters: every evaluation, and some manoeuvres in full."""

from typing import Any, Final

import numpy as np

from benchmark.interactions.driving import Situation
from benchmark.interactions.golden import differ, encounter, fragile
from benchmark.interactions.last_chance import Base
from benchmark.interactions.manoeuvres import MANOEUVRES, STATE_COLUMNS
from benchmark.interactions.tracks import STEP_S
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

ONSET_S: Final = 0.5
"""When the manoeuvres of ``manoeuvres.npz`` start."""
_NAME_TOLERANCE: Final = 1e-3
"""A manoeuvre is named by its braking and offset, which may be rounded there."""


def compare_last_chances(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare last chances; encounters without one in the set must have no contact."""
    stored = folder.arrays("encounters.npz")
    for facts in folder.facts("encounters.json"):
        if fragile(facts, "last_chance"):
            continue
        base, at = Base(Situation.of(encounter(stored, facts))), comparison.at(facts["name"], "last chance: ")
        threatened = "last_chance" in facts
        at.verdicts("threatened", (base.contact is None) == threatened)
        if threatened and base.contact is not None:
            _compare_chance(at, base, facts, facts["last_chance"])


def _compare_chance(comparison: Comparison, base: Base, facts: dict[str, Any], golden: dict[str, Any]) -> None:
    found = base.last_chance()
    assert found.contact is not None
    comparison.verdicts("time of contact", differ(found.contact.time, golden["contact"]))
    comparison.verdicts("class of contact", found.contact.kind.value != golden["class"])
    comparison.verdicts("time", differ(found.time, golden["last_chance"]))
    start = float(base.situation.times[0])
    wanted = {name: golden[name] for name in golden if not fragile(facts, name)}
    if "evaluated" in wanted:
        ours, theirs = {str(number): first for number, first in found.evaluated.items()}, wanted["evaluated"]
        comparison.verdicts("evaluations", [ours.get(each) != theirs.get(each) for each in sorted({*ours, *theirs})])
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
        near = [np.allclose(each, np.array(wanted, float), rtol=0, atol=_NAME_TOLERANCE) for each in MANOEUVRES]
        golden = traces.floats(label, None, STATE_COLUMNS)
        tried = Base(Situation.of(encounter(stored, encounters[name]))).try_from(ONSET_S)
        ours, failed = tried.states[near.index(True)], int(tried.failed[near.index(True)])
        ended, both = len(ours) if failed < 0 else failed + 1, min(len(ours), len(golden))
        comparison.verdicts("manoeuvres: when they end", len(golden) not in (ended, ended - 1), where=label)
        comparison.numbers("manoeuvres: states", ours[:both], golden[:both], where=label)
