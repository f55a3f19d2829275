"""The `default` engine: a scene of any split, driven after a second of priming, when the ego is the recorded one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.adversary import ADVERSARY, AdversarialPolicy, AdversaryFactory, AdversaryTrack
from benchmark.closed_loop.agent_policy import AgentPolicy
from benchmark.closed_loop.fault_attribution import EpisodeFaultAttribution
from benchmark.closed_loop.idm_policy import IdmPolicy
from benchmark.closed_loop.plan_tracking import INSTANTS, SUBSTEP_US, Ego
from benchmark.closed_loop.simulation_config import build_log_replay, build_simulation_config, read_recorded_ego
from benchmark.closed_loop.simulation_state import (
    CollisionEvent,
    EpisodeMotion,
    RecordedCan,
    RejectedPlanError,
    SimulationState,
    SimulatorBackend,
    require_enough_keyframes,
)
from benchmark.closed_loop.stepping import InfeasiblePlanError as UndrivableWaypointsError
from benchmark.closed_loop.stepping import (
    begin_simulation,
    is_running,
    require_drivable,
    step_replanning,
    step_together,
)
from benchmark.closed_loop.world_state import SimulationConfig, StepTrace, WorldState
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.identity_cache import IdentityCache
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import Plan
from benchmark.records.drive_schema import NeuroncapScore, StopCondition
from benchmark.records.encounter_window import EncounterWindow
from benchmark.scene import Scene


def build_recorded_motion(scene: Scene, first: int, last: int) -> EpisodeMotion:
    """Recorded frames from the first to the last as motion; the last one, a keyframe, is a planning instant."""
    frames = slice(first, last + 1)
    times = scene.timestamps_us[frames]
    ego = np.array([to_ego_columns(read_recorded_ego(scene, time)) for time in times.tolist()])
    agents = scene.agents
    tick: NDArray[np.int64] = np.array([last - first])
    return EpisodeMotion(times, ego, agents.position[:, frames], agents.yaw[:, frames], agents.valid[:, frames], tick)


def to_ego_columns(ego: Ego) -> Floats:
    """(7,) an ego of the default engine in the columns of a motion."""
    return np.array([ego.x, ego.y, ego.yaw, ego.speed, ego.acceleration, ego.yaw_rate, ego.steering])


_JITTER_US: Final = 20_000
"""Of frames of a recording."""
PRIMING_STEPS: Final = 2
"""Steps in which the ego is the recorded one, so that a planner with a memory has one (NeuroNCAP primes as long)."""


_REPLAYED: Final = "movable_object.debris"


def _build_replay_policy(scene: Scene, start_us: int, end_us: int) -> AgentPolicy[Any]:
    return build_log_replay(scene, start_us, end_us)


def _build_idm_policy(scene: Scene, start_us: int, end_us: int) -> AgentPolicy[Any]:
    return IdmPolicy.of(build_log_replay(scene, start_us, end_us), scene.agents.categories, scene.road_map)


def _build_policy(
    scene: Scene, agents: str, start_us: int, end_us: int, on_track: Sequence[int] = ()
) -> AgentPolicy[Any]:
    return POLICIES[agents](_without_idm_control(scene, on_track) if on_track else scene, start_us, end_us)


def _without_idm_control(scene: Scene, on_track: Sequence[int]) -> Scene:
    """The scene with vehicles that no policy drives: adversaries do what their tracks say."""
    names = [_REPLAYED if agent in on_track else name for agent, name in enumerate(scene.agents.categories)]
    return replace(scene, agents=replace(scene.agents, categories=tuple(names)))


_policy_of: Final = IdentityCache[Scene, AgentPolicy[Any]](_build_policy, kept=4)
"""Policies are values: drives of one scene share one."""
POLICIES: Final[dict[str, Callable[[Scene, int, int], AgentPolicy[Any]]]] = {
    "replay": _build_replay_policy,
    "idm": _build_idm_policy,
}
"""How the others behave, by the name that ``--agents`` takes; an adversary is among one of them."""
AGENTS: Final = (*POLICIES, ADVERSARY)


@dataclass(frozen=True, slots=True)
class DefaultBackend:
    """Maker of rides of the default engine.

    A plan takes effect ``latency_us`` later than it was made for; the adversary is only put among the agents where
    their policy is `ADVERSARY`; a drive ends at any contact, or at one that is the ego's fault. A ``window`` is of one
    scene: where the drive starts and ends, and which agents keep their tracks under any policy.
    """

    agents: str = "replay"
    latency_us: int = 0
    adversary: AdversaryFactory | None = None
    until: StopCondition = "contact"
    window: EncounterWindow | None = None

    @property
    def draws(self) -> bool:
        """An adversary draws, no other agent does."""
        return self.agents == ADVERSARY

    def families(self, read: Callable[[], tuple[Scene, RecordedCan]]) -> tuple[str, ...]:
        """A scene is driven as it is; not at all where no vehicle in it can become the adversary."""
        return ("",) if self.adversary is None or self.adversary.possible(read()[0]) else ()

    def advance_together(
        self, rides: Sequence[SimulationState], plans: Sequence[Plan]
    ) -> list[SimulationState | RejectedPlanError]:
        """Half a second of several rides; those past priming are stepped together."""
        return [*_advance_together([cast(DefaultSimulationState, ride) for ride in rides], plans)]

    def advance_replanning(
        self, ride: SimulationState, plan: Plan, replan: Callable[[SimulationState], Plan]
    ) -> SimulationState | RejectedPlanError:
        """As of `benchmark.closed_loop.simulation_state.ReplanningBackend`."""
        return cast(DefaultSimulationState, ride).advance_replanning(plan, replan)

    def begin(self, scene: Scene, run: int, can: RecordedCan, family: str = "") -> "DefaultSimulationState":
        """The ride at its first planning instant; refuses too short scenes, and unknown policies or latencies."""
        course = self.course(scene, run)
        first = int(scene.keyframes[0])
        motion, primed = build_recorded_motion(scene, first, first), self._span(scene)[0] + 1
        blames = None if self.until == "contact" else EpisodeFaultAttribution(scene, self.until)
        return DefaultSimulationState(scene, course, begin_simulation(course), motion, primed, blames)

    def course(self, scene: Scene, run: int) -> SimulationConfig:
        """The course of a run; raises `InputError` as `begin_simulation` does."""
        require_enough_keyframes(scene, PRIMING_STEPS + 2)
        if self.agents not in AGENTS:
            raise InputError(f"unknown agents {self.agents!r}; choose from {', '.join(AGENTS)}")
        first, last = self._span(scene)
        # Agents know where they drive beyond the window.
        start_us, over_us, end_us = (int(scene.timestamps_us[scene.keyframes[at]]) for at in (first, last, -1))
        return build_simulation_config(
            scene,
            policy=self.build_agents(scene, run, start_us, end_us),
            keyframe=first,
            duration_s=(over_us - start_us) * 1e-6,
            seed=run,
            latency_us=self.latency_us,
        )

    def _span(self, scene: Scene) -> tuple[int, int]:
        """Keyframes from which and up to which the ego drives."""
        window = self.window
        if window is None:
            return PRIMING_STEPS, len(scene.keyframes) - 1
        if not window.start < window.end < len(scene.keyframes) or not set(window.adversaries) <= set(scene.agents.ids):
            raise InputError(f"the window of {window.of} does not fit {scene.name}; run the same drive again")
        return window.start, window.end

    def build_agents(self, scene: Scene, run: int, start_us: int, end_us: int) -> AgentPolicy[Any]:
        """Policy of everybody but the ego; raises `InputError` where there should be an adversary and is none."""
        if self.agents != ADVERSARY:
            kept = () if self.window is None else self.window.adversaries
            on_track = tuple(scene.agents.ids.index(name) for name in kept)
            return _policy_of(scene, self.agents, start_us, end_us, on_track)
        if self.adversary is None:
            raise InputError("the scene has no adversary; drive with --agents adversary, or with stored tracks")
        others = self.adversary.others
        return self.adversary.policy(
            scene, run, start_us, lambda agent: _policy_of(scene, others, start_us, end_us, (agent,))
        )


@dataclass(frozen=True, slots=True)
class DefaultSimulationState:
    """Ride of the default engine; ``world`` is that where driving starts, then now, ``motion`` everything so far.

    ``primed`` are planning instants at which the ego is the recorded one. ``blames`` says if a contact is the ego's
    fault, which only then ends the ride.
    """

    scene: Scene
    course: SimulationConfig
    world: WorldState
    motion: EpisodeMotion
    primed: int = PRIMING_STEPS + 1
    blames: EpisodeFaultAttribution | None = None

    @property
    def start(self) -> int:
        """Keyframe of the first planning instant."""
        return 0

    @property
    def is_running(self) -> bool:
        """Whether a plan is wanted."""
        return is_running(self.course, self.world)

    @property
    def command(self) -> None:
        """By the route, as data sets have it."""
        return

    @property
    def can(self) -> None:
        """No row of its own."""
        return

    @property
    def touch(self) -> CollisionEvent | None:
        """The contact that ends it."""
        return self.world.contact

    @property
    def passed(self) -> tuple[CollisionEvent, ...]:
        """Contacts before it that do not."""
        return self.world.passed

    @property
    def adversary(self) -> AdversaryTrack | None:
        """Where an adversary went, if there is one."""
        policy = self.course.policy
        return policy.adversary(self.world.memory) if isinstance(policy, AdversarialPolicy) else None

    def after(self, plan: Plan) -> "DefaultSimulationState":
        """Half a second later; raises `RejectedPlanError`."""
        (advanced,) = _advance_together([self], [plan])
        if isinstance(advanced, RejectedPlanError):
            raise advanced
        return advanced

    def advance_primed(self) -> "DefaultSimulationState | None":
        """The state half a second later on the recorded path, ignoring the plan; ``None`` after priming."""
        ticks = len(self.motion.ticks)
        if ticks >= self.primed:
            return None
        frames = self.scene.keyframes
        later = build_recorded_motion(self.scene, int(frames[ticks - 1]) + 1, int(frames[ticks]))
        return replace(self, motion=self.motion.then(later))

    def advance_replanning(
        self, plan: Plan, replan: Callable[[SimulationState], Plan]
    ) -> "DefaultSimulationState | RejectedPlanError":
        """As of `DefaultBackend.advance_replanning`."""
        if (primed := self.advance_primed()) is not None:
            first, last = (int(frame) for frame in self.scene.keyframes[len(self.motion.ticks) - 1 :][:2])
            asked_us = int(self.scene.timestamps_us[first])
            for frame in range(first + 1, last):
                now_us = int(self.scene.timestamps_us[frame])
                if min(now_us - asked_us, int(self.scene.timestamps_us[last]) - now_us) >= SUBSTEP_US - _JITTER_US:
                    asked_us = now_us
                    replan(replace(self, motion=self.motion.then(build_recorded_motion(self.scene, first + 1, frame))))
            return primed
        ahead_m = float(self.scene.lidar.translation[0])

        def replan_waypoints(here: WorldState) -> Floats:
            return compute_rear_axle_waypoints(replan(self.with_world(here)), ahead_m)

        try:
            waypoints = compute_rear_axle_waypoints(plan, ahead_m)
            return self.with_world(step_replanning(self.remember_past(), self.world, waypoints, replan_waypoints))
        except UndrivableWaypointsError as error:
            return RejectedPlanError(str(error))

    def with_world(self, world: WorldState) -> "DefaultSimulationState":
        """In the world half a second later."""
        assert world.trace is not None
        return replace(self, world=world, motion=self.motion.then(self._trace_motion(self.world.time_us, world.trace)))

    def remember_past(self) -> SimulationConfig:
        """The course of the next step: who is to blame for a contact depends on all that went before."""
        blames = self.blames
        if blames is None:
            return self.course

        def blamed(contact: CollisionEvent, trace: StepTrace) -> bool:
            return blames(contact, self.motion.then(self._trace_motion(self.world.time_us, trace)))

        return replace(self.course, blamed=blamed)

    def finished(self) -> "DefaultSimulationState":
        """The same: every instant has been checked."""
        return self

    def neuroncap_score(self) -> NeuroncapScore | None:
        """None: NNS is NeuroNCAP's."""
        return None

    def _trace_motion(self, before_us: int, trace: StepTrace) -> EpisodeMotion:
        rows = slice(INSTANTS - 1, None, INSTANTS)
        boxes = trace.boxes[rows].transpose(1, 0, 2)
        times = before_us + SUBSTEP_US * np.arange(1, boxes.shape[1] + 1)
        frames = np.clip(np.searchsorted(self.scene.timestamps_us, times), 0, len(self.scene.timestamps_us) - 1)
        heights = self.scene.agents.position[:, frames, 2:]
        ego = np.array([to_ego_columns(Ego.of_row(row)) for row in trace.egos[INSTANTS::INSTANTS]])
        return EpisodeMotion(
            times_us=times,
            ego=ego,
            position=np.concatenate([boxes[..., :2], heights], axis=-1),
            yaw=boxes[..., 4],
            present=trace.present[rows].T,
            ticks=np.array([len(times) - 1]),
        )


def _advance_together(
    rides: "Sequence[DefaultSimulationState]", plans: Sequence[Plan]
) -> "list[DefaultSimulationState | RejectedPlanError]":
    """Each half a second later, or why its plan cannot be driven."""
    later: dict[int, DefaultSimulationState | RejectedPlanError] = {}
    driving: dict[int, Floats] = {}
    for place, (ride, plan) in enumerate(zip(rides, plans, strict=True)):
        primed = ride.advance_primed()
        if primed is not None:
            later[place] = primed
            continue
        try:
            waypoints = compute_rear_axle_waypoints(plan, float(ride.scene.lidar.translation[0]))
            driving[place] = require_drivable(ride.course, waypoints)
        except UndrivableWaypointsError as error:
            later[place] = RejectedPlanError(str(error))
    moving = [rides[place] for place in driving]
    courses = [ride.remember_past() for ride in moving]
    worlds = step_together(courses, [ride.world for ride in moving], [*driving.values()])
    later |= {place: ride.with_world(world) for place, ride, world in zip(driving, moving, worlds, strict=True)}
    return [later[place] for place in range(len(rides))]


def compute_rear_axle_waypoints(plan: Plan, lidar_ahead_m: float) -> Floats:
    """(6, 2) a plan's first 3 s as positions of the rear axle, x forward, y left, metres."""
    return np.asarray(plan_to_poses(plan, lidar_ahead_m)[:, :2])


def describe_agents(maker: SimulatorBackend) -> dict[str, Any]:
    """Settings of an engine's agents besides the name of their policy."""
    adversary = maker.adversary if isinstance(maker, DefaultBackend) else None
    return {} if adversary is None else dict(adversary.facts)


def read_stop_condition(maker: SimulatorBackend) -> StopCondition:
    """Event that ends an episode early; runs of other engines end at any contact."""
    return maker.until if isinstance(maker, DefaultBackend) else "contact"
