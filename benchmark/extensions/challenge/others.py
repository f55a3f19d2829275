"""Everybody of a scene against the recording: who moves otherwise, who is missing, made up, or labelled otherwise."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.extensions.challenge.counterparts import Counterparts, Keyframes
from benchmark.extensions.challenge.rules import Rules
from benchmark.geometry import Bools, Floats
from benchmark.interactions.tracks import Integers
from benchmark.records.challenge import Reason
from benchmark.report.words import counted
from benchmark.scene import Annotations, Scene

_COUNTS: Final = ("visibility", "num_lidar_pts", "num_radar_pts")
_WORDS: Final = {
    "attribute": "attribute",
    "visibility": "visibility",
    "num_lidar_pts": "lidar points",
    "num_radar_pts": "radar points",
}
_NAMED: Final = 3
"""Objects that a sentence names."""


@dataclass(frozen=True, slots=True)
class Differing:
    """An object that is not everywhere where it was recorded.

    Attributes:
        at: (C,) common keyframes at which it is elsewhere, or there in one of the two alone.
        distance: (C,) how far it is from where it was recorded, 0 where it is not in both.
    """

    agent: int
    recorded: int
    at: Bools
    distance: Floats

    @property
    def first(self) -> int:
        """Number of the first common keyframe at which it differs."""
        return int(np.argmax(self.at))

    @property
    def farthest_m(self) -> float:
        """Largest distance from where it was recorded."""
        return float(self.distance.max(initial=0.0))


def differing(entry: Scene, recorded: Scene, known: Counterparts, common: Keyframes, rules: Rules) -> list[Differing]:
    """Objects of both scenes that move otherwise: named adversaries of the entry first, then by distance."""
    found = []
    mine, theirs = entry.annotations, recorded.annotations
    for agent, other in known.pairs:
        here, there = mine.valid[agent, common.here], theirs.valid[other, common.there]
        offset = mine.position[agent, common.here] - theirs.position[other, common.there]
        turn = mine.rotation[agent, common.here] - theirs.rotation[other, common.there]
        off = np.abs(offset).max(axis=1) > rules.unchanged.position_m
        off |= np.abs(turn).max(axis=1) > rules.unchanged.rotation
        at = (here != there) | (here & there & off)
        if at.any():
            found.append(Differing(agent, other, at, np.where(here & there, np.hypot(*offset[:, :2].T), 0.0)))
    named = {entry.agents.ids.index(name) for name in entry.adversaries if name in entry.agents.ids}
    return sorted(found, key=lambda each: (each.agent not in named, -each.farthest_m))


def who_differs(
    entry: Scene, recorded: Scene, known: Counterparts, found: Sequence[Differing], common: Keyframes, rules: Rules
) -> Iterator[Reason]:
    """Check that few enough vehicles differ, none is missing or made up, and the entry names those that differ."""
    for indices, scene, said in (
        (known.removed, recorded, "leaves out"),
        (known.added, entry, "has, and the recording has not,"),
    ):
        if indices:
            yield Reason(rule="changed.most", sentence=f"{said} {_listed([_called(scene, each) for each in indices])}")
    if len(found) > rules.changed.most:
        beyond = found[rules.changed.most :]
        listed = _listed([_moved(entry, each, common) for each in beyond])
        yield Reason(
            rule="changed.most",
            sentence=f"changes {counted(len(found), 'object')} and may change {rules.changed.most}: besides, {listed}",
        )
    if len(found) < rules.changed.least:
        yield Reason(
            rule="changed.least",
            sentence=f"changes {counted(len(found), 'vehicle')} of the recording and must change {rules.changed.least}",
        )
    if entry.adversaries:
        changed = {entry.agents.ids[each.agent] for each in found}
        if wrong := [name for name in entry.adversaries if name not in changed]:
            yield Reason(
                rule="changed.least",
                sentence=f"names {wrong[0][:12]} as its adversary, which moves as it was recorded",
            )
        elif len(found) <= rules.changed.most and (unnamed := sorted(changed - set(entry.adversaries))):
            yield Reason(rule="changed.most", sentence=f"changes {unnamed[0][:12]}, which it does not name")


def labels_of(
    entry: Scene, recorded: Scene, known: Counterparts, found: Sequence[Differing], common: Keyframes, rules: Rules
) -> Iterator[Reason]:
    """Check that category, size, attributes, visibility and points are as recorded.

    Where a changed vehicle is elsewhere, its entry decides on its looks and number of points. One point it must have,
    since protocols leave out objects that no sensor could have seen.
    """
    # A track may leave the recorded one just after a keyframe, whose attribute says so already.
    elsewhere = {each.agent: each.at | np.append(each.at[1:], False) for each in found}
    wrong: dict[str, list[str]] = {}
    for agent, other in known.pairs:
        name = _called(entry, agent)
        if entry.agents.categories[agent] != recorded.agents.categories[other]:
            was = recorded.agents.categories[other]
            wrong.setdefault("changed.categories", []).append(f"the category of {name}, recorded as {was}")
        both = entry.annotations.valid[agent, common.here] & recorded.annotations.valid[other, common.there]
        here, there = common.here[both], common.there[both]
        size = np.abs(entry.annotations.size[agent, here] - recorded.annotations.size[other, there])
        if size.max(initial=0.0) > rules.unchanged.position_m or _grows(entry.annotations, agent, elsewhere):
            wrong.setdefault("unchanged.position_m", []).append(f"the size of {name}")
        if rules.unchanged.points:
            free = elsewhere[agent][both] if agent in elsewhere else np.zeros(len(here), np.bool_)
            for field in _labels_differ(entry, recorded, (agent, here[~free]), (other, there[~free])):
                wrong.setdefault("unchanged.points", []).append(f"the {_WORDS[field]} of {name}")
    for rule, listed in wrong.items():
        yield Reason(rule=rule, sentence=f"alters {_listed(listed)}")
    for each in found:
        at = common.here[each.at & entry.annotations.valid[each.agent, common.here]]
        if (entry.annotations.num_lidar_pts[each.agent, at] < 1).any():
            yield Reason(
                rule="unchanged.points",
                sentence=f"has no lidar point on {_called(entry, each.agent)} where it is changed, so that protocols "
                "leave it out",
            )


def _grows(notes: Annotations, agent: int, elsewhere: dict[int, Bools]) -> bool:
    """Whether a changed vehicle has several sizes in the entry."""
    if agent not in elsewhere:
        return False
    size = notes.size[agent, notes.valid[agent]]
    return bool((size != size[0]).any())


def _labels_differ(
    entry: Scene, recorded: Scene, mine: tuple[int, Integers], theirs: tuple[int, Integers]
) -> Iterator[str]:
    """Fields of annotations that differ somewhere."""
    one, other = entry.annotations, recorded.annotations
    if (one.attribute[mine] != other.attribute[theirs]).any():
        yield "attribute"
    # Where a recording says nothing of visibility it counted no points either, and whoever writes it again says one.
    said = other.visibility[theirs] != 0
    for field in _COUNTS:
        values, recorded_values = getattr(one, field)[mine], getattr(other, field)[theirs]
        if (values != recorded_values)[said].any():
            yield field


def changed_vehicle(
    entry: Scene, recorded: Scene, each: Differing, common: Keyframes, rules: Rules
) -> Iterator[Reason]:
    """Check that a changed vehicle is of a permitted kind, begins where it was recorded, and is there to the end."""
    name = _called(entry, each.agent)
    if entry.agents.categories[each.agent] not in rules.changed.categories:
        yield Reason(rule="changed.categories", sentence=f"changes {name}, which no entry may")
    mine, theirs = entry.annotations, recorded.annotations
    valid, was = mine.valid[each.agent], theirs.valid[each.recorded]
    if not valid.any():
        return
    first = int(np.argmax(valid[common.here]))
    if was.any() and int(np.argmax(valid)) != int(common.here[np.argmax(was[common.there])]):
        yield Reason(
            rule="changed.start_m",
            sentence=f"lets {name} begin at keyframe {int(np.argmax(valid))}, it was recorded from keyframe "
            f"{int(np.argmax(was))}",
        )
    elif each.distance[first] > rules.changed.start_m:
        yield Reason(
            rule="changed.start_m",
            sentence=f"lets {name} begin {each.distance[first]:.3g} m from where it was recorded; "
            f"{rules.changed.start_m:g} m are allowed",
        )
    start = int(common.here[each.first])
    if rules.changed.to_the_end and not valid[start:].all():
        gone = start + int(np.argmin(valid[start:]))
        yield Reason(rule="changed.to_the_end", sentence=f"lets {name} be gone at keyframe {gone}")


def _moved(entry: Scene, each: Differing, common: Keyframes) -> str:
    how = f"by up to {each.farthest_m:.3g} m" if each.farthest_m else "in time or heading"
    return f"{_called(entry, each.agent)} {how} from keyframe {common.here[each.first]} on"


def _called(scene: Scene, agent: int) -> str:
    """How a sentence names an object."""
    return f"{scene.agents.categories[agent]} {scene.agents.ids[agent][:12]}"


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _NAMED
    return "; ".join(names[:_NAMED]) + (f" and {more} more" if more > 0 else "")
