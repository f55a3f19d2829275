"""Drivers along recorded paths against a second implementation of the specification."""

from typing import Any, Final

import numpy as np

from benchmark.interactions.driver_outcomes import CollisionChecker, DriverOutcome
from benchmark.interactions.driver_simulation import (
    DrivingSituation,
    ReferenceDriver,
    find_first_visible_time,
    simulate_drivers,
)
from benchmark.interactions.golden_interactions import differ, is_fragile, read_interaction
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

_ADVERSARY_ONLY: Final = "_adversary_only"
_ADDED: Final = "vehicle.car"
"""Category of the adversaries that are added to recorded scenes."""


def compare_interactions(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare encounters of two tracks."""
    stored = folder.arrays("encounters.npz")
    for facts in folder.facts("encounters.json"):
        name = facts["name"]
        at = comparison.at(name, "encounters: ")
        for driver, outcome in _run_drivers(facts, read_interaction(stored, facts), None).items():
            if is_fragile(facts["drivers"][driver]):
                continue
            _compare_outcome(at, outcome, facts["drivers"][driver])
            for quantity in ("speed", "station"):
                at.series(quantity, getattr(outcome, quantity), stored.floats(f"{name}/{driver}/{quantity}", None))
            unsafe = stored.verdicts(f"{name}/{driver}/unsafe", None)
            # A run that ends at another step is wrong as a whole.
            same = len(unsafe) == len(outcome.unsafe)
            at.verdicts("unsafe steps", outcome.unsafe != unsafe if same else np.ones(len(unsafe), np.bool_))


def compare_scenes(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare whole scenes with an adversary each."""
    stored = folder.arrays("scenes.npz")
    for facts in folder.facts("scenes.json"):
        adversary, tracks = facts["index"], _read_tracks(stored, facts["scene"], facts["adversary"])
        at = comparison.at(f"{facts['scene']} {facts['adversary']}", "scenes: ")
        visible_from = find_first_visible_time(tracks, adversary, tracks.grid())
        at.verdicts("first visible", differ(visible_from, facts["first_visible"]))
        for driver, outcome in _run_drivers(facts, tracks, adversary).items():
            golden = facts["drivers"][driver]
            if is_fragile(golden):
                continue
            _compare_outcome(at, outcome, golden)
            comparison.numbers("scenes: last station (m)", outcome.station[-1], golden["end_station"])
            at.verdicts("unsafe steps", bool(np.count_nonzero(outcome.unsafe) != golden["unsafe_steps"]))
            at.verdicts("reason", outcome.reason != golden["first_reason"])


def _read_tracks(stored: GoldenArrays, scene: str, kind: str) -> ContinuousTracks:
    seconds = stored.floats(f"{scene}/seconds", None)
    frames = len(seconds)
    agents, added = stored.floats(f"{scene}/agents", None, frames, 5), stored.floats(f"{scene}/{kind}", frames, 5)
    valid = stored.verdicts(f"{scene}/valid", len(agents), frames)
    return ContinuousTracks(
        seconds=seconds,
        ego=stored.floats(f"{scene}/ego", frames, 5),
        agents=np.concatenate([agents, added[None]]),
        valid=np.concatenate([valid, np.ones((1, frames), np.bool_)]),
        categories=(*stored.texts(f"{scene}/categories", len(agents)), _ADDED),
    )


def _run_drivers(facts: dict[str, Any], tracks: ContinuousTracks, adversary: int | None) -> dict[str, DriverOutcome]:
    names = facts["drivers"]
    rungs = [
        ReferenceDriver(Driver(name.removesuffix(_ADVERSARY_ONLY)), name.endswith(_ADVERSARY_ONLY)) for name in names
    ]
    situation = DrivingSituation.of(tracks, adversary=adversary)
    return dict(zip(names, map(CollisionChecker.of(situation).find_outcome, simulate_drivers(situation, rungs))))


def _compare_outcome(comparison: Comparison, ours: DriverOutcome, golden: dict[str, Any]) -> None:
    contact, theirs = ours.contact, golden["contact"]
    comparison.verdicts("survives", ours.survives == (theirs is not None))
    comparison.verdicts("first unsafe step", differ(ours.reacted, golden["reacted"]))
    comparison.numbers("slowest (m/s)", ours.speed.min(), golden["min_speed"])
    comparison.verdicts("past the recorded path", ours.beyond_end != golden["beyond_end"])
    if contact is None or theirs is None:
        return
    comparison.verdicts("time of contact", differ(contact.time, theirs["time"]))
    comparison.verdicts("who is hit, and how", [contact.agent != theirs["agent"], contact.kind.value != theirs["type"]])
    speeds = ("ego_speed", "other_speed", "impact_speed")
    comparison.numbers(
        "speeds at contact (m/s)", [getattr(contact, name) for name in speeds], [theirs[name] for name in speeds]
    )
    boxes, golden_boxes = np.array([contact.ego, contact.other]), np.array([theirs["ego_box"], theirs["other_box"]])
    comparison.numbers("place of contact (m)", boxes[:, :4], golden_boxes[:, :4])
    comparison.numbers("headings at contact (rad)", boxes[:, 4], golden_boxes[:, 4], angle=True)
