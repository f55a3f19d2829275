"""Drivers along recorded paths against a second implementation of the specification."""

from pathlib import Path
from typing import Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.drivers.straight_road import DriverArrays
from benchmark.geometry import Floats
from benchmark.interactions.driving import Rung, Situation, drive
from benchmark.interactions.outcomes import Outcome, Surroundings
from benchmark.interactions.reaction import Driver
from benchmark.interactions.sight import first_visible
from benchmark.interactions.tracks import Tracks
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_facts import GoldenFacts

TOLERANCE: Final = 1e-6
_SAME_TIME_S: Final = 1e-9
_ADVERSARY_ONLY: Final = "_adversary_only"
_ADDED: Final = "vehicle.car"
"""Category of the adversaries that are added to recorded scenes."""


def compare_encounters(comparison: Comparison, folder: Path) -> None:
    """Encounters of two tracks.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = DriverArrays.read(folder / "encounters.npz")
    for facts in GoldenFacts.read_list(folder / "encounters.json"):
        name = facts.text("name")
        outcomes = _driven(facts, stored.encounter(name, facts.text("category")), None)
        for driver, outcome in outcomes.items():
            golden = facts.inner("drivers").inner(driver)
            if golden.fragile():
                continue
            _compare_outcome(comparison, "encounters", outcome, golden, name)
            for quantity in ("speed", "station"):
                theirs = stored.floats(f"{name}/{driver}/{quantity}", None)
                _series(comparison, f"encounters: {quantity}", getattr(outcome, quantity), theirs, name)
            unsafe = stored.verdicts(f"{name}/{driver}/unsafe", None)
            same = len(unsafe) == len(outcome.unsafe)
            wrong = outcome.unsafe != unsafe if same else np.ones(len(unsafe), np.bool_)
            comparison.verdicts("encounters: unsafe steps", wrong, where=name)


def compare_scenes(comparison: Comparison, folder: Path) -> None:
    """Whole scenes with an adversary each.

    Args:
        comparison: Takes the errors.
        folder: The set.

    Raises:
        InputError: If the files cannot be used.
    """
    stored = DriverArrays.read(folder / "scenes.npz")
    for facts in GoldenFacts.read_list(folder / "scenes.json"):
        scene, kind, adversary = facts.text("scene"), facts.text("adversary"), facts.whole("index")
        where, tracks = f"{scene} {kind}", _scene_tracks(stored, scene, kind)
        if not 0 <= adversary < len(tracks):
            raise InputError(f"{facts.path}: {where} has no object {adversary}; get the set again")
        seen = first_visible(tracks, adversary, tracks.grid())
        golden_seen = facts.number("first_visible") if facts.known("first_visible") else None
        comparison.verdicts("scenes: first visible", _differ(seen, golden_seen), where=where)
        for driver, outcome in _driven(facts, tracks, adversary).items():
            golden = facts.inner("drivers").inner(driver)
            if golden.fragile():
                continue
            _compare_outcome(comparison, "scenes", outcome, golden, where)
            station = np.array([outcome.station[-1]])
            comparison.numbers("scenes: last station (m)", station, golden.numbers("end_station")[None], TOLERANCE)
            steps = np.array([np.count_nonzero(outcome.unsafe) != golden.whole("unsafe_steps")])
            comparison.verdicts("scenes: unsafe steps", steps, where=where)
            reason = golden.whole("first_reason") if golden.known("first_reason") else None
            comparison.verdicts("scenes: reason", np.array([outcome.reason != reason]), where=where)


def _scene_tracks(stored: DriverArrays, scene: str, kind: str) -> Tracks:
    seconds = stored.floats(f"{scene}/seconds", None)
    if len(seconds) < 2 or (np.diff(seconds) <= 0).any():
        raise InputError(f"{stored.path}: the times of {scene} do not rise; get the set again")
    frames = len(seconds)
    agents, added = stored.floats(f"{scene}/agents", None, frames, 5), stored.floats(f"{scene}/{kind}", frames, 5)
    valid = stored.verdicts(f"{scene}/valid", len(agents), frames)
    return Tracks(
        seconds=seconds,
        ego=stored.floats(f"{scene}/ego", frames, 5),
        agents=np.concatenate([agents, added[None]]),
        valid=np.concatenate([valid, np.ones((1, frames), np.bool_)]),
        categories=(*stored.words(f"{scene}/categories", len(agents)), _ADDED),
    )


def _driven(facts: GoldenFacts, tracks: Tracks, adversary: int | None) -> dict[str, Outcome]:
    names = list(facts.inner("drivers"))
    try:
        rungs = [Rung(Driver(name.removesuffix(_ADVERSARY_ONLY)), name.endswith(_ADVERSARY_ONLY)) for name in names]
    except ValueError as error:
        raise InputError(
            f"{facts.path}: {facts.where} has a driver that is not known ({error}); known are {', '.join(Driver)}"
        ) from None
    situation = Situation.of(tracks, adversary=adversary)
    surroundings = Surroundings.of(situation)
    return dict(zip(names, map(surroundings.outcome, drive(situation, rungs))))


def _compare_outcome(comparison: Comparison, family: str, ours: Outcome, golden: GoldenFacts, where: str) -> None:
    met = golden.known("contact")
    comparison.verdicts(f"{family}: survives", np.array([ours.survives == met]), where=where)
    reacted = golden.number("reacted") if golden.known("reacted") else None
    comparison.verdicts(f"{family}: first unsafe step", _differ(ours.reacted, reacted), where=where)
    slowest = np.array([ours.speed.min()])
    comparison.numbers(f"{family}: slowest (m/s)", slowest, golden.numbers("min_speed")[None], TOLERANCE, where=where)
    beyond = np.array([ours.beyond_end != golden.flag("beyond_end")])
    comparison.verdicts(f"{family}: past the recorded path", beyond, where=where)
    if ours.contact is None or not met:
        return
    contact, theirs = ours.contact, golden.inner("contact")
    comparison.verdicts(f"{family}: time of contact", _differ(contact.time, theirs.number("time")), where=where)
    wrong = [contact.agent != theirs.whole("agent"), contact.kind.value != theirs.text("type")]
    comparison.verdicts(f"{family}: who is hit, and how", np.array(wrong), where=where)
    speeds = np.array([contact.ego_speed, contact.other_speed, contact.impact_speed])
    golden_speeds = np.array([theirs.number(name) for name in ("ego_speed", "other_speed", "impact_speed")])
    comparison.numbers(f"{family}: speeds at contact (m/s)", speeds, golden_speeds, TOLERANCE, where=where)
    boxes = np.array([contact.ego, contact.other])
    golden_boxes = np.array([theirs.numbers("ego_box", 5), theirs.numbers("other_box", 5)])
    comparison.numbers(f"{family}: place of contact (m)", boxes[:, :4], golden_boxes[:, :4], TOLERANCE, where=where)
    headings = (boxes[:, 4], golden_boxes[:, 4])
    comparison.numbers(f"{family}: headings at contact (rad)", *headings, TOLERANCE, angle=True, where=where)


def _series(comparison: Comparison, quantity: str, ours: Floats, golden: Floats, where: str) -> None:
    """A run that ends at another step is wrong as a whole."""
    error = np.abs(ours - golden) if ours.shape == golden.shape else np.full(golden.shape, np.inf)
    comparison.errors(quantity, error, TOLERANCE, where=where)


def _differ(ours: float | None, golden: float | None) -> "np.ndarray[tuple[int], np.dtype[np.bool_]]":
    if ours is None or golden is None:
        return np.array([ours is not golden])
    return np.array([abs(ours - golden) > _SAME_TIME_S])
