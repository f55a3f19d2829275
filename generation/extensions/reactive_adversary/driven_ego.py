"""A reference driver in the ego's place, on the recorded path, and those behind it, while an adversary is planned.

The world advances by 0.1 s: the ego decides by what it sees now, then all others move. Everybody but the ego, the
adversary and the vehicles that the ego holds up (`followers`) moves as recorded.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy.interpolate import PchipInterpolator

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANTS, SUBSTEP_US
from benchmark.closed_loop.reference_drivers import compute_ego_boxes, update_situation
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M
from benchmark.geometry import Bools, Floats, boxes_overlap, poses_between, wrap_angle
from benchmark.interactions.driver_simulation import DriverSimulation, DrivingSituation, ReferenceDriver
from benchmark.interactions.reaction import REACTION_S, Driver
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.machine.identity_cache import IdentityCache
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.followers import FollowerPolicy
from generation.search.driven_tracks import DrivenTracks
from generation.search.threat_settings import EgoDriver
from generation.search.verify import EGO, DiscardReason, VerificationFailure

DRIVERS: Final = {EgoDriver.IDM: Driver.IDM, EgoDriver.CAREFUL: Driver.CC}
HARDEST_M_S2, FASTEST_M_S2, ACROSS_M_S2 = 6.0, 3.0, 4.0
"""An ego that brakes, speeds up or turns harder is no driver to be measured against."""
REACTED_M_S, REACTED_M = 0.5, 0.5
"""Less than this, and the ego drives as it would have driven without the adversary."""
SMOOTHED_STEPS: Final = 5
_STEPS_OF_REACTION: Final = 8
_SECONDS: Final = SUBSTEP_US / 1e6


@dataclass(slots=True)
class DrivenWorld:
    """A scene under way with a reference driver in the ego's place, from its first frame on.

    ``agent`` is the adversary, if there is one: recorded until its track begins. ``states`` are (N, 3) poses and (N,)
    presence of all at each instant so far, ``contact`` the first one of the ego: seconds and the agent.
    """

    scene: Scene
    driver: EgoDriver
    agent: int | None
    situation: DrivingSituation
    policy: FollowerPolicy
    simulation: DriverSimulation
    moment: TrafficSnapshot
    memory: Any
    step: int = 0
    states: list[tuple[Floats, Bools]] = field(default_factory=list)
    contact: tuple[float, int] | None = None

    @classmethod
    def of(cls, scene: Scene, driver: EgoDriver, agent: int | None = None) -> "DrivenWorld":
        """A world at its first instant."""
        situation = get_situation(scene)
        policy = FollowerPolicy.behind(scene, situation, agent)
        memory, moved = policy.init(int(scene.timestamps_us[0]), 0)
        ego = situation.tracks.ego_at(situation.times[:1])[0]
        boxes, present = moved.boxes[-1], moved.present[-1]
        first = int(scene.timestamps_us[0])
        moment = TrafficSnapshot(first, ego, float(situation.speed[0]), boxes, present, moved.velocity)
        simulation = DriverSimulation(situation, [ReferenceDriver(DRIVERS[driver])])
        world = cls(scene, driver, agent, situation, policy, simulation, moment, memory)
        world.states.append((boxes[:, [0, 1, 4]], present))
        return world

    @property
    def is_over(self) -> bool:
        """Whether the grid of 0.1 s has ended."""
        return self.step >= len(self.situation.times) - 1

    @property
    def reaction(self) -> tuple[float, float]:
        """Seconds of its reaction that are left to a careful human, and its braking, m/s^2."""
        delay, braking = self.simulation.reaction
        return (REACTION_S * delay / _STEPS_OF_REACTION, 0.0) if delay > 0 else (0.0, braking)

    def advance(self, frame: int, start: int = 0, track: Floats | None = None) -> None:
        """Drive on to a frame, or to the end; an adversary's (F, 3) track from frame ``start`` on reaches it."""
        until = self.scene.seconds[frame]
        while not self.is_over and self.situation.times[self.step] < until - 1e-6:
            self._advance_step(start, track)

    def _advance_step(self, start: int, track: Floats | None) -> None:
        step, situation, moment = self.step, self.situation, self.moment
        self.simulation.step(step, update_situation(situation, situation.ignored, moment, step), 0)
        egos = compute_ego_boxes(situation, step, int(self.simulation.free_from[0]), self.simulation.station[0])
        speed = float(self.simulation.speed[0, step + 1])
        self.memory, moved = self.policy.act(self.memory, moment, 0)
        moved = self._place_adversary(moved, start, track)
        if self.contact is None:
            self._find_contact(egos, moved)
        self.step += 1
        now = moment.time_us + SUBSTEP_US
        self.moment = TrafficSnapshot(now, egos[-1], speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        self.states.append((moved.boxes[-1][:, [0, 1, 4]], moved.present[-1]))

    def _place_adversary(self, moved: AgentMotion, start: int, track: Floats | None) -> AgentMotion:
        """The motion of 0.1 s with the adversary on its track, once that has begun."""
        seconds = self.situation.times[self.step] + _SECONDS * np.arange(1, INSTANTS + 1) / INSTANTS
        if self.agent is None or track is None or not len(track) or seconds[-1] <= self.scene.seconds[start]:
            return moved
        frames = self.scene.seconds[start : start + len(track)]
        at = np.clip(np.searchsorted(frames, seconds) - 1, 0, max(len(track) - 2, 0))
        after = np.minimum(at + 1, len(track) - 1)
        share = np.clip((seconds - frames[at]) / np.maximum(frames[after] - frames[at], 1e-9), 0.0, 1.0)
        poses = poses_between(track[at], track[after], share)
        boxes, present, velocity = moved.boxes.copy(), moved.present.copy(), moved.velocity.copy()
        boxes[:, self.agent] = np.column_stack([
            poses[:, :2], np.broadcast_to(self.scene.agents.size[self.agent, :2], (INSTANTS, 2)), poses[:, 2]
        ])  # fmt: skip
        present[:, self.agent] = True
        velocity[self.agent] = (poses[-1, :2] - self.moment.boxes[self.agent, :2]) / _SECONDS
        return AgentMotion(boxes, present, velocity)

    def _find_contact(self, egos: Floats, moved: AgentMotion) -> None:
        for row in range(INSTANTS):
            hit = moved.present[row] & ~self.situation.ignored & boxes_overlap(egos[row][None], moved.boxes[row])
            if hit.any():
                self.contact = float(self.situation.times[self.step]), int(np.argmax(hit))
                return

    def expect(self) -> Scene:
        """The scene as driven up to now, in which the ego keeps its speed from now on."""
        seconds, step, simulation = self.scene.seconds, self.step, self.simulation
        now = self.situation.times[step]
        driven = np.interp(seconds, self.situation.times[: step + 1], simulation.station[0, : step + 1])
        ahead = simulation.station[0, step] + simulation.speed[0, step] * (seconds - now)
        return self.scene.with_ego(_place(self.situation, np.where(seconds <= now, driven, ahead)))

    def finish(self, start: int = 0, track: Floats | None = None) -> "EgoDrive":
        """The drive to the end of the scene."""
        self.advance(len(self.scene.timestamps_us) - 1, start, track)
        simulation = self.simulation
        return EgoDrive(
            times=self.situation.times,
            station=simulation.station[0],
            speed=simulation.speed[0],
            free_from=int(simulation.free_from[0]),
            tracks=DrivenTracks(self._sample_ego(), self._sample_followers()),
            contact=self.contact,
        )

    def _sample_ego(self) -> Floats:
        """(T, 3) rear-axle poses at 12 Hz: the recording's own until the driver drives by itself."""
        simulation, times, seconds = self.simulation, self.situation.times, self.scene.seconds
        poses, begins = self.scene.ego.pose, int(simulation.free_from[0])
        if begins < len(times) - 1:
            free = seconds > times[begins] + 1e-9
            smooth = smooth_station(simulation.station[0])
            station = PchipInterpolator(times, smooth)(np.clip(seconds, times[0], times[-1]))
            # Where the grid of 0.1 s ends before the last frame, the last speed is kept.
            station += np.maximum(seconds - times[-1], 0.0) * simulation.speed[0, -1]
            poses[free] = _place(self.situation, station[free])
        return poses

    def _sample_followers(self) -> Mapping[str, tuple[int, Floats]]:
        """First frame and (F, 3) poses of the box centre at 12 Hz of those who left their recording, by identifier."""
        found = {}
        times, seconds = self.situation.times, self.scene.seconds
        poses = np.stack([state for state, _ in self.states])
        present = np.stack([there for _, there in self.states])
        recorded, _ = self.situation.tracks.agents_at(times)
        for index in np.flatnonzero(self.memory.come).tolist():
            agent = int(self.policy.driving[index])
            left = np.hypot(*(poses[:, agent, :2] - recorded[agent, :, :2]).T) > 1e-9
            there = np.flatnonzero(present[:, agent])
            if not (left & present[:, agent]).any():
                continue
            first = max(int(np.argmax(left & present[:, agent])) - 1, int(there[0]))
            rows = np.arange(first, int(there[-1]) + 1)
            frames = np.flatnonzero((seconds >= times[rows[0]] - 1e-9) & (seconds <= times[rows[-1]] + STEP_S))
            columns = np.column_stack([poses[rows, agent, :2], np.unwrap(poses[rows, agent, 2])])
            at = np.clip(seconds[frames], times[rows[0]], times[rows[-1]])
            track = (
                PchipInterpolator(times[rows], columns)(at) if len(rows) > 1 else np.repeat(columns, len(at), axis=0)
            )
            found[self.scene.agents.ids[agent]] = int(frames[0]), track
        return found


@dataclass(frozen=True, slots=True)
class EgoDrive:
    """A drive through a scene: (K,) ``station`` and ``speed`` at ``times`` every 0.1 s, and ``tracks`` at 12 Hz.

    The driver drives by itself from step ``free_from`` on; ``contact`` is as of `DrivenWorld`.
    """

    times: Floats
    station: Floats
    speed: Floats
    free_from: int
    tracks: DrivenTracks
    contact: tuple[float, int] | None

    def find_failure(self, scene: Scene) -> VerificationFailure | None:
        """First reason for which nobody should be measured against this drive; ``None`` if there is none."""
        if self.contact is not None:
            seconds, agent = self.contact
            frame = int(np.searchsorted(scene.seconds, seconds))
            return VerificationFailure(DiscardReason.EGO_COLLIDES, frame, scene.agents.ids[agent])
        path = get_situation(scene).path
        beyond = self.station > path.end_m
        if beyond.any() and not scene.road_map.is_drivable(path.position(self.station[beyond])).all():
            return VerificationFailure(DiscardReason.EGO_LEAVES, len(scene.seconds) - 1, EGO)
        smooth = smooth_station(self.station)
        speed = np.diff(smooth) / STEP_S
        along, turn = np.diff(speed) / STEP_S, np.abs(np.diff(path.heading(smooth))) / STEP_S
        for what, values, limit in (
            ("braking, m/s^2", -along, HARDEST_M_S2),
            ("acceleration, m/s^2", along, FASTEST_M_S2),
            ("lateral acceleration, m/s^2", turn * speed, ACROSS_M_S2),
        ):
            # Of the driver alone: what the recording did is nobody's fault here.
            most = float(values[self.free_from :].max(initial=0.0))
            if most > limit + 1e-9:
                return VerificationFailure(DiscardReason.EGO_HARSH, None, EGO, quantity=what, value=most, limit=limit)
        return None

    def has_reacted(self, undisturbed: "EgoDrive") -> bool:
        """Whether the drive departs from the one without an adversary."""
        slower = np.abs(self.speed - undisturbed.speed).max()
        return bool(slower > REACTED_M_S or np.abs(self.station - undisturbed.station).max() > REACTED_M)


def smooth_station(station: Floats) -> Floats:
    """(K,) the same over half a second: a driver who brakes in pulses of 0.1 s brakes as hard as their mean."""
    half = SMOOTHED_STEPS // 2
    padded = np.pad(station, half, mode="reflect", reflect_type="odd")
    return np.convolve(padded, np.full(SMOOTHED_STEPS, 1.0 / SMOOTHED_STEPS), mode="valid")


def _place(situation: DrivingSituation, station: Floats) -> Floats:
    """(..., 3) rear-axle poses at stations."""
    boxes = situation.path.boxes(station)
    yaw = wrap_angle(boxes[..., 4])
    back = EGO_CENTER_FROM_REAR_AXLE_M * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.concatenate([boxes[..., :2] - back, yaw[..., None]], axis=-1)


def drive_undisturbed(scene: Scene, driver: EgoDriver) -> Scene:
    """A recorded scene in which a reference driver has the ego's place, and nobody challenges it."""
    return get_undisturbed(scene, driver).tracks.put_into(scene)


get_situation: Final = IdentityCache[Scene, DrivingSituation](
    lambda scene: DrivingSituation.of(ContinuousTracks.of_scene(scene)), kept=2
)
get_undisturbed: Final = IdentityCache[Scene, EgoDrive](
    lambda scene, driver: DrivenWorld.of(scene, driver).finish(), kept=2
)
