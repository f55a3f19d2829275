"""NeuroNCAP's engine as a ride: any scene of any split, with its own adversary as the target actor.

A scene as it is is driven as published code drives one without a scenario file: from its first frame, one primed step,
its own actors; but the score's reference speed takes the adversary as target, where published code has none. With
scenarios, of ours, NeuroNCAP's own or of a file, it is driven once for each family. The planner's motion and command
are the engine's.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.default_engine import build_recorded_motion
from benchmark.closed_loop.engines import is_scenario_file
from benchmark.closed_loop.simulation_state import (
    TICK_US,
    CollisionEvent,
    EpisodeMotion,
    RecordedCan,
    RejectedPlanError,
    SimulationState,
    require_enough_keyframes,
)
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Actor, Integers, compute_heading
from benchmark.extensions.neuroncap.contact import compute_box
from benchmark.extensions.neuroncap.loop import (
    Engine,
    NeuroncapEgoState,
    NeuroncapWorld,
    begin,
    find_command,
    finish_run,
    is_running,
    step,
)
from benchmark.extensions.neuroncap.plan_path import SUBSTEP_US, UnusablePlanError
from benchmark.extensions.neuroncap.recording import (
    NeuroncapRecording,
    build_actors,
    build_own_scenarios,
    has_can_bus,
    read_annotations,
    read_recording,
)
from benchmark.extensions.neuroncap.scenarios import Scenario, ScenarioFile, read_official_scenarios
from benchmark.extensions.neuroncap.score import compute_reference_speed, score_run
from benchmark.extensions.neuroncap.staging import RenderableActors, stage_run
from benchmark.geometry import Floats, transform_matrix
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import Command, Plan
from benchmark.records.drive_schema import OF_FILE, OWN, RECORDED, NeuroncapScore
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches
from benchmark.scene import Scene

_ACCELERATION, _RATE, _VELOCITY = slice(7, 10), slice(10, 13), slice(13, 16)
"""Of a CAN row of the engine."""
_FEWEST_TICKS: Final = 4
ADVERSARY_TARGET, NO_TARGET = "adversary", "none"
"""Whom the reference speed of a recorded scene is relative to: its first adversary, or nobody, as in published code."""
WITHOUT_SCENARIO: Final = Scenario()
"""Scenario of the published code if there is no scenario file."""
_COLUMNS: Final = [0, 1, 2, 3, 4, 6, 5]
"""Of a car of the engine, in the order of a motion's ego."""


@dataclass(frozen=True, slots=True)
class NeuroncapBackend:
    """Makes rides of NeuroNCAP's engine on ``recorded`` scenes, or with ``own`` or ``official`` scenarios by family.

    A `file` has the scenario of ``file``. The `target` of a recorded scene is its ``adversary``, or ``none``.
    """

    switches: NeuroncapSwitches
    scenarios: str = RECORDED
    file: ScenarioFile | None = None
    target: str = ADVERSARY_TARGET

    @property
    def draws(self) -> bool:
        """Whether two runs can differ."""
        return self.scenarios != RECORDED if self.file is None else self.file.scenario.draws

    @property
    def scenario_facts(self) -> dict[str, Any]:
        """What scenarios are besides their name, as a record keeps it."""
        if self.file is not None:
            return {"file": self.file.name, "scenario": self.file.content}
        return {} if self.target == ADVERSARY_TARGET else {"target": self.target}

    def families(self, read: Callable[[], tuple[Scene, RecordedCan]]) -> tuple[str, ...]:
        """Scenarios of a scene."""
        if self.scenarios == RECORDED:
            return ("",)
        scene, can = read()
        if self.file is not None:
            known = {actor.uuid for actor in build_recording(scene, can, self.switches).actors}
            return (self.file.family,) if self.file.uuids <= known else ()
        return tuple(find_scenarios(scene.name, build_recording(scene, can, self.switches), self.scenarios))

    def advance_together(
        self, rides: Sequence[SimulationState], plans: Sequence[Plan]
    ) -> list[SimulationState | RejectedPlanError]:
        """Half a second of several rides, one after the other: this engine knows one car."""
        return [_advance(state, plan) for state, plan in zip(rides, plans, strict=True)]

    def begin(self, scene: Scene, run: int, can: RecordedCan, family: str = "") -> "NeuroncapSimulationState":
        """The ride at its first planning instant; a scene too short to be driven and scored is refused."""
        require_enough_keyframes(scene, _FEWEST_TICKS)
        recording = build_recording(scene, can, self.switches)
        scenario = WITHOUT_SCENARIO
        if family or self.file is not None or self.target == NO_TARGET:
            recording = replace(
                recording, actors=tuple(replace(recorded_actor, is_target=False) for recorded_actor in recording.actors)
            )
        if self.file is not None:
            scenario = self.file.scenario
        elif family:
            scenario = find_scenarios(scene.name, recording, self.scenarios)[family]
        drawn = stage_run(scenario, run, recording.times, RenderableActors.of(recording.actors), self.switches)
        engine = Engine.of(
            recording,
            drawn,
            priming_steps=scenario.priming_steps,
            renderer_knows=frozenset(actor.uuid for actor in recording.actors),
            switches=self.switches,
        )
        # A run that could not be scored at its end is refused before the first plan.
        compute_reference_speed(recording, engine.start_frame, _find_target(engine), self.switches)
        world = begin(engine)
        frame, crowd = int(scene.keyframes[engine.start_frame]), AgentTracks.of(scene, engine)
        return NeuroncapSimulationState(
            scene, engine, world, crowd, crowd.around(build_recorded_motion(scene, frame, frame))
        )


@dataclass(frozen=True, slots=True)
class NeuroncapSimulationState:
    """Ride of NeuroNCAP's engine; see `benchmark.closed_loop.simulation_state.SimulationState`."""

    scene: Scene
    engine: Engine
    world: NeuroncapWorld
    crowd: "AgentTracks"
    motion: EpisodeMotion

    @property
    def start(self) -> int:
        """Keyframe of the first planning instant."""
        return self.engine.start_frame

    @property
    def primed(self) -> int:
        """Planning instants at which the ego is the recorded one."""
        return self.engine.priming_steps + 1

    @property
    def is_running(self) -> bool:
        """Whether a plan is needed."""
        return is_running(self.engine, self.world)

    @property
    def command(self) -> Command:
        """The engine's own."""
        return find_command(self.engine, self.world)

    @property
    def can(self) -> Floats:
        """(9,) the engine's own row."""
        row = np.asarray(self.world.state.canbus, np.float64)
        return np.concatenate([row[_VELOCITY], row[_ACCELERATION], row[_RATE]])

    @property
    def adversary(self) -> None:
        """Its actors never react."""
        return

    @property
    def passed(self) -> tuple[CollisionEvent, ...]:
        """Every contact ends a run."""
        return ()

    @property
    def touch(self) -> CollisionEvent | None:
        """The first contact."""
        contact, car = self.world.contact, self.engine.car
        if contact is None:
            return None
        agent = self.scene.agents.ids.index(contact.uuid)
        moment = self.motion.at(contact.time_us)
        pose = transform_matrix([np.cos(moment[2] / 2), 0.0, 0.0, np.sin(moment[2] / 2)], [*moment[:2], 0.0])
        actor = self.engine.actors[contact.index]
        width, length = actor.size[:2].tolist()
        return CollisionEvent(
            agent=agent,
            uuid=contact.uuid,
            category=self.scene.agents.categories[agent],
            time_us=contact.time_us,
            ego=compute_box(pose, car.length_m, car.width_m, car.box_ahead_m),
            ego_speed=float(np.linalg.norm(contact.ego_velocity)),
            other=compute_box(actor.pose_at(contact.time_us), length, width),
            other_velocity=contact.actor_velocity[:2],
        )

    def after(self, plan: Plan) -> "NeuroncapSimulationState":
        """Half a second later; raises `RejectedPlanError`."""
        waypoints = plan_to_poses(plan, float(self.scene.lidar.translation[0]))[:, :2]
        try:
            world = step(self.engine, self.world, waypoints)
        except UnusablePlanError as error:
            raise RejectedPlanError(str(error)) from error
        if world.state is self.world.state:
            return replace(self, world=world)
        if world.last is None:
            last = int(self.scene.keyframes[self.engine.start_frame + world.step])
            later = self.crowd.around(build_recorded_motion(self.scene, last - self._frames_before(last) + 1, last))
        else:
            later = self.crowd.motion(*_compute_substeps(self.world.state, world))
        return replace(self, world=world, motion=self.motion.then(later))

    def _frames_before(self, frame: int) -> int:
        """Frames since the last instant of the motion."""
        return frame - int(np.searchsorted(self.scene.timestamps_us, self.motion.times_us[-1]))

    def finished(self) -> "NeuroncapSimulationState":
        """The same with its last state checked."""
        return replace(self, world=finish_run(self.engine, self.world))

    def neuroncap_score(self) -> NeuroncapScore:
        """The engine's score of a finished ride."""
        run_score = score_run(self.engine, self.world)
        score = None if np.isnan(run_score.score) else run_score.score
        return NeuroncapScore(score, run_score.impact_speed, run_score.reference_speed)


def find_scenarios(name: str, recording: NeuroncapRecording, which: str) -> dict[str, Scenario]:
    """``own`` or ``official`` (nuScenes) scenarios of a scene by family, none where it has none."""
    if which == OWN:
        return build_own_scenarios(recording)
    return {
        official.family: official.scenario
        for official in read_official_scenarios()
        if official.evaluated and name == f"scene-{official.sequence}"
    }


def build_recording(scene: Scene, can: RecordedCan, switches: NeuroncapSwitches) -> NeuroncapRecording:
    """Recording that the engine reads of a scene; the scene's first adversary is its target.

    It is from the files of the CAN bus where there are any, else from what observations say.
    """
    if can.root is not None and has_can_bus(scene.name, can.root):
        recording = read_recording(scene, can.root, switches)
    else:
        recording = _build_observed_recording(scene, can, switches)
    target = scene.adversaries[0] if scene.adversaries else None
    return replace(
        recording, actors=tuple(replace(actor, is_target=actor.uuid == target) for actor in recording.actors)
    )


def _build_observed_recording(scene: Scene, can: RecordedCan, switches: NeuroncapSwitches) -> NeuroncapRecording:
    """A recording without files of a CAN bus: motion is that of observations, derived from poses if need be."""
    frames, rows = scene.keyframes, can.motion
    times = scene.timestamps_us[frames]
    position, rotation = scene.ego.position[frames], scene.ego.rotation[frames]
    canbus = np.concatenate([position, rotation, rows[:, 3:6], rows[:, 6:9], rows[:, 0:3]], axis=1)
    return NeuroncapRecording(
        times=times,
        poses=np.array([transform_matrix(turn, place) for turn, place in zip(rotation, position, strict=True)]),
        canbus=canbus.astype(np.float32),
        steering_wheel=can.steering_wheel_rad.astype(np.float32),
        actors=build_actors(read_annotations(scene), times, switches),
    )


@dataclass(frozen=True, slots=True)
class AgentTracks:
    """Agents as the engine has them, else as recorded; `gone` are in the recording and not in the run."""

    scene: Scene
    tracks: ContinuousTracks
    actors: dict[int, Actor]
    gone: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, engine: Engine) -> "AgentTracks":
        """The agents of a run."""
        place = {name: number for number, name in enumerate(scene.agents.ids)}
        there = {place[actor.uuid]: actor for actor in engine.actors}
        recorded = (place[actor.uuid] for actor in engine.recording.actors)
        return cls(
            scene, ContinuousTracks.of_scene(scene), there, tuple(agent for agent in recorded if agent not in there)
        )

    def around(self, motion: EpisodeMotion) -> EpisodeMotion:
        """A piece of the recorded ego's motion, with all other objects as they are in this run."""
        return self.motion(motion.times_us, motion.ego)

    def motion(self, times_us: Integers, ego: Floats) -> EpisodeMotion:
        """Motion of the (F, 7) ego and all other objects at (F,) microseconds, the last a planning instant."""
        seconds = (times_us - self.scene.timestamps_us[0]) * 1e-6
        boxes, present = self.tracks.agents_at(seconds)
        position = np.concatenate([boxes[..., :2], self._heights(seconds)[..., None]], axis=-1)
        yaw = boxes[..., 4].copy()
        present = present & (seconds <= self.tracks.seconds[-1])
        present[list(self.gone)] = False
        for agent, actor in self.actors.items():
            for row, time_us in enumerate(times_us.tolist()):
                present[agent, row] = actor.is_there(time_us)
                pose = actor.pose_at(time_us)
                position[agent, row], yaw[agent, row] = pose[:3, 3], compute_heading(pose)
        return EpisodeMotion(times_us, ego, position, yaw, present, np.array([len(times_us) - 1]))

    def _heights(self, seconds: Floats) -> Floats:
        """(N, F) heights of box centres at times, those of the nearest frame."""
        frame = np.clip(np.searchsorted(self.tracks.seconds, seconds), 0, len(self.tracks.seconds) - 1)
        return np.asarray(self.scene.agents.position[:, frame, 2])


def _compute_substeps(before: NeuroncapEgoState, world: NeuroncapWorld) -> tuple[Integers, Floats]:
    """The five sub-steps of a step: times and (5, 7) the ego."""
    assert world.last is not None
    states = world.last.states
    times = before.time_us + SUBSTEP_US * np.arange(1, len(states) + 1)
    assert int(times[-1]) == before.time_us + TICK_US
    return times, states[:, _COLUMNS]


def _advance(state: SimulationState, plan: Plan) -> SimulationState | RejectedPlanError:
    try:
        return state.after(plan)
    except RejectedPlanError as error:
        return error


def _find_target(engine: Engine) -> Actor | None:
    return next((actor for actor in engine.actors if actor.is_target), None)


def build_neuroncap_backend(engine: str, scenarios: str, facts: Mapping[str, Any] | None = None) -> NeuroncapBackend:
    """Maker of rides of the engine of a name; ``scenarios`` may be the path of a file, ``facts`` are of a record.

    Raises `InputError` if there is no such engine, or for no scenario file of NeuroNCAP.
    """
    facts = facts or {}
    target, switches = facts.get("target", ADVERSARY_TARGET), NeuroncapSwitches.named(engine)
    if target not in (ADVERSARY_TARGET, NO_TARGET):
        raise InputError(f"unknown target {target!r}; choose from {ADVERSARY_TARGET} and {NO_TARGET}")
    if target == NO_TARGET and scenarios != RECORDED:
        raise InputError(f"--target {target} is for recorded scenes, a scenario names its own; leave it out")
    if is_scenario_file(scenarios):
        return NeuroncapBackend(switches, OF_FILE, ScenarioFile.read(Path(scenarios)))
    file = ScenarioFile.of(str(facts.get("file")), facts.get("scenario")) if scenarios == OF_FILE else None
    return NeuroncapBackend(switches, scenarios, file, target)
