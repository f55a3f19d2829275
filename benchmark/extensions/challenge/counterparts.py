"""Which object of an entry is which of the recording: tokens may be new, and somebody may be moved or made up."""

from collections import Counter
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from benchmark.geometry import Floats
from benchmark.interactions.tracks import Integers
from benchmark.scene import Scene

FARTHEST_M: Final = 30.0
"""Objects that begin further from one another, or half as far and are of other kinds, are not the same."""
_ANOTHER_KIND_M: Final = 15.0
_SAME_KIND: Final = 2
"""What a common place counts if the category is the same, too; else one."""


@dataclass(frozen=True, slots=True)
class Keyframes:
    """Common keyframes of an entry and its recording: (C,) numbers in the entry, (C,) numbers in the recording."""

    here: Integers
    there: Integers

    @classmethod
    def common(cls, entry: Scene, recorded: Scene) -> "Keyframes":
        """Those with the same time stamps."""
        mine, theirs = entry.timestamps_us[entry.keyframes], recorded.timestamps_us[recorded.keyframes]
        _, here, there = np.intersect1d(mine, theirs, return_indices=True)
        return cls(here, there)


@dataclass(frozen=True, slots=True)
class Counterparts:
    """Objects of an entry matched to those of its recording.

    ``pairs`` holds (index in the entry, index in the recording), sorted by the former.
    """

    pairs: tuple[tuple[int, int], ...]
    added: tuple[int, ...]
    removed: tuple[int, ...]


def counterparts(entry: Scene, recorded: Scene, common: Keyframes) -> Counterparts:
    """Match objects: by instance token, else by places in common, else by where they begin.

    Every object occurs once.
    """
    found: dict[int, int] = {}
    known = {name: index for index, name in enumerate(recorded.agents.ids)}
    for index, name in enumerate(entry.agents.ids):
        if name in known:
            found[index] = known[name]
    _by_places(entry, recorded, common, found)
    _by_beginning(entry, recorded, common, found)
    taken = set(found.values())
    return Counterparts(
        pairs=tuple(sorted(found.items())),
        added=tuple(index for index in range(len(entry.agents)) if index not in found),
        removed=tuple(index for index in range(len(recorded.agents)) if index not in taken),
    )


def _by_places(entry: Scene, recorded: Scene, common: Keyframes, found: dict[int, int]) -> None:
    """Pair objects that are at the same place at the same time, most such places first."""
    taken = set(found.values())
    places: dict[tuple[int, bytes], list[int]] = {}
    for index in range(len(recorded.agents)):
        if index in taken:
            continue
        at = common.there[recorded.annotations.valid[index, common.there]]
        for keyframe, place in zip(at.tolist(), recorded.annotations.position[index, at], strict=True):
            places.setdefault((keyframe, place.tobytes()), []).append(index)
    counts: Counter[tuple[int, int]] = Counter()
    for index in range(len(entry.agents)):
        if index in found:
            continue
        there_too = entry.annotations.valid[index, common.here]
        mine = entry.annotations.position[index, common.here[there_too]]
        for keyframe, place in zip(common.there[there_too].tolist(), mine, strict=True):
            for other in places.get((keyframe, place.tobytes()), ()):
                same = entry.agents.categories[index] == recorded.agents.categories[other]
                counts[index, other] += _SAME_KIND if same else 1
    for (index, other), _ in sorted(counts.items(), key=lambda item: (-item[1], item[0])):
        if index not in found and other not in taken:
            found[index] = other
            taken.add(other)


def _by_beginning(entry: Scene, recorded: Scene, common: Keyframes, found: dict[int, int]) -> None:
    """Pair what is left by distance at the first keyframe of both, together the least."""
    taken = set(found.values())
    mine = [index for index in range(len(entry.agents)) if index not in found]
    theirs = [index for index in range(len(recorded.agents)) if index not in taken]
    if not mine or not theirs:
        return
    costs = np.array([[_cost(entry, index, recorded, other, common) for other in theirs] for index in mine])
    for row, column in zip(*linear_sum_assignment(costs), strict=True):
        if costs[row, column] < FARTHEST_M:
            found[mine[row]] = theirs[column]


def _cost(entry: Scene, index: int, recorded: Scene, other: int, common: Keyframes) -> float:
    valid = entry.annotations.valid[index, common.here] & recorded.annotations.valid[other, common.there]
    if not valid.any():
        return FARTHEST_M
    at = int(np.argmax(valid))
    offset: Floats = (
        entry.annotations.position[index, common.here[at], :2]
        - recorded.annotations.position[other, common.there[at], :2]
    )
    another = entry.agents.categories[index] != recorded.agents.categories[other]
    return min(float(np.hypot(*offset)) + (_ANOTHER_KIND_M if another else 0.0), FARTHEST_M)
