"""Avoidability of candidates for a careful human driver, a batch at once along the ego's path; planning in closed loop.

In open loop an adversary never touches the recorded ego, and that keeps it fair. In closed loop the ego may do
anything, and only a vehicle that may be hit is ever in another's way. So the search asks what a careful and competent
human would do in the ego's place (`benchmark.interactions`, on the path alone: two seconds to contact, 0.75 s of
reaction, braking that rises to 0.774 g, and the speed that is left kept), in the world with all others in it, and
whether that driver is hit: by the candidate, or by another because of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import SimulatedMotion, compute_rear_axle
from benchmark.geometry import Bools, Floats
from benchmark.interactions.reaction import CAREFUL_TIME_S, HARDEST_BRAKING, REACTION_S
from benchmark.interactions.tracks import Integers
from benchmark.machine.identity_cache import IdentityCache
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.search.planning import AdversaryPlanning
from generation.search.recorded_ego_path import RecordedEgoPath, get_ego_path
from generation.search.scoring import ScoreTerms, ScoringSurroundings, build_surroundings

EVERY_FRAMES: Final = 2
LOOK_FRAMES: Final = 60
"""5 s; candidates are known for 3 s of them and go on at their speed."""
BLIND_FRAMES: Final = 12
"""Until the next plan."""
_RISE_M_S3: Final = 12.65
_AIR_ALONG_M: Final = 1.0
_AIR_ASIDE_M: Final = 0.4
_ROUNDING_M: Final = 1e-6
_ASIDE_M_S: Final = 0.1
"""Gaps smaller than this, ahead of the ego and beside it, count as contact: where the ego will be is uncertain,
and more so the farther ahead."""


@dataclass(frozen=True, slots=True)
class PathBodies:
    """P bodies at S + 1 instants from now: lowest and highest stations on the ego's way, metres, infinite where absent.

    `beside` is in metres from the ego's strip, negative where it reaches in.
    """

    rear: Floats
    front: Floats
    beside: Floats

    @classmethod
    def of(cls, way: RecordedEgoPath, poses: Floats, size: Floats, frames: tuple[int, int]) -> Self:
        """Bodies of (P, F, 3) poses and (P, 2) sizes, somewhere between two frames."""
        station, offset, turn = way.places(poses, *frames)
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        length, width = size[:, :1], size[:, 1:]
        along, across = 0.5 * (cos * length + sin * width), 0.5 * (sin * length + cos * width)
        return cls(station - along, station + along, np.abs(offset) - across - 0.5 * way.width_m)

    def extrapolate(self, count: int) -> "PathBodies":
        """The same at so many more instants, at the speed of the last step."""
        if count <= 0:
            return self
        step = self.rear[:, -1:] - self.rear[:, -2:-1]
        way = step * np.arange(1, count + 1)
        rear, front = (np.concatenate([ends, ends[:, -1:] + way], axis=1) for ends in (self.rear, self.front))
        return PathBodies(
            rear, front, np.concatenate([self.beside, np.repeat(self.beside[:, -1:], count, axis=1)], axis=1)
        )


@dataclass(frozen=True, slots=True)
class CarefulDriverCheck:
    """Careful human in the ego's place, at a `station` in metres, and all others ever in the ego's strip.

    `steps` are (S,) frames after the planning frame; the human is `lost` if others hit it without an adversary. One who
    reacts already has `waiting` seconds of its reaction left and brakes with `braking` m/s^2; `hardest` it may.
    """

    way: RecordedEgoPath
    frame: int
    station: float
    speed: float
    others: PathBodies
    steps: tuple[int, ...]
    lost: bool
    waiting: float = REACTION_S
    braking: float = 0.0
    hardest: float = HARDEST_BRAKING
    _in_way: "_OthersInWay" = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_in_way", self._collect_in_way())

    @classmethod
    def of(cls, scene: Scene, agent: int, frame: int, speed: float, look_frames: int = LOOK_FRAMES) -> Self:
        """The careful human of a planning frame; ``scene`` has the ego as expected, ``speed`` is the ego's, m/s."""
        last = min(frame + look_frames, len(scene.timestamps_us) - 1)
        steps = tuple(range(EVERY_FRAMES, last - frame + 1, EVERY_FRAMES)) or (last - frame,)
        way = get_ego_path(scene)
        others = _collect_others(scene, agent, way, frame, steps)
        unchecked = cls(way, frame, float(way.station[frame]), speed, others, steps, False)
        absent = PathBodies(*(np.full((1, len(steps) + 1), np.inf) for _ in range(3)))
        return replace(unchecked, lost=True) if unchecked.hits(absent)[0] else unchecked

    def hit(self, motion: SimulatedMotion, size: Floats) -> Bools:
        """(B,) whether the careful human is hit, or surely would be soon after; ``size`` is the adversary's, (2,)."""
        return self.hits(self.place(motion, size))

    def is_met(self, placed: PathBodies, *, in_front: bool = True) -> Bools:
        """(B,) whether an unreacting ego meets a body; ``in_front`` leaves out those that may hit it from the side."""
        return np.isfinite(self.find_meeting_times(placed, in_front=in_front))

    def find_meeting_times(self, placed: PathBodies, *, in_front: bool = True) -> Floats:
        """(B,) seconds until an ego that keeps its speed meets a body, as of `is_met`; infinite where it never does."""
        time = np.arange(len(self.steps) + 1) * EVERY_FRAMES / FRAME_HZ
        station, half = self.station + self.speed * time, 0.5 * self.way.length_m
        over = (placed.rear < station + half) & (placed.front > station - half) & (placed.beside <= 0.0)
        first = np.argmax(over, axis=1)
        ahead = placed.rear[np.arange(len(over)), first] > station[first] if in_front else True
        return np.where(over.any(axis=1) & ~over[:, 0] & ahead, time[first], np.inf)

    def is_following(self, now: Floats, size: Floats) -> bool:
        """Whether a vehicle at (1, 3) is behind the ego."""
        body = PathBodies.of(self.way, now[None], size[None], (self.frame, self.frame))
        return bool(body.rear[0, 0] < self.station - 0.5 * self.way.length_m)

    def place(self, motion: SimulatedMotion, size: Floats) -> PathBodies:
        """Candidates along the ego's way."""
        known = [step for step in self.steps if step < motion.center.shape[1]]
        center = np.where(motion.finite[:, None, None], motion.center[:, [0, *known]], 0.0)
        sizes = np.broadcast_to(size, (len(center), 2))
        bodies = PathBodies.of(self.way, center, sizes, (self.frame, self.frame + self.steps[-1]))
        return bodies.extrapolate(len(self.steps) - len(known))

    @np.errstate(invalid="ignore")
    def hits(self, placed: PathBodies) -> Bools:
        """(B,) as `hit`, of B bodies; one that is nowhere has no speed."""
        steps = np.arange(len(self.steps) + 1)
        near_enough = _AIR_ASIDE_M + _ASIDE_M_S * steps * (EVERY_FRAMES / FRAME_HZ)
        matters = (placed.beside <= near_enough).any(axis=1)
        # Bodies that are never near the ego's strip all change as little as one that is nowhere.
        rows = np.flatnonzero(matters)
        rear, front, beside = np.full((3, len(steps), len(rows) + 1), np.inf)
        rear[:, :-1], front[:, :-1], beside[:, :-1] = placed.rear[rows].T, placed.front[rows].T, placed.beside[rows].T
        found = self._simulate(rear, front, beside, near_enough[:, None])
        answers = np.repeat(found[-1:], len(matters))
        answers[rows] = found[:-1]
        return answers

    def _simulate(self, rear: Floats, front: Floats, beside: Floats, near_enough: Floats) -> Bools:
        """(B,) `hits` of bodies that are (S + 1, B), by instants; ``near_enough`` is (S + 1, 1)."""
        half, dt = 0.5 * self.way.length_m, EVERY_FRAMES / FRAME_HZ
        in_strip, body_speed = beside <= 0.0, (rear[1:] - rear[:-1]) * (FRAME_HZ / EVERY_FRAMES)
        # Until it brakes, a driver is at the same place among any bodies.
        free = self._in_way.free_station[:, None]
        unsafe = in_strip[:-1] & (front[:-1] > free[:-1])
        unsafe &= _is_near(rear[:-1], body_speed, free[:-1], self.speed, half)
        unsafe |= self._in_way.threatens_free[:, None]
        seen = np.cumsum(unsafe, axis=0)
        waiting_after = np.subtract.accumulate(np.append(self.waiting, np.full(len(unsafe), dt)))
        braking = unsafe & (seen > np.count_nonzero(waiting_after > 0.0))
        station, speed = np.repeat(free, rear.shape[1], axis=1), np.full(rear.shape[1], self.speed)
        waiting = waiting_after[seen[-1]]
        rows = np.flatnonzero(braking.any(axis=0))
        if len(rows):
            first = int(np.argmax(braking.any(axis=1)))
            waiting[rows] = waiting_after[seen[first - 1, rows]] if first else self.waiting
            bodies = (rear[:, rows], front[:, rows], body_speed[:, rows], in_strip[:, rows])
            station[:, rows], speed[rows], waiting[rows] = self._drive(
                first, bodies, station[:, rows], speed[rows], waiting[rows]
            )
        over = (rear[1:] < station[1:] + half + _AIR_ALONG_M) & (front[1:] > station[1:] - half)
        hit = (over & (beside[1:] <= near_enough[1:])).any(axis=0)
        gap = rear[-1] - station[-1] - half
        closing = np.maximum(speed - (rear[-1] - rear[-2]) / dt, 0.0)
        needed = closing * np.maximum(waiting, 0.0) + closing**2 / (2.0 * self.hardest)
        hit |= in_strip[-1] & (gap > -half) & (gap < needed)
        # A driver who would be hit by others in any case is not hit because of a candidate.
        return np.asarray(hit if self.lost else hit | self._in_way.find_hit(station, half))

    def _drive(
        self, first: int, bodies: tuple[Floats, Floats, Floats, Bools], station: Floats, speed: Floats, waiting: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """The last three as they become from a step on; ``bodies`` are rear, front, speed and who is in the strip."""
        rear, front, body_speed, in_strip = bodies
        half, dt, braking = 0.5 * self.way.length_m, EVERY_FRAMES / FRAME_HZ, np.full(len(speed), self.braking)
        for step in range(first, len(self.steps)):
            now, others = station[step], self._in_way.at_start[step]
            unsafe = in_strip[step] & (front[step] > now)
            unsafe &= _is_near(rear[step], body_speed[step], now, speed, half)
            if others is not None:
                unsafe |= _threaten(others, now, speed, half)
            after = speed
            if unsafe.any():
                ready = unsafe & (waiting <= 0.0)
                np.subtract(waiting, dt, out=waiting, where=unsafe)
                if ready.any():
                    np.minimum(braking + _RISE_M_S3 * dt, self.hardest, out=braking, where=ready)
                    after = np.where(ready, np.maximum(speed - braking * dt, 0.0), speed)
            station[step + 1], speed = now + 0.5 * dt * (speed + after), after
        return station, speed, waiting

    def _collect_in_way(self) -> "_OthersInWay":
        """Others that may matter to a driver who never speeds up: at the start of each step, and at its end."""
        others, half, dt = self.others, 0.5 * self.way.length_m, EVERY_FRAMES / FRAME_HZ
        farthest = self.station + self.speed * dt * np.arange(len(self.steps) + 1) + half + _ROUNDING_M
        speed = np.diff(others.rear, axis=1) * (FRAME_HZ / EVERY_FRAMES)
        stops = CAREFUL_TIME_S * np.maximum(self.speed - speed, 0.0)
        in_strip = others.beside <= 0.0
        now = in_strip[:, :-1] & (others.front[:, :-1] > self.station)
        now &= others.rear[:, :-1] <= farthest[:-1] + stops
        at_start = tuple(
            (others.rear[rows, at, None], others.front[rows, at, None], speed[rows, at, None]) if len(rows) else None
            for at, rows in enumerate(map(np.flatnonzero, now.T))
        )
        later = in_strip & (others.front > self.station - half) & (others.rear < farthest)
        step, row = np.nonzero(later[:, 1:].T)
        free = np.add.accumulate(
            np.append(self.station, np.full(len(self.steps), 0.5 * dt * (self.speed + self.speed)))
        )
        threats = [
            some is not None and bool(_threaten(some, free[at], self.speed, half)[0])
            for at, some in enumerate(at_start)
        ]
        rear, front = others.rear[row, step + 1, None], others.front[row, step + 1, None]
        return _OthersInWay(at_start, step + 1, rear, front, free, np.array(threats, np.bool_))

    def compute_missing_distance(self, placed: PathBodies) -> Floats:
        """(B,) metres missing to stop behind the ego for a follower, planned anew after a second, not braking earlier.

        The ego brakes from now on.
        """
        at, half = min(BLIND_FRAMES // EVERY_FRAMES, len(self.steps)), 0.5 * self.way.length_m
        speed = np.maximum(placed.rear[:, at] - placed.rear[:, at - 1], 0.0) * (FRAME_HZ / EVERY_FRAMES)
        stops = placed.front[:, at] + speed**2 / (2.0 * HARDEST_BRAKING)
        behind = (placed.rear[:, 0] < self.station - half) & (placed.beside[:, at] <= _AIR_ASIDE_M)
        missing = stops - (self.station - half + self.speed**2 / (2.0 * HARDEST_BRAKING))
        return np.asarray(behind * np.maximum(missing, 0.0))


get_careful_driver_check: Final = IdentityCache[Scene, CarefulDriverCheck](CarefulDriverCheck.of, kept=2)
"""`CarefulDriverCheck.of`: a planning frame asks for it of its candidates, and of what it chose."""


_Bodies = tuple[Floats, Floats, Floats]
"""(M, 1) of M others at an instant: rear and front in metres on the ego's way, and m/s."""


@dataclass(frozen=True, slots=True)
class _OthersInWay:
    """Others at the start of each step, and L times one of them at an instant: (L,) ``at``, (L, 1) ``rear``, ``front``.

    A driver who never brakes is at ``free_station`` (S + 1,), and feels unsafe because of others by ``threatens_free``.
    """

    at_start: tuple[_Bodies | None, ...]
    at: Integers
    rear: Floats
    front: Floats
    free_station: Floats
    threatens_free: Bools

    def find_hit(self, station: Floats, half: float) -> Bools:
        """(B,) whether others touch drivers at (S + 1, B) stations."""
        there = station[self.at]
        return np.asarray(((self.rear < there + half) & (self.front > there - half)).any(axis=0))


def _threaten(others: _Bodies, station: Floats, speed: Floats | float, half: float) -> Bools:
    """(B,) whether one of some others is near ahead of a driver."""
    rear, front, body_speed = others
    return np.asarray(((front > station) & _is_near(rear, body_speed, station, speed, half)).any(axis=0))


def _is_near(rear: Floats, body_speed: Floats, station: Floats, speed: Floats | float, half: float) -> Bools:
    """(..., B) whether a vehicle's rear is less than two seconds ahead of the ego's front, or behind that."""
    return np.asarray(rear - station - half <= np.maximum(CAREFUL_TIME_S * (speed - body_speed), 0.0))


def _collect_others(scene: Scene, agent: int, way: RecordedEgoPath, frame: int, steps: tuple[int, ...]) -> PathBodies:
    """All but the adversary that are ever in the ego's strip; none that are in the ego's body now."""
    agents = scene.agents
    at = [frame, *(frame + step for step in steps)]
    indices = np.flatnonzero(agents.valid[:, at].any(axis=1))
    indices = indices[indices != agent]
    grid = np.ix_(indices, at)
    poses = np.concatenate([agents.position[grid][..., :2], agents.yaw[grid][..., None]], axis=-1)
    bodies = PathBodies.of(way, poses, agents.size[indices, :2], (at[0], at[-1]))
    beside = np.where(agents.valid[grid], bodies.beside, np.inf)
    own, half = way.station[frame], 0.5 * way.length_m
    inside = (bodies.rear[:, 0] < own + half) & (bodies.front[:, 0] > own - half) & (beside[:, 0] <= 0.0)
    relevant = (beside <= 0.0).any(axis=1) & ~inside
    return PathBodies(bodies.rear[relevant], bodies.front[relevant], beside[relevant])


HIT_WEIGHT: Final = 20.0
"""Of a candidate that a careful human does not survive: more than any threat is worth."""
MEETING_WEIGHT: Final = 5.0
"""Of one that a careful human survives and that an ego that does not react runs into."""

FOLLOW_WEIGHT: Final = 1.0
FOLLOW_MOST_M: Final = 20.0
"""A metre that is missing to stop behind the ego, and how many count."""


@dataclass(frozen=True, slots=True)
class ReactivePlanning(AdversaryPlanning):
    """Planning frames of an adversary that the ego may run into."""

    def around(self, frames: tuple[int, ...], raster: DrivableRaster) -> ScoringSurroundings:
        """All but the ego: what it survives is asked of a careful human in its place."""
        with_ego = build_surroundings(self.scene, self.agent, frames, raster)
        present = with_ego.present.copy()
        present[:, -1] = False
        return replace(with_ego, present=present)

    def build_rating(
        self, frame: int, offsets: tuple[int, ...], track: Floats
    ) -> Callable[[SimulatedMotion], ScoreTerms]:
        """As in open loop, and what is not survivable costs."""
        rate = AdversaryPlanning.build_rating(self, frame, offsets, track)
        careful = get_careful_driver_check(self.scene, self.agent, frame, compute_ego_speed_at(self.scene, frame))
        size = self.scene.agents.size[self.agent, :2]

        def rated(motion: SimulatedMotion) -> ScoreTerms:
            terms = rate(motion)
            placed = careful.place(motion, size)
            hit = careful.hits(placed)
            follows = FOLLOW_WEIGHT * np.minimum(careful.compute_missing_distance(placed), FOLLOW_MOST_M)
            more = HIT_WEIGHT * hit - MEETING_WEIGHT * (careful.is_met(placed) & ~hit) + follows
            return replace(terms, further=more if terms.further is None else terms.further + more)

        return rated


def build_driven_motion(poses: Floats, length_m: float) -> SimulatedMotion:
    """Motion of one track, (S + 1, 3) box centres by frame, as of a candidate; the tracker's commands are unknown."""
    axle = compute_rear_axle(poses, length_m)
    heading = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    velocity = np.gradient(axle[:, :2], 1.0 / FRAME_HZ, axis=0) if len(poses) > 1 else np.zeros((1, 2))
    speed = (velocity * heading).sum(axis=1)
    acceleration = np.gradient(speed, 1.0 / FRAME_HZ) if len(poses) > 1 else np.zeros(1)
    states = np.column_stack([axle, speed, acceleration, np.zeros(len(poses))])
    return SimulatedMotion(poses[None], states[None], np.zeros((1, len(poses) - 1, 2)), np.ones(1, np.bool_))


def compute_ego_speed_at(scene: Scene, frame: int) -> float:
    """Speed of the ego at a frame, m/s, of its places around it."""
    first, last = max(frame - 2, 0), min(frame + 1, len(scene.timestamps_us) - 1)
    way = np.hypot(*(scene.ego.position[last, :2] - scene.ego.position[first, :2]))
    return float(way) / max(float(scene.seconds[last] - scene.seconds[first]), 1e-9)
