"""Variants of one recording that differ: the next one is the farthest from all that are kept already."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from generation.search.chains import Chain, Tried

FAR_M: Final = 10.0
"""Tracks this far apart are as different as any: another part of the traffic."""


def distance(first: Tried, second: Tried) -> float:
    """Difference of two adversaries of one recording, 0 to 2.

    Returns:
        The mean distance of their centres at the frames at which both act, in units of 10 m and at most 1 at each
        (1 where they never act together), and 1 more where their primary manoeuvres are of different kinds.
    """
    tracks, starts = [], []
    for each in (first, second):
        tracks.append(np.array(each.stored.poses, dtype=np.float64).reshape(-1, 3)[:, :2])
        starts.append(each.attempt.launch_frame or 0)
    begin, end = max(starts), min(start + len(track) for start, track in zip(starts, tracks, strict=True))
    apart = 1.0
    if begin < end:
        here, there = (track[begin - start : end - start] for start, track in zip(starts, tracks, strict=True))
        apart = float(np.minimum(np.linalg.norm(here - there, axis=1) / FAR_M, 1.0).mean())
    kinds = {None if each.attempt.labels is None else each.attempt.labels.manoeuvre for each in (first, second)}
    return apart + (len(kinds) - 1)


def differing(order: Sequence[Chain], most: int) -> list[Chain]:
    """At most ``most`` scenes of each recording, best first, that differ from one another.

    The most challenging one comes first; then, again and again, the one whose least `distance` to those that are
    kept is largest. Scenes with several adversaries are compared link by link.
    """
    kept: set[str] = set()
    for scene in dict.fromkeys(chain.scene_name for chain in order):
        rest = [chain for chain in order if chain.scene_name == scene]
        chosen = [rest.pop(0)]
        while rest and len(chosen) < most:
            least = [min(_apart(chain, other) for other in chosen) for chain in rest]
            # The first of equals is the more challenging one.
            chosen.append(rest.pop(int(np.argmax(least))))
        kept.update(chain.name for chain in chosen)
    return [chain for chain in order if chain.name in kept]


def _apart(first: Chain, second: Chain) -> float:
    return float(np.mean([distance(*links) for links in zip(first.links, second.links, strict=True)]))
