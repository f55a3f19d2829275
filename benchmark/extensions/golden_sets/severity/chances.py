"""Last chances of encounters: every evaluation, and some manoeuvres in full."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.severity.encounters import SAME_TIME_S, TOLERANCE, EncounterArrays
from benchmark.interactions.driving import Situation
from benchmark.interactions.last_chance import Base
from benchmark.interactions.manoeuvres import MANOEUVRES, STATE_COLUMNS
from benchmark.interactions.tracks import STEP_S
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

ONSET_S: Final = 0.5
"""When the manoeuvres of ``manoeuvres.npz`` start."""
_NAME_TOLERANCE: Final = 1e-3
"""A manoeuvre is named by its braking and offset, which may be rounded there."""


def compare_last_chances(comparison: Comparison, folder: Path) -> None:
    """Compare last chances; encounters without one in the set must have no contact.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = EncounterArrays.read(folder / "encounters.npz")
    for facts in GoldenFacts.read_list(folder / "encounters.json"):
        name = facts.text("name")
        if facts.fragile("last_chance"):
            continue
        base = Base(Situation.of(stored.encounter(name, facts.text("category"))))
        threatened = "last_chance" in facts
        comparison.verdicts("last chance: threatened", np.array([(base.contact is None) == threatened]), where=name)
        if threatened and base.contact is not None:
            _compare_chance(comparison, base, facts, name)


def _compare_chance(comparison: Comparison, base: Base, facts: GoldenFacts, where: str) -> None:
    golden = facts.inner("last_chance")
    found = base.last_chance()
    assert found.contact is not None
    early = abs(found.contact.time - golden.number("contact")) > SAME_TIME_S
    comparison.verdicts("last chance: time of contact", np.array([early]), where=where)
    kind = np.array([found.contact.kind.value != golden.text("class")])
    comparison.verdicts("last chance: class of contact", kind, where=where)
    theirs = golden.number("last_chance") if golden.known("last_chance") else None
    differs = (found.time is None) != (theirs is None)
    if found.time is not None and theirs is not None:
        differs = abs(found.time - theirs) > SAME_TIME_S
    comparison.verdicts("last chance: time", np.array([differs]), where=where)
    if "evaluated" in golden and not facts.fragile("evaluated"):
        evaluated = golden.inner("evaluated")
        wanted = {number: evaluated.whole(number) for number in evaluated}
        ours = {str(number): first for number, first in found.evaluated.items()}
        wrong = [ours.get(number) != wanted.get(number) for number in sorted({*ours, *wanted})]
        comparison.verdicts("last chance: evaluations", np.array(wrong, np.bool_), where=where)
    start = float(base.situation.times[0])
    if "scan" in golden and not facts.fragile("scan"):
        scan = golden.numbers("scan", None)
        firsts = [
            base.try_from(start + STEP_S * number).first for number in range(min(len(scan), len(base.situation.times)))
        ]
        wrong_scan = np.ones(len(scan), np.bool_)
        wrong_scan[: len(firsts)] = scan[: len(firsts)] != firsts
        comparison.verdicts("last chance: scan of all onsets", wrong_scan, where=where)
    if "survivors_at_0" in golden and not facts.fragile("survivors_at_0"):
        survivors = golden.flags("survivors_at_0")
        if len(survivors) != len(MANOEUVRES):
            raise InputError(f"{golden.path}: {where} has {len(survivors)} verdicts of manoeuvres, not 25")
        wrong_at_start = base.try_from(start).succeeds != np.array(survivors)
        comparison.verdicts("last chance: manoeuvres from the start", wrong_at_start, where=where)


def compare_manoeuvres(comparison: Comparison, folder: Path) -> None:
    """Compare manoeuvres step by step, up to their end or failure.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = EncounterArrays.read(folder / "encounters.npz")
    categories = {
        facts.text("name"): facts.text("category") for facts in GoldenFacts.read_list(folder / "encounters.json")
    }
    traces = EncounterArrays.read(folder / "manoeuvres.npz")
    if not traces.names:
        raise InputError(f"{traces.path} holds no manoeuvres; get the set again")
    for label in sorted(traces.names):
        name, number = _manoeuvre(traces.path, label, categories)
        golden = traces.floats(label, None, STATE_COLUMNS)
        tried = Base(Situation.of(stored.encounter(name, categories[name]))).try_from(ONSET_S)
        ours, failed = tried.states[number], int(tried.failed[number])
        ended = len(ours) if failed < 0 else failed + 1
        comparison.verdicts("manoeuvres: when they end", np.array([len(golden) not in (ended, ended - 1)]), where=label)
        both = min(len(ours), len(golden))
        comparison.numbers("manoeuvres: states", ours[:both], golden[:both], TOLERANCE, where=label)


def _manoeuvre(path: Path, label: str, categories: dict[str, str]) -> tuple[str, int]:
    try:
        name, braking, offset = label.rsplit("/", 2)
        wanted = (float(braking), float(offset))
    except ValueError:
        raise InputError(f"{path}: {label} is no name of a manoeuvre (encounter/braking/offset)") from None
    near = [number for number, each in enumerate(MANOEUVRES) if np.allclose(each, wanted, rtol=0, atol=_NAME_TOLERANCE)]
    if name not in categories or not near:
        raise InputError(f"{path}: {label} names no encounter of the set, or none of the 25 manoeuvres")
    return name, near[0]
