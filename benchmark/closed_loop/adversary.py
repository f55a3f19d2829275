"""An adversary among the agents: where it leaves its recording, where it went, and one that goes there once more.

One that plans while the drive lasts (`generation.extensions.reactive_adversary`) is handed in as an `AdversaryFactory`.
What it drove is kept with the drive, to be repeated, scored and filmed without a search, or met by another planner.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.agent_policy import AgentMotion, AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS, SUBSTEP_US
from benchmark.errors import InputError
from benchmark.geometry import Floats, poses_between, wrap_angle
from benchmark.scene import Scene

ADVERSARY: Final = "adversary"
"""Its name in ``--agents``."""
_MEMORY_US: Final = 200_000
"""Velocities are of the last 0.2 s, as those of recorded tracks."""
_GENTLE_M_S2: Final = 2.5
"""How a track that is driven beyond its end stops."""
DECIMALS: Final = 6
"""Of poses that an adversary drives: what is driven is what is stored."""


@dataclass(frozen=True, slots=True)
class Replanning:
    """One planning frame of an adversary; ``score`` of the chosen candidate, lower is better, ``None`` where none was.

    It ``braked`` on its own path where no candidate was allowed. ``considered`` is a
    `benchmark.records.search_trace.SearchTraceFrame` as JSON, where it was asked for.
    """

    frame: int
    score: float | None
    braked: bool
    considered: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class AdversaryTrack:
    """(F, 3) poses of an adversary's box centre from the frame ``start`` on; ``agent`` is its index in the scene.

    ``traffic`` are agents who left their recordings where another simulator's traffic drove: index, number of the step
    of 0.1 s from which on, and (K, 3) poses after each, NaN where one is gone.
    """

    agent: int
    start: int
    poses: Floats
    replanned: tuple[Replanning, ...] = ()
    traffic: tuple[tuple[int, int, Floats], ...] = ()


@runtime_checkable
class AdversarialPolicy(Protocol):
    """A policy with an adversary in it."""

    def adversary(self, memory: Any) -> AdversaryTrack:
        """Where it has been planned to go so far."""


class AdversaryFactory(Protocol):
    """Puts an adversary among the others. Picklable.

    Attributes:
        others: Policy of the others, by its name.
        facts: All that the adversary depends on: part of what is measured.
    """

    @property
    def others(self) -> str:
        """As above."""

    @property
    def facts(self) -> Mapping[str, Any]:
        """As above."""

    def possible(self, scene: Scene) -> bool:
        """Whether any vehicle in a scene can become an adversary."""

    def policy(
        self, scene: Scene, run: int, start_us: int, others: Callable[[int], AgentPolicy[Any]]
    ) -> AgentPolicy[Any]:
        """The policy of a scene.

        Args:
            scene: The scene.
            run: Which vehicle, and its seed.
            start_us: When the drive starts.
            others: Gives the policy of all agents but the adversary, whose index it takes.
        """


@dataclass(frozen=True, slots=True)
class Handover:
    """Hand-over of an adversary from its recording at the frame ``start``.

    ``times_us`` are (T,) of the scene's frames, ``recorded`` (T, 3) poses of its box centre; ``first`` is the first
    frame of its recorded presence up to ``start``.
    """

    agent: int
    start: int
    times_us: NDArray[np.int64]
    recorded: Floats
    first: int

    @classmethod
    def of(cls, scene: Scene, agent: int, start: int) -> Self:
        """The hand-over of a vehicle at a frame."""
        agents = scene.agents
        absent = np.flatnonzero(~agents.valid[agent, : start + 1])
        first = int(absent[-1]) + 1 if len(absent) else 0
        poses = np.column_stack([agents.position[agent, :, :2], agents.yaw[agent]])
        return cls(agent, start, scene.timestamps_us, poses, min(first, start))

    def moved(self, others: AgentMotion, track: Floats, time_us: int) -> AgentMotion:
        """The 0.1 s after a time, the adversary among the others.

        ``track`` are (F, 3) poses from the hand-over on, as far as the 0.1 s or to the scene's last frame. Until its
        hand-over it is one of the others, and like all agents it is gone once the scene's frames end.
        """
        times = time_us + INSTANT_US * np.arange(1, INSTANTS + 1)
        driven = times >= self.times_us[self.start]
        if not driven.any():
            return others
        boxes, present, velocity = others.boxes.copy(), others.present.copy(), others.velocity.copy()
        poses = self.poses(track, times)
        boxes[np.flatnonzero(driven)[:, None], self.agent, [[0, 1, 4]]] = poses[driven]
        present[driven, self.agent] = times[driven] <= self.times_us[-1]
        earlier = max(int(times[-1]) - _MEMORY_US, int(self.times_us[self.first]))
        span = (int(times[-1]) - earlier) / 1e6
        if span > 0.0:
            before = self.poses(track, np.array([earlier]))[0]
            velocity[self.agent] = (poses[-1, :2] - before[:2]) / span
        return AgentMotion(boxes, present, velocity)

    def poses(self, track: Floats, times_us: NDArray[np.int64]) -> Floats:
        """(K, 3) poses at (K,) times: linear between frames, headings by the shortest turn."""
        known = np.concatenate([self.recorded[self.first : self.start], track])
        frames = self.times_us[self.first : self.first + len(known)]
        # The part of the track after the scene's end is not driven.
        known = known[: len(frames)]
        seconds, query_seconds = (frames - frames[0]) / 1e6, (times_us - frames[0]) / 1e6
        yaw = np.unwrap(known[:, 2])
        query_poses = np.column_stack(
            [np.interp(query_seconds, seconds, column) for column in (known[:, 0], known[:, 1], yaw)]
        )
        query_poses[:, 2] = wrap_angle(query_poses[:, 2])
        return query_poses


@dataclass(frozen=True, slots=True)
class ScriptedAdversary:
    """Adversary that drives a given track, independent of the ego, then brakes to a stop on its heading."""

    others: AgentPolicy[Any]
    handover: Handover
    track: AdversaryTrack
    name: str = ADVERSARY
    draws: bool = False
    _whole: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        left = len(self.handover.times_us) - self.track.start - len(self.track.poses)
        object.__setattr__(
            self, "_whole", _append_stop(self.track.poses, self.handover.times_us, self.track.start, left)
        )

    def init(self, time_us: int, key: int) -> tuple[Any, AgentMotion]:
        """All agents where the others have them."""
        return self.others.init(time_us, key)

    def act(self, memory: Any, moment: TrafficSnapshot, key: int) -> tuple[Any, AgentMotion]:
        """The next 0.1 s."""
        memory, moved = self.others.act(memory, moment, key)
        return memory, self.handover.moved(moved, self._whole, moment.time_us)

    def adversary(self, memory: Any) -> AdversaryTrack:
        """The tracks that were passed in."""
        return self.track


def _append_stop(poses: Floats, times_us: NDArray[np.int64], start: int, frames: int) -> Floats:
    """(F + frames, 3) a track and its stop."""
    if frames <= 0 or not len(poses):
        return poses
    last = start + len(poses) - 1
    before = poses[-2] if len(poses) > 1 else poses[-1]
    span = (times_us[last] - times_us[last - 1]) / 1e6 if last else 1.0
    speed = float(np.hypot(*(poses[-1, :2] - before[:2]))) / span
    seconds = np.minimum((times_us[last + 1 : last + 1 + frames] - times_us[last]) / 1e6, speed / _GENTLE_M_S2)
    travel = speed * seconds - 0.5 * _GENTLE_M_S2 * seconds**2
    on = np.repeat(poses[-1:], frames, axis=0)
    on[:, :2] += travel[:, None] * [np.cos(poses[-1, 2]), np.sin(poses[-1, 2])]
    return np.concatenate([poses, on])


@dataclass(frozen=True, slots=True)
class ScriptedTracks:
    """Adversaries that drive given tracks, by scene and run, of drives driven already; ``facts`` say where from."""

    tracks: Mapping[tuple[str, int], AdversaryTrack]
    others: str
    facts: Mapping[str, Any] = field(default_factory=dict)

    def possible(self, scene: Scene) -> bool:
        """Whether there is a track of the scene."""
        return any(name == scene.name for name, _ in self.tracks)

    def policy(
        self, scene: Scene, run: int, start_us: int, others: Callable[[int], AgentPolicy[Any]]
    ) -> AgentPolicy[Any]:
        """The policy of a scene; raises `InputError` where there is no track of it, or one that does not fit it."""
        track = self.tracks.get((scene.name, run))
        if track is None:
            raise InputError(f"no adversary track for {scene.name}, run {run}; drive it first")
        room = len(scene.timestamps_us) - track.start
        if not 0 <= track.agent < len(scene.agents) or not 0 < len(track.poses) <= room:
            raise InputError(
                f"the track of the adversary in {scene.name}, run {run}, does not match the scene; drive it again"
            )
        if track.traffic:
            return ScriptedTraffic(others(track.agent), track, start_us)
        return ScriptedAdversary(others(track.agent), Handover.of(scene, track.agent, track.start), track)


@dataclass(frozen=True, slots=True)
class ScriptedTraffic:
    """Traffic of another simulator driven again: who left the recordings, every 0.1 s, the others as they do."""

    others: AgentPolicy[Any]
    track: AdversaryTrack
    start_us: int
    name: str = ADVERSARY
    draws: bool = False

    def init(self, time_us: int, key: int) -> tuple[Any, AgentMotion]:
        """All agents where the others have them."""
        return self.others.init(time_us, key)

    def act(self, memory: Any, moment: TrafficSnapshot, key: int) -> tuple[Any, AgentMotion]:
        """The next 0.1 s."""
        memory, moved = self.others.act(memory, moment, key)
        step = (moment.time_us - self.start_us) // SUBSTEP_US
        driven = {
            agent: poses[step - first]
            for agent, first, poses in self.track.traffic
            if first <= step < first + len(poses)
        }
        return memory, place_traffic(moved, moment, driven)

    def adversary(self, memory: Any) -> AdversaryTrack:
        """The track that was passed in."""
        return self.track


def place_traffic(moved: AgentMotion, moment: TrafficSnapshot, driven: Mapping[int, Floats]) -> AgentMotion:
    """The motion of 0.1 s with some agents at (3,) poses after it, NaN where they are gone; half-way in between."""
    boxes, present, velocity = moved.boxes.copy(), moved.present.copy(), moved.velocity.copy()
    for agent, pose in driven.items():
        there = bool(np.isfinite(pose).all())
        present[:, agent] = there
        if there:
            before = moment.boxes[agent, [0, 1, 4]] if moment.present[agent] else pose
            boxes[0, agent, [0, 1, 4]] = poses_between(before, pose, np.array(0.5))
            boxes[1, agent, [0, 1, 4]] = pose
            velocity[agent] = (pose[:2] - before[:2]) / (SUBSTEP_US / 1e6)
    return AgentMotion(boxes, present, velocity)


def round_poses(poses: Floats) -> Floats:
    """Poses as they are driven and stored."""
    return np.asarray(np.round(poses, DECIMALS) + 0.0)
