"""How near many pairs of short tracks come to a contact: `benchmark.fairness.encounter` for all plans of a scene.

The definitions are those of one encounter; `severity_of` is what the tests hold this to.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.fairness.encounter import CRITICAL_S, LONGEST_PET_STEPS
from benchmark.fairness.plan_paths import braking_threats
from benchmark.geometry import Bools, Floats, box_gap, boxes_overlap
from benchmark.interactions.contacts import time_to_contact
from benchmark.interactions.tracks import STEP_S

_MEMORY_STEPS: Final = 2


@dataclass(frozen=True, slots=True)
class NearMisses:
    """P pairs that do not touch while both are there; every array (P,).

    Attributes:
        gap: Smallest distance, metres.
        ttc: Least time to contact, seconds; infinite if they never head for one another.
        tet: Time exposed: how long the time to contact is below 1.5 s, seconds.
        tit: By how much it is below, summed over time, s^2.
        pet: Post-encroachment time, seconds; infinite if the paths do not meet.
        btn: Largest braking threat number.
    """

    gap: Floats
    ttc: Floats
    tet: Floats
    tit: Floats
    pet: Floats
    btn: Floats


def near_misses(ego: Floats, other: Floats, present: Bools, velocity: Floats) -> NearMisses:
    """Measure pairs, (P, K, 5) boxes every 0.1 s; velocities are the other's, m/s.

    The other is there at one instant at least.
    """
    moving = ego_velocities(ego)
    gap = np.where(present, box_gap(ego, other), np.inf)
    ttc = np.where(present, time_to_contact(ego, moving, other, velocity), np.inf)
    left = np.where(ttc < CRITICAL_S, CRITICAL_S - ttc, 0.0)
    btn = braking_threats(ego, np.hypot(moving[..., 0], moving[..., 1]), other, present, velocity)
    return NearMisses(
        gap=gap.min(axis=1),
        ttc=ttc.min(axis=1),
        tet=STEP_S * (ttc < CRITICAL_S).sum(axis=1),
        tit=STEP_S * left.sum(axis=1),
        pet=STEP_S * _encroachment_steps(ego, other, present),
        btn=btn.max(axis=1),
    )


def ego_velocities(ego: Floats) -> Floats:
    """(P, K, 2) velocities of tracks that begin at their first instant, m/s.

    Over the last 0.2 s, forward at the first, of boxes every 0.1 s.
    """
    centres = ego[..., :2]
    found = np.empty(centres.shape)
    found[:, _MEMORY_STEPS:] = (centres[:, _MEMORY_STEPS:] - centres[:, :-_MEMORY_STEPS]) / (_MEMORY_STEPS * STEP_S)
    found[:, :_MEMORY_STEPS] = ((centres[:, 1] - centres[:, 0]) / STEP_S)[:, None]
    return found


def _encroachment_steps(ego: Floats, other: Floats, present: Bools) -> Floats:
    """(P,) smallest number of steps between two instants of the two whose rectangles would touch; infinite for none."""
    offset = other[:, None, :, :2] - ego[:, :, None, :2]
    circles = np.hypot(ego[..., 2], ego[..., 3])[:, :, None] + np.hypot(other[..., 2], other[..., 3])[:, None]
    reach = 0.5 * circles + 1e-6
    pair, mine, theirs = np.nonzero(present[:, None] & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2))
    touching = boxes_overlap(ego[pair, mine], other[pair, theirs])
    steps = np.abs(mine - theirs)
    touching &= steps <= LONGEST_PET_STEPS
    found = np.full(len(ego), np.inf)
    np.minimum.at(found, pair[touching], steps[touching].astype(np.float64))
    return found
