"""Outcome of a driver's motion: the first contact and its kind, or none.

Contact is looked for at five instants of each step of 0.1 s: the station is linear inside a step, and while the driver
is the recording, so is its rectangle.
"""

from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.interactions.contacts import KINDS, ContactKind, ContactPairs, is_agent_category
from benchmark.interactions.driver_simulation import DriverMotion, DrivingSituation
from benchmark.interactions.tracks import STEP_S, SUB_STEPS


@dataclass(frozen=True, slots=True)
class EgoCollision:
    """First contact of a run, in seconds and m/s; boxes are (5,).

    ``step`` is that of 0.1 s in which it happens, ``agent`` the index of the touched agent, the lowest of several.
    """

    time: float
    step: int
    agent: int
    kind: ContactKind
    ego_speed: float
    other_speed: float
    impact_speed: float
    ego: Floats
    other: Floats


@dataclass(frozen=True, slots=True)
class DriverOutcome:
    """End of a run; ``motion`` is as if nothing had been hit.

    ``contact`` is ``None`` if the driver survives, ``instants`` of the motion belong to the run; ``beyond_end`` if it
    left the recorded path, where no road is known.
    """

    motion: DriverMotion
    contact: EgoCollision | None
    instants: int
    beyond_end: bool

    @property
    def survives(self) -> bool:
        """Whether nothing is hit."""
        return self.contact is None

    @property
    def speed(self) -> Floats:
        """(``instants``,) m/s."""
        return self.motion.speed[: self.instants]

    @property
    def station(self) -> Floats:
        """(``instants``,) metres."""
        return self.motion.station[: self.instants]

    @property
    def unsafe(self) -> Bools:
        """(``instants`` - 1,) steps that the driver found unsafe."""
        return self.motion.unsafe[: self.instants - 1]

    @property
    def reacted(self) -> float | None:
        """When the driver first found something unsafe, seconds."""
        unsafe = np.flatnonzero(self.unsafe)
        return float(self.motion.times[unsafe[0]]) if len(unsafe) else None

    @property
    def reason(self) -> int | None:
        """Whom it first found unsafe."""
        return self.motion.reason if self.reacted is not None else None


def compute_check_times(times: Floats) -> Floats:
    """(5 (K - 1),) instants at which contact is looked for, those after each of (K,) times."""
    return np.asarray((times[:-1, None] + STEP_S / SUB_STEPS * np.arange(1, SUB_STEPS + 1)).ravel())


@dataclass(frozen=True, slots=True)
class CollisionChecker:
    """All agents, (N, T, 5), and the recorded ego, (T, 5), at the T instants at which contact is looked for.

    ``counts``, (N, T), are those that are there and not ignored.
    """

    situation: DrivingSituation
    times: Floats
    boxes: Floats
    counts: Bools
    ego: Floats

    @classmethod
    def of(cls, situation: DrivingSituation) -> "CollisionChecker":
        """Those of a scene."""
        times = compute_check_times(situation.times)
        boxes, present = situation.tracks.agents_at(times)
        counts = present & ~situation.ignored[:, None]
        return cls(situation, times, boxes, counts, situation.tracks.ego_at(times))

    def find_outcome(self, motion: DriverMotion) -> DriverOutcome:
        """Outcome of one driver's motion in this scene."""
        ego = self.ego_boxes(motion)
        hit = self._find_first_hit(ego)
        contact = None if hit is None else self._build_collision(motion, ego, *hit)
        instants = len(motion.times) if contact is None else contact.step + 2
        # The recording itself may end a little after the last vertex.
        driven = motion.station[motion.free_from + 1 : instants]
        beyond = bool((driven > self.situation.path.end_m).any())
        return DriverOutcome(motion, contact, instants, beyond)

    def ego_boxes(self, motion: DriverMotion) -> Floats:
        """(T, 5) the rectangle of a driver."""
        share = np.arange(1, SUB_STEPS + 1) / SUB_STEPS
        first, last = motion.station[:-1, None], motion.station[1:, None]
        free = np.repeat(np.arange(len(motion.times) - 1) >= motion.free_from, SUB_STEPS)
        if not free.any():
            return self.ego
        station = (first + share * (last - first)).ravel()
        return np.where(free[:, None], self.situation.path.boxes(station), self.ego)

    def _find_first_hit(self, ego: Floats) -> tuple[int, int] | None:
        """First instant of contact, then the lowest agent."""
        offset = self.boxes[..., :2] - ego[:, :2]
        # Two boxes can only touch if the circles around them do.
        reach = 0.5 * (np.hypot(self.boxes[..., 2], self.boxes[..., 3]) + np.hypot(ego[:, 2], ego[:, 3])) + 1e-6
        near = self.counts & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
        instant, agent = np.nonzero(near.T)
        hits = np.flatnonzero(boxes_overlap(ego[instant], self.boxes[agent, instant]))
        return (int(instant[hits[0]]), int(agent[hits[0]])) if len(hits) else None

    def _build_collision(self, motion: DriverMotion, ego: Floats, instant: int, agent: int) -> EgoCollision:
        tracks, step = self.situation.tracks, instant // SUB_STEPS
        time = float(self.times[instant])
        pair = ContactPairs(
            ego=ego[instant, None],
            ego_speed=motion.speed[step + 1, None],
            other=self.boxes[agent, instant, None],
            other_velocity=tracks.velocities_at(np.array([time]), np.array([agent]))[0],
            is_agent=np.array([is_agent_category(tracks.categories[agent])]),
        )
        return EgoCollision(
            time=time,
            step=step,
            agent=agent,
            kind=KINDS[pair.kinds[0]],
            ego_speed=float(pair.ego_speed[0]),
            other_speed=float(pair.other_speed[0]),
            impact_speed=float(pair.impact_speed[0]),
            ego=pair.ego[0],
            other=pair.other[0],
        )
