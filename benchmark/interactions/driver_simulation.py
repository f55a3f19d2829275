"""Reference drivers along the recorded path of a scene, against all agents in it, and what they see.

``docs/severity.md``, "Reference drivers". All drivers of a scene advance together, one step of 0.1 s after another;
contacts do not change what a driver does before them, so that they are looked for afterwards. An agent is seen along a
free line from the ego's centre to the agent's centre or a corner.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, directions_of
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.idm_driver import compute_idm_acceleration
from benchmark.interactions.reaction import REACTING, Driver, ReactionState
from benchmark.interactions.relations import PathRelations, RelativeAgents
from benchmark.interactions.safety_checks import compute_fuzzy_targets, find_unsafe_agents
from benchmark.interactions.tracks import STEP_S, ContinuousTracks, Integers

SIGHT_M: Final = 80.0
HIDING_M: Final = 90.0
"""Vehicles further from the eye hide no other."""


def find_visible(eyes: Floats, agents: Integers, boxes: Floats, present: Bools, hides: Bools) -> Bools:
    """(Q,) whether agents are seen from (Q, 2) places, among all (N, 5) boxes there; ``hides``: who can hide a car."""
    is_visible = np.zeros(len(agents), np.bool_)
    blockers = np.flatnonzero(present & hides)
    target = boxes[agents]
    near = np.hypot(*(target[:, :2] - eyes).T) <= SIGHT_M
    rows = np.flatnonzero(near)
    if not len(rows):
        return is_visible
    points = np.concatenate([target[rows, None, :2], box_corners(target[rows])], axis=1)
    lines = _build_sight_lines(eyes[rows, None], points)
    block = boxes[blockers]
    offset = block[None, :, :2] - eyes[rows, None]
    eye_boxes = np.concatenate([eyes[rows], np.zeros((len(rows), 3))], axis=1)
    counts = (np.hypot(offset[..., 0], offset[..., 1]) <= HIDING_M) & (blockers[None] != agents[rows, None])
    counts &= ~boxes_overlap(eye_boxes[:, None], block[None])
    query, blocker = np.nonzero(counts)
    hidden = np.zeros(points.shape[:2], np.bool_)
    blocks_line = boxes_overlap(lines[query], block[blocker, None])
    np.logical_or.at(hidden, query, blocks_line)
    is_visible[rows] = ~hidden.all(axis=1)
    return is_visible


def find_first_visible_time(tracks: ContinuousTracks, agent: int, times: Floats) -> float | None:
    """First of the rising instants asked at which the recorded ego sees an agent, or ``None``."""
    boxes, present = tracks.agents_at(times)
    eyes, hides = tracks.ego_at(times)[:, :2], tracks.hides
    for instant in np.flatnonzero(present[agent]).tolist():
        is_visible = find_visible(eyes[instant, None], np.array([agent]), boxes[:, instant], present[:, instant], hides)
        if is_visible[0]:
            return float(times[instant])
    return None


def _build_sight_lines(first: Floats, second: Floats) -> Floats:
    """Segments between points as boxes without width."""
    step = second - first
    zero = np.zeros(step.shape[:-1])
    length, heading = np.hypot(step[..., 0], step[..., 1]), directions_of(step)
    return np.concatenate([first + 0.5 * step, np.stack([length, zero, heading], axis=-1)], axis=-1)


SLOWEST_REACTING_M_S: Final = 0.5
"""A driver that has not reacted yet and all but stands has nothing to brake."""
REFERENCE_DRIVER_KINDS: Final = (
    Driver.RECORDED,
    Driver.CONSTANT,
    Driver.IDM,
    Driver.R157,
    Driver.CC,
    Driver.FSM,
    Driver.RSS,
)
"""From the weakest statement to the most cautious driver."""


@dataclass(frozen=True, slots=True)
class ReferenceDriver:
    """A driver, and whether it reacts to the adversary alone (it can still hit others), and steps later than others."""

    driver: Driver
    adversary_only: bool = False
    late_steps: int = 0


REFERENCE_DRIVERS: Final = tuple(map(ReferenceDriver, REFERENCE_DRIVER_KINDS))


@dataclass(frozen=True, slots=True)
class DriverMotion:
    """Motion of one driver to the end of the scene, as if it hit nothing.

    Attributes:
        times: (K,) seconds, every 0.1 s; ``station``, metres along the path, and ``speed``, m/s, are at these times.
        unsafe: (K - 1,) steps that the driver found unsafe.
        free_from: First step in which it drives by itself; K - 1 if it is the recording to the end.
        reason: The agent that it reacted to first, if it reacted: the one that asks for the most braking of FSM, else
            the first.
    """

    reference_driver: ReferenceDriver
    times: Floats
    station: Floats
    speed: Floats
    unsafe: Bools
    free_from: int
    reason: int | None


@dataclass(slots=True)
class DrivingSituation:
    """Scene as drivers need it, at K instants of decision: all agents then, along the path (``relations``).

    ``ignored`` (N,) agents overlap the ego at the start; ``station`` and ``speed``, (K,), are of the recorded ego;
    rungs may react to ``adversary`` alone.
    """

    tracks: ContinuousTracks
    times: Floats
    adversary: int | None = None
    path: EgoPath = field(init=False)
    relations: PathRelations = field(init=False)
    ignored: Bools = field(init=False)
    station: Floats = field(init=False)
    speed: Floats = field(init=False)

    def __post_init__(self) -> None:
        self.path = EgoPath.of(self.tracks)
        self.relations = PathRelations.of(self.path, self.tracks, self.times)
        self.ignored = self.tracks.touching_at(float(self.times[0]))
        self.station = self.path.recorded_station(self.times)
        self.speed = self.path.recorded_speed(self.times)

    @classmethod
    def of(
        cls, tracks: ContinuousTracks, start: float | None = None, adversary: int | None = None
    ) -> "DrivingSituation":
        """The situation of a scene from ``start`` on, seconds; by default from the first frame."""
        return cls(tracks, tracks.grid(start), adversary)


def simulate_drivers(
    situation: DrivingSituation, rungs: Sequence[ReferenceDriver] = REFERENCE_DRIVERS
) -> list[DriverMotion]:
    """Let drivers drive to the end of the scene."""
    simulated = [rung for rung in rungs if rung.driver in (Driver.IDM, *REACTING)]
    moved = dict(zip(simulated, _simulate(situation, simulated)))
    return [moved[rung] if rung in moved else compute_unreactive_motion(situation, rung) for rung in rungs]


def compute_unreactive_motion(situation: DrivingSituation, rung: ReferenceDriver) -> DriverMotion:
    """The motion of a driver that looks at no agent: the recording, or the speed of the start kept."""
    times, station, speed = situation.times, situation.station, situation.speed
    last = len(times) - 1
    free_from = last
    if rung.driver is Driver.CONSTANT:
        free_from, speed = 0, np.full(len(times), speed[0])
        station = station[0] + np.concatenate([[0.0], np.cumsum(STEP_S * speed[1:])])
    return DriverMotion(rung, times, station, speed, np.zeros(last, np.bool_), free_from, None)


def _simulate(situation: DrivingSituation, rungs: Sequence[ReferenceDriver]) -> list[DriverMotion]:
    if not rungs:
        return []
    advancing = DriverSimulation(situation, rungs)
    for step in range(len(situation.times) - 1):
        advancing.step(step, situation, step)
    return advancing.collect_motions()


class DriverSimulation:
    """Drivers under way: each step needs to know all agents at its beginning, and nothing of later.

    The situation is the recording that they follow until they react, and its path; all rungs decide by themselves
    (`REACTING`, and those that keep distance).
    """

    def __init__(self, situation: DrivingSituation, rungs: Sequence[ReferenceDriver]) -> None:
        count, instants = len(rungs), len(situation.times)
        self._situation, self._rungs = situation, tuple(rungs)
        self._idm = np.array([rung.driver is Driver.IDM for rung in rungs])
        self.free_from = np.where(self._idm, 0, instants - 1)
        """(R,) as in `DriverMotion`; the last step while a driver follows the recording."""
        self.station = np.broadcast_to(situation.station, (count, instants)).copy()
        """(R, K) metres along the path: driven up to now, recorded from then on."""
        self.speed = np.broadcast_to(situation.speed, (count, instants)).copy()
        """(R, K) m/s, likewise."""
        self._unsafe = np.zeros((count, instants - 1), np.bool_)
        self._reasons: list[int | None] = [None] * count
        self._memory = ReactionState.fresh([rung.driver for rung in rungs])
        self._memory.delay += np.array([[rung.late_steps] for rung in rungs], np.float64).reshape(-1, 1)
        self._free_speed = max(SLOWEST_REACTING_M_S, float(situation.speed.max()))

    @property
    def reaction(self) -> tuple[float, float]:
        """Steps of reaction that are left to the first driver, and its braking, m/s^2."""
        return float(self._memory.delay[0, 0]), float(self._memory.braking[0, 0])

    def step(self, step: int, seen: DrivingSituation, instant: int) -> None:
        """Decide and drive 0.1 s; at the beginning of the step all agents are as ``seen`` at the instant."""
        rungs, idm = self._rungs, self._idm
        station, speed = self.station, self.speed
        around = seen.relations.around(instant, station[:, step])
        now, before = speed[:, step], speed[:, max(step - 1, 0)]
        watched = _DriverView(seen, around, instant, station[:, step], now, (now - before) / STEP_S)
        latched = self.free_from <= step
        unsafe, targets = watched.find_reactions(rungs, latched | (now >= SLOWEST_REACTING_M_S))
        visible_ones = watched.seen(unsafe | watched.find_in_the_way(idm))
        unsafe &= visible_ones
        verdict = unsafe.any(axis=1)
        self._unsafe[:, step] = verdict
        for row in np.flatnonzero(verdict & ~latched).tolist():
            # The largest target for FSM; targets of the other drivers are equal, so it is the first of them.
            self._reasons[row] = int(np.argmax(np.where(unsafe[row], targets[row], -1.0)))
            self.free_from[row] = step
        latched |= verdict
        target = np.where(unsafe, targets, 0.0).max(axis=1, initial=0.0)
        reacted = self._memory.react(verdict[:, None], now[:, None], target[:, None])[:, 0]
        acceleration = compute_idm_acceleration(
            now, self._free_speed, *watched.find_leaders(visible_ones & idm[:, None])
        )
        following = now + STEP_S * acceleration
        after = np.maximum(np.where(idm, following, np.where(verdict, reacted, now)), 0.0)
        speed[:, step + 1] = np.where(latched, after, speed[:, step + 1])
        station[:, step + 1] = np.where(latched, station[:, step] + STEP_S * after, station[:, step + 1])

    def collect_motions(self) -> list[DriverMotion]:
        """Motion of each driver."""
        return [
            DriverMotion(
                rung,
                self._situation.times,
                self.station[row],
                self.speed[row],
                self._unsafe[row],
                int(self.free_from[row]),
                self._reasons[row],
            )
            for row, rung in enumerate(self._rungs)
        ]


@dataclass(frozen=True, slots=True)
class _DriverView:
    """View of R drivers at one step; visibility is computed only where the result depends on it."""

    situation: DrivingSituation
    around: RelativeAgents
    step: int
    station: Floats
    speed: Floats
    acceleration: Floats

    def find_reactions(self, rungs: Sequence[ReferenceDriver], looks: Bools) -> tuple[Bools, Floats]:
        """(R, N) agents that each driver would find unsafe if it saw them, and (R, N) what braking FSM asks for."""
        shape = self.around.gap.shape
        unsafe, targets = np.zeros(shape, np.bool_), np.zeros(shape)
        length = float(self.situation.path.size[0])
        for row, rung in enumerate(rungs):
            if rung.driver is Driver.IDM or not looks[row]:
                continue
            around = self.around.row(row)
            dynamics = (self.speed[row : row + 1, None], self.acceleration[row : row + 1, None], length)
            if rung.driver is Driver.FSM:
                targets[row] = compute_fuzzy_targets(around, *dynamics)[0]
                unsafe[row] = targets[row] > 0
            else:
                unsafe[row] = find_unsafe_agents(rung.driver, around, dynamics[0])[0]
            if rung.adversary_only:
                unsafe[row] &= np.arange(shape[1]) == self.situation.adversary
        return unsafe & ~self.situation.ignored, targets

    def find_in_the_way(self, idm: Bools) -> Bools:
        """(R, N) agents that those who keep distance might follow."""
        return np.asarray(self.around.ahead & (self.around.side <= 0) & ~self.situation.ignored & idm[:, None])

    def find_leaders(self, followed: Bools) -> tuple[Floats, Floats]:
        """(R,) gap to and speed of the nearest of the (R, N) agents that may be followed."""
        gap = np.where(followed, self.around.gap, np.inf)
        if not gap.shape[1]:
            return np.full(len(gap), np.inf), np.zeros(len(gap))
        nearest = np.argmin(gap, axis=1)
        rows = np.arange(len(gap))
        return gap[rows, nearest], self.around.along[rows, nearest]

    def seen(self, candidates: Bools) -> Bools:
        """Those of (R, N) agents that are visible."""
        row, agent = np.nonzero(candidates)
        if not len(row):
            return candidates
        relations = self.situation.relations
        eyes = self.situation.path.position(self.station[row])
        boxes, present = relations.boxes[:, self.step], relations.present[:, self.step]
        candidates[row, agent] = find_visible(eyes, agent, boxes, present, relations.hides)
        return candidates
