"""How near an encounter comes to a contact: gaps, times, and how much braking it asks for, every 0.1 s.

``docs/severity.md``, "An encounter". Series end before the first contact. In a run that ends in contact the least time
to contact is about 0 and the time exposed about 1.5 s by construction: tables show them for runs without contact.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, box_gap, boxes_overlap
from benchmark.interactions.contacts import compute_time_to_contact, is_agent_category
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.reaction import HARDEST_BRAKING
from benchmark.interactions.relations import PathRelations
from benchmark.interactions.tracks import STEP_S, ContinuousTracks, Integers

CRITICAL_S: Final = 1.5
"""Times to contact below this are counted by TET and TIT."""
LONGEST_PET_STEPS: Final = 50
LARGEST_BTN: Final = 10.0


@dataclass(frozen=True, slots=True)
class SeveritySeries:
    """Encounter of the ego with one agent, K samples every 0.1 s.

    Attributes:
        times: (K,) seconds.
        gap: (K,) metres, NaN where the agent is not there; `ttc` and `btn` also after the first sample in contact.
        ttc: (K,) seconds to contact if both keep their velocity; infinite if they never meet.
        btn: (K,) braking threat number: required braking as a multiple of what a dry road allows, at most 10.
        first_contact: Index of the first sample in contact, -1 for none.
        pet_steps: Post-encroachment time in steps of 0.1 s; ``None`` if the paths do not meet within 5 s.
        first: Which was there first, ``ego`` or ``other``; ``none`` in contact, ``None`` if the paths do not meet.
    """

    times: Floats
    gap: Floats
    ttc: Floats
    btn: Floats
    first_contact: int
    pet_steps: int | None
    first: str | None

    @property
    def contact_s(self) -> float | None:
        """When the first sample in contact is, seconds."""
        return float(self.times[self.first_contact]) if self.first_contact >= 0 else None

    @property
    def min_gap(self) -> float | None:
        """Smallest distance of all samples, metres; ``None`` if the agent is never there."""
        return _least(self.gap)

    @property
    def min_ttc(self) -> float | None:
        """Smallest time to contact, seconds; ``None`` if they never head for one another."""
        least = _least(self.ttc[self._before])
        return None if least is None or np.isinf(least) else least

    @property
    def tet(self) -> float:
        """Time exposed: how long the time to contact is below 1.5 s, seconds."""
        return float(STEP_S * np.count_nonzero(self._critical))

    @property
    def tit(self) -> float:
        """Time integrated: by how much it is below, summed over time, s^2."""
        return float(STEP_S * (CRITICAL_S - self.ttc[self._before][self._critical]).sum())

    @property
    def pet(self) -> float | None:
        """Post-encroachment time, seconds."""
        return None if self.pet_steps is None else STEP_S * self.pet_steps

    @property
    def max_btn(self) -> float | None:
        """Largest braking threat number; 1 and more: braking alone would not have been enough at that moment."""
        largest = _least(-self.btn[self._before])
        return None if largest is None else abs(largest)

    @property
    def _critical(self) -> Bools:
        return np.asarray(np.nan_to_num(self.ttc[self._before], nan=np.inf) < CRITICAL_S)

    @property
    def _before(self) -> slice:
        """Samples before contact, on which the summaries rest."""
        return slice(self.first_contact if self.first_contact >= 0 else None)


def measure_severity(tracks: ContinuousTracks, agent: int) -> SeveritySeries:
    """Measure the encounter of the ego, the recorded one or one that follows a plan, with one agent."""
    times = tracks.grid()
    pair = _resample_pair(tracks.only([agent]), times)
    ego, other, present = pair.ego, pair.agents[0], pair.valid[0]
    gap = np.where(present, box_gap(ego, other), np.nan)
    hits = np.flatnonzero(gap == 0.0)
    first_contact = int(hits[0]) if len(hits) else -1
    measured = present.copy()
    if len(hits):
        measured[first_contact + 1 :] = False
    velocity = pair.velocities_at(times)[0] * is_agent_category(pair.categories[0])
    ego_velocity = pair.ego_velocities_at(times)
    ttc = np.where(measured, compute_time_to_contact(ego, ego_velocity, other, velocity), np.nan)
    btn = np.where(measured, _compute_braking_threat(tracks.only([agent]), times, ego_velocity), np.nan)
    pet, first = (0, "none") if len(hits) else _find_encroachment(ego, other, present)
    return SeveritySeries(times, gap, ttc, btn, first_contact, pet, first)


def _resample_pair(tracks: ContinuousTracks, times: Floats) -> ContinuousTracks:
    boxes, present = tracks.agents_at(times)
    return ContinuousTracks(times, tracks.ego_at(times), boxes, present, tracks.categories)


def _compute_braking_threat(tracks: ContinuousTracks, times: Floats, ego_velocity: Floats) -> Floats:
    """(K,) for a leader that keeps its speed; 0 where the agent is behind or not in the way."""
    path = EgoPath.of(tracks)
    relations = PathRelations.of(path, tracks, times)
    around = relations.seen(np.array(0), np.arange(len(times)), path.recorded_station(times))
    speed = np.hypot(ego_velocity[:, 0], ego_velocity[:, 1])
    closing = np.maximum(speed - np.maximum(around.along, 0.0), 0.0)
    required = closing**2 / (2 * np.maximum(around.gap, 1e-9))
    threat = np.where(around.gap <= 0, LARGEST_BTN, np.minimum(required / HARDEST_BRAKING, LARGEST_BTN))
    return np.where(around.ahead & (around.side <= 0), threat, 0.0)


def _find_encroachment(ego: Floats, other: Floats, present: Bools) -> tuple[int | None, str | None]:
    """Smallest step count between two samples of the two whose rectangles would touch, and who was there first."""
    mine, theirs = _find_meetings(ego, other, present)
    if not len(mine):
        return None, None
    apart = np.abs(mine - theirs)
    best = np.lexsort((mine, np.maximum(mine, theirs), apart))[0]
    return int(apart[best]), "ego" if mine[best] < theirs[best] else "other"


def _find_meetings(ego: Floats, other: Floats, present: Bools) -> tuple[Integers, Integers]:
    """Samples of the two, at most 5 s apart, whose rectangles touch."""
    samples = np.arange(len(ego))
    apart = np.arange(-LONGEST_PET_STEPS, LONGEST_PET_STEPS + 1)
    theirs = samples[:, None] + apart
    inside = (theirs >= 0) & (theirs < len(ego))
    theirs = np.clip(theirs, 0, len(ego) - 1)
    offset = other[theirs, :2] - ego[:, None, :2]
    reach = 0.5 * (np.hypot(*ego[0, 2:4]) + np.hypot(*other[:, 2:4].max(axis=0))) + 1e-6
    near = inside & present[theirs] & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
    row, column = np.nonzero(near)
    mine, theirs = row, theirs[row, column]
    touching = boxes_overlap(ego[mine], other[theirs])
    return mine[touching], theirs[touching]


def _least(values: Floats) -> float | None:
    known = values[~np.isnan(values)]
    return float(known.min()) if len(known) else None
