"""Conflict of an adversary with the ego: its kind, who was first on the recording and now, and one sentence."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.records.attempts import Encroachment
from benchmark.scene import Scene
from generation.labels.interactions import PathInteraction, compute_path_interaction
from generation.labels.labelling import compute_labels, read_agent_boxes
from generation.labels.manoeuvres import Manoeuvre, find_encroachment

SAME_WAY_RAD: Final = np.deg2rad(30.0)
ONCOMING_RAD: Final = np.deg2rad(150.0)
DIGITS: Final = 2
PARKED_M: Final = 3.0
_NOUNS: Final = {
    "vehicle.truck": "truck", "vehicle.trailer": "trailer", "vehicle.construction": "construction vehicle",
    "vehicle.bicycle": "cyclist", "vehicle.motorcycle": "motorcyclist",
}  # fmt: skip
_VERBS: Final = {
    Manoeuvre.ONCOMING: "comes towards the ego",
    Manoeuvre.CROSSING: "crosses the ego's path",
    Manoeuvre.CUT_IN_LEFT: "cuts in from the left",
    Manoeuvre.CUT_IN_RIGHT: "cuts in from the right",
    Manoeuvre.BRAKING_AHEAD: "brakes ahead",
    Manoeuvre.BLOCKING: "blocks the way",
    Manoeuvre.SQUEEZING_LEFT: "squeezes the ego from the left",
    Manoeuvre.SQUEEZING_RIGHT: "squeezes the ego from the right",
    Manoeuvre.OVERTAKING_LEFT: "overtakes on the left",
    Manoeuvre.OVERTAKING_RIGHT: "overtakes on the right",
    Manoeuvre.TAILGATING: "tailgates",
    Manoeuvre.BLIND_SPOT_LEFT: "stays in the blind spot on the left",
    Manoeuvre.BLIND_SPOT_RIGHT: "stays in the blind spot on the right",
    Manoeuvre.LEADING: "drives ahead",
    Manoeuvre.FOLLOWING: "follows",
    Manoeuvre.PASSING_WIDE: "passes at a distance",
    Manoeuvre.DISTANT: "keeps away",
}


def describe_conflicts(
    recorded: Scene, adversarial: Scene, launches: Sequence[tuple[str, int]]
) -> list[dict[str, Any]]:
    """Conflict of each adversary, as JSON values.

    Args:
        recorded: The scene as it was recorded.
        adversarial: The same with its adversaries.
        launches: Instance of each adversary, and the frame from which it leaves its recording.

    Returns:
        Of each ``adversary``: ``kind`` (same-way, crossing, oncoming, or none), who was first on the closest piece of
        the ego's path that both used, ``first_recorded`` and ``first_now`` (ego, other or none), ``pet_recorded_s``
        and ``pet_now_s`` (post-encroachment times), ``manoeuvre`` with ``pull-out`` where it stood all the time, and a
        ``sentence``.
    """
    return [_describe(recorded, adversarial, name, start) for name, start in launches]


def _describe(recorded: Scene, adversarial: Scene, name: str, start: int) -> dict[str, Any]:
    if name not in recorded.agents.ids or name not in adversarial.agents.ids:
        raise InputError(f"{adversarial.name} has no adversary {name} of its recording; generate the split again")
    before, was = recorded.agents.ids.index(name), _meet(recorded, recorded.agents.ids.index(name), start)
    agent = adversarial.agents.ids.index(name)
    now = _meet(adversarial, agent, start)
    old, new = (None if met is None else find_encroachment(met) for met in (was, now))
    labels = compute_labels(adversarial, agent, start)
    stood = np.ptp(recorded.agents.position[before, recorded.agents.valid[before], :2], axis=0).max() < PARKED_M
    values = {
        "adversary": name,
        "kind": "none" if new is None or now is None else _find_kind(now, new),
        "first_recorded": _tell_first(old),
        "first_now": _tell_first(new),
        "pet_recorded_s": None if old is None else round(old.seconds, DIGITS),
        "pet_now_s": None if new is None else round(new.seconds, DIGITS),
        "manoeuvre": labels.manoeuvre,
        "pull_out": bool(stood),
    }
    noun = next(
        (word for prefix, word in _NOUNS.items() if adversarial.agents.categories[agent].startswith(prefix)), "car"
    )
    noun = "bus" if "bus" in adversarial.agents.categories[agent] else noun
    noun = "pedestrian" if adversarial.agents.categories[agent].startswith("human") else noun
    return {**values, "sentence": _build_sentence(noun, values)}


def _meet(scene: Scene, agent: int, start: int) -> PathInteraction | None:
    present = scene.agents.valid[agent]
    if not present[start:].any():
        return None
    return compute_path_interaction(scene.ego.boxes, read_agent_boxes(scene, agent), scene.seconds, present, start)


def _find_kind(met: PathInteraction, closest: Encroachment) -> str:
    at = int(np.argmin(np.abs(met.seconds - closest.time_s)))
    turn = float(np.abs(met.other.turn[at]))
    return "same-way" if turn < SAME_WAY_RAD else "oncoming" if turn > ONCOMING_RAD else "crossing"


def _tell_first(closest: Encroachment | None) -> str:
    return "none" if closest is None else "ego" if closest.ego_first else "other"


def _build_sentence(noun: str, values: dict[str, Any]) -> str:
    start = "pulls out and " if values["pull_out"] else ""
    does = f"the {noun} {start}{_VERBS[Manoeuvre(values['manoeuvre'])]}"
    now = {"ego": " {:.1f} s behind the ego", "other": " {:.1f} s ahead of the ego", "none": " without using its path"}
    was = {"ego": "it was {:.1f} s behind", "other": "it was {:.1f} s ahead", "none": "it did not use the ego's path"}
    here, there = now[values["first_now"]], was[values["first_recorded"]]
    return f"{does}{here.format(values['pet_now_s'])}; on the recording {there.format(values['pet_recorded_s'])}"
