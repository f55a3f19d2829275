"""Whole runs with recorded plans: recordings as read, states, sub-steps, checks, boxes of actors, contact and score."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.neuroncap.actors import compute_heading
from benchmark.extensions.neuroncap.contact import EgoMoment, find_contact
from benchmark.extensions.neuroncap.loop import (
    Engine,
    NeuroncapWorld,
    UncheckedState,
    begin,
    compute_future_moments,
    compute_moments,
    find_command,
    finish_run,
    is_running,
    step,
)
from benchmark.extensions.neuroncap.recording import (
    CAN_COLUMNS,
    NeuroncapAnnotations,
    NeuroncapRecording,
    build_actors,
    select_messages,
    select_steering,
)
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.score import score_run
from benchmark.extensions.neuroncap.staging import RenderableActors, StagedRun, stage_run
from benchmark.extensions.neuroncap.vehicle import SUBSTEPS
from benchmark.extensions.neuroncap.verification.driving import (
    COMMAND_COLUMNS,
    STATE_COLUMNS,
    compute_single_error,
    compute_state_errors,
    parse_nan,
    read_plans,
)
from benchmark.geometry import Floats, transform_matrix, wrap_angle
from benchmark.records.neuroncap_aggregate import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

CHECK_COLUMNS: Final = 7
"""Number of the state, microseconds since the recording began, x, y, heading, speed, whether any actor is touched."""
CheckRow = tuple[float, ...]


def list_checks(engine: Engine, waiting: UncheckedState | None, number: int) -> list[CheckRow]:
    """`CHECK_COLUMNS` rows of one state: moments up to the first contact, then those of the plan if futures count."""
    if waiting is None:
        return []
    rows = []
    for moment in compute_moments(waiting.before, waiting.state, engine.switches):
        rows.append(_check_row(engine, moment, number))
        if rows[-1][-1]:
            break
    if engine.check_futures and waiting.plan is not None:
        ahead = compute_future_moments(waiting.state.time_us, waiting.state.pose, waiting.plan, engine.switches)
        rows += [_check_row(engine, moment, number) for moment in ahead]
    return rows


def _check_row(engine: Engine, moment: EgoMoment, number: int) -> CheckRow:
    hit = find_contact(moment, engine.actors, engine.car, engine.switches) is not None
    since = moment.time_us - int(engine.recording.times[0])
    return (number, since, *moment.pose[:2, 3].tolist(), compute_heading(moment.pose), moment.speed, hit)


_SAME_RATE: Final = 1e-9
_BOX_COLUMNS: Final = 8
_YAW: Final = 3


def compare_run(
    comparison: Comparison,
    engine: Engine,
    run: dict[str, Any],
    stored: GoldenArrays,
    *,
    turning_freely: frozenset[str],
) -> None:
    """Drive a published run again and compare the stored arrays, but not headings of actors ``turning_freely``."""
    replay = _RunReplay(comparison, engine, stored, run["key"], turning_freely)
    world = replay.drive()
    comparison.verdicts("number of actors", len(engine.actors) != run["n_engine_actors"])
    comparison.verdicts("inferences", [replay.asked != run["n_infer_calls"], replay.asked != len(replay.plans)])
    comparison.verdicts("states checked", world.checked != run["n_states_checked"])
    _compare_contact(comparison, world, run["collision"])
    _compare_scores(comparison, engine, world, run)


class _RunReplay:
    """A run with recorded plans, compared state by state."""

    def __init__(
        self, comparison: Comparison, engine: Engine, stored: GoldenArrays, key: str, turning_freely: frozenset[str]
    ) -> None:
        self._comparison, self._engine, self._turning_freely = comparison, engine, turning_freely
        self.asked = 0
        self._times = stored.integers(f"{key}_state_time", None)
        count = len(self._times)
        self._poses = stored.floats(f"{key}_state_pose", count, 4, 4)
        self._canbus = stored.floats(f"{key}_state_canbus", count, CAN_COLUMNS)
        self._commands = stored.integers(f"{key}_command", count)
        self.plans = read_plans(stored, f"{key}_plan", [PLAN_STEPS] * count)
        self._post_times = stored.integers(f"{key}_post_time", None)
        steps = len(self._post_times)
        self._post_poses = stored.floats(f"{key}_post_pose", steps, 4, 4)
        self._post_canbus = stored.floats(f"{key}_post_canbus", steps, CAN_COLUMNS)
        self._post_driven = stored.verdicts(f"{key}_post_auto", steps)
        driven = int(np.count_nonzero(self._post_driven))
        self._states = stored.floats(f"{key}_substep_state", driven, SUBSTEPS, len(STATE_COLUMNS))
        self._asked = stored.floats(f"{key}_substep_command", driven, SUBSTEPS, len(COMMAND_COLUMNS))
        self._checks = stored.floats(f"{key}_check", None, CHECK_COLUMNS)
        self._boxes = stored.floats(f"{key}_actor_box", None, _BOX_COLUMNS)
        self._found: list[CheckRow] = []

    def drive(self) -> NeuroncapWorld:
        """From the start to the end, as long as there are plans."""
        engine, world, driven = self._engine, begin(self._engine), 0
        while is_running(engine, world) and self.asked < len(self.plans):
            number = self.asked
            self._compare_state(world, number)
            waiting = world.waiting
            world = step(engine, world, self.plans[number])
            self._found += list_checks(self._engine, waiting, number - 1)
            self.asked += 1
            if world.contact is not None:
                break
            self._compare_step(world, number, driven)
            driven += int(world.state.is_driven)
        last = world.waiting
        world = finish_run(engine, world)
        self._found += list_checks(self._engine, last, self.asked - 1)
        self._comparison.verdicts("steps", bool(driven != len(self._states)))
        self._compare_checks()
        return world

    def _compare_state(self, world: NeuroncapWorld, number: int) -> None:
        state = world.state
        self._comparison.verdicts("times", bool(state.time_us != self._times[number]))
        self._comparison.numbers("poses (m)", state.pose, self._poses[number])
        self._compare_canbus(state.canbus.astype(np.float64), self._canbus[number])
        self._comparison.verdicts("commands", bool(find_command(self._engine, world) != self._commands[number]))
        rows = self._boxes[self._boxes[:, 0] == number]
        ours = [self._compute_box(int(index), state.time_us) for index in rows[:, 1]]
        if len(rows):
            boxes = np.array(ours)
            others = [column for column in range(boxes.shape[1]) if column != _YAW]
            self._comparison.numbers("boxes of actors (m)", boxes[:, others], rows[:, 2:][:, others])
            turned = wrap_angle(boxes[:, _YAW] - rows[:, 2 + _YAW])
            free = np.array([self._find_uuid(int(index)) in self._turning_freely for index in rows[:, 1]])
            self._comparison.errors("headings of actors (rad)", turned[~free])

    def _compute_box(self, index: int, time_us: int) -> tuple[float, ...]:
        """x, y, z, yaw, width and length of an actor."""
        if not 0 <= index < len(self._engine.actors):
            return (np.nan,) * (_BOX_COLUMNS - 2)
        actor = self._engine.actors[index]
        pose = actor.pose_at(time_us)
        return (*pose[:3, 3].tolist(), compute_heading(pose), *actor.size[:2].tolist())

    def _find_uuid(self, index: int) -> str:
        return self._engine.actors[index].uuid if 0 <= index < len(self._engine.actors) else ""

    def _compare_step(self, world: NeuroncapWorld, number: int, driven: int) -> None:
        if number >= len(self._post_times) or (world.last is not None and driven >= len(self._states)):
            self._comparison.verdicts("steps", True)
            return
        state = world.state
        self._comparison.verdicts("times", bool(state.time_us != self._post_times[number]))
        self._comparison.verdicts("steps", bool(state.is_driven != self._post_driven[number]))
        self._comparison.numbers("poses (m)", state.pose, self._post_poses[number])
        self._compare_canbus(state.canbus.astype(np.float64), self._post_canbus[number])
        if world.last is not None:
            self._comparison.errors(
                "states of sub-steps", compute_state_errors(world.last.states, self._states[driven])
            )
            self._comparison.numbers("commands of sub-steps", world.last.commands, self._asked[driven])

    def _compare_checks(self) -> None:
        ours, golden = np.array(self._found).reshape(-1, CHECK_COLUMNS), self._checks
        self._comparison.verdicts("number of checks", bool(len(ours) != len(golden)))
        if len(ours) != len(golden):
            return
        wrong = (ours[:, [0, 1, -1]] != golden[:, [0, 1, -1]]).any(axis=1)
        self._comparison.verdicts("instants and verdicts of checks", wrong)
        self._comparison.numbers("places of checks (m)", ours[:, 2:4], golden[:, 2:4])
        turned = wrap_angle(ours[:, 4] - golden[:, 4])
        self._comparison.errors("headings of checks (rad)", turned)
        self._comparison.numbers("speeds of checks (m/s)", ours[:, 5], golden[:, 5])

    def _compare_canbus(self, ours: Floats, golden: Floats) -> None:
        self._comparison.errors("CAN rows, beyond one step of single precision", compute_single_error(ours, golden))


def _compare_contact(comparison: Comparison, world: NeuroncapWorld, golden: dict[str, Any] | None) -> None:
    contact = world.contact
    comparison.verdicts("contact", (contact is None) != (golden is None))
    if contact is None or golden is None:
        return
    contact_values = (contact.uuid, contact.index, contact.is_target, contact.time_us)
    wanted = (golden[name] for name in ("actor", "actor_index", "is_target", "time"))
    comparison.verdicts("who is touched, and when", [ours != theirs for ours, theirs in zip(contact_values, wanted)])
    comparison.numbers("IoU", contact.iou, golden["iou"])
    comparison.numbers("velocity of the ego (m/s)", contact.ego_velocity, golden["ego_velocity"])
    comparison.numbers("velocity of the actor (m/s)", contact.actor_velocity, golden["actor_velocity"])


def _compare_scores(comparison: Comparison, engine: Engine, world: NeuroncapWorld, run: dict[str, Any]) -> None:
    """Score, its parts, and the file of metrics; the paper's reference speed with all else as code."""
    golden = parse_nan(run)
    for reading in ("code", "paper"):
        switches = replace(engine.switches, reference_speed=reading)
        score = score_run(replace(engine, switches=switches), world)
        _compare_score(comparison, f"score, {reading}", score.score, golden[f"nns_{reading}"])
        speed = golden[f"reference_speed_{reading}"]
        comparison.numbers(f"reference speed, {reading} (m/s)", score.reference_speed, speed)
        if reading == "paper":
            continue
        comparison.numbers("impact speed (m/s)", score.impact_speed, golden["impact_speed"])
        for name, ours in score.metrics.items():
            theirs = float(golden["metrics"].get(name, np.inf))
            if name == "ncap_score":
                _compare_score(comparison, "score in the file", ours, theirs)
            else:
                comparison.verdicts("rates in the file", not abs(float(ours) - theirs) <= _SAME_RATE)


def _compare_score(comparison: Comparison, name: str, ours: float, golden: float) -> None:
    """A score; NaN must be NaN."""
    comparison.errors(name, 0.0 if np.isnan(ours) and np.isnan(golden) else ours - golden)


def compare_loops(comparison: Comparison, folder: GoldenFolder) -> None:
    """Replay all runs."""
    loops = GoldenFolder(folder.path / "loops")
    failed = 0
    for name in (row["file"] for row in loops.facts("index.json")):
        facts = loops.facts(_require_inside(name), gaps=True)
        recording = _compare_recording(comparison, loops.arrays(_require_inside(facts["inputs"])))
        stored = loops.arrays(_require_inside(facts["arrays"]))
        scenario_facts = facts["scenario"]
        scenario = Scenario() if scenario_facts is None else Scenario.of(parse_nan(scenario_facts), name)
        cast, knows = RenderableActors.of(recording.actors), frozenset(facts["renderer_knows"])
        for run in facts["runs"]:
            if run["error"] is not None:
                failed += 1
                continue
            at = comparison.at(f"{name}, {run['key']}", "loops: ")
            stage = stage_run(scenario, run["run"] or 0, recording.times, cast, CODE)
            _compare_stage(at, stage, run, stored, turning_freely=_find_optimized_actors(scenario))
            engine = Engine.of(
                recording,
                stage,
                priming_steps=scenario.priming_steps,
                renderer_knows=knows,
                switches=CODE,
                check_futures=run["evaluate_future_collisions"],
            )
            compare_run(at, engine, run, stored, turning_freely=_find_optimized_actors(scenario))
    if failed:
        comparison.note("loops: inferences", f"{failed} runs in which the published engine itself failed are left out")


def _require_inside(name: str) -> str:
    """A file's name that stays in its folder."""
    if Path(name).name != name:
        raise ValueError(f"{name!r} is not a plain file name")
    return name


def _compare_recording(comparison: Comparison, stored: GoldenArrays) -> NeuroncapRecording:
    """The recording as we read it, compared with what the published engine made of the same messages."""
    at, times = comparison.at(stored.path.name, "loops: "), stored.integers("timestamps", None)
    frames = len(times)
    rotation, place = stored.floats("ego_quaternion_wxyz", frames, 4), stored.floats("ego_translation", frames, 3)
    poses = np.array([transform_matrix(*pose_parts) for pose_parts in zip(rotation, place)])
    at.numbers("recorded poses (m)", poses, stored.floats("ego_pose", frames, 4, 4))
    can_times, wheel_times = stored.integers("can_pose_utime", None), stored.integers("can_steer_utime", None)
    canbus = select_messages(times, can_times, stored.floats("can_pose_signals", len(can_times), CAN_COLUMNS))
    wheel = select_steering(times, wheel_times, stored.floats("can_steer_degrees", len(wheel_times)))
    at.same("CAN rows at frames", canbus.astype(np.float64), stored.floats("canbus_at_frame", frames, CAN_COLUMNS))
    at.same("steering wheel at frames", wheel.astype(np.float64), stored.floats("steering_wheel_at_frame", frames))
    actors = build_actors(_read_annotations(stored), times, CODE)
    golden = list(zip(stored.texts("engine_actor_uuids"), stored.texts("engine_actor_classes")))
    at.verdicts("recorded actors, in order", [(actor.uuid, actor.kind) for actor in actors] != golden)
    recording = NeuroncapRecording(times, poses, canbus, wheel, actors)
    at.numbers("recorded path (m)", recording.path, stored.floats("reference_trajectory", frames, 3))
    return recording


def _read_annotations(stored: GoldenArrays) -> NeuroncapAnnotations:
    instance, tokens = stored.integers("ann_instance", None), stored.texts("instance_tokens")
    count = len(instance)
    return NeuroncapAnnotations(
        frame=stored.integers("ann_frame", count),
        instance=instance,
        translation=stored.floats("ann_translation", count, 3),
        rotation=stored.floats("ann_quaternion_wxyz", count, 4),
        size=stored.floats("ann_size_wlh", count, 3),
        tokens=tokens,
        categories=stored.texts("instance_category", len(tokens)),
    )


def _find_optimized_actors(scenario: Scenario) -> frozenset[str]:
    """Actors on the renderer's own track, beyond whose end the published rotation is noise times 1e5."""
    return frozenset(uuid for actor in scenario.actors if actor.mode == "optimized" for uuid in actor.uuids)


def _compare_stage(
    comparison: Comparison,
    stage: StagedRun,
    run: dict[str, Any],
    stored: GoldenArrays,
    *,
    turning_freely: frozenset[str],
) -> None:
    """Draws, start and end, and the actors as they were sent to the renderer."""
    comparison.verdicts("draws", [list(draw) for draw in stage.draws] != run["draws"])
    comparison.verdicts("start and end", [stage.start_frame != run["start_frame"], stage.end_us != run["end_time"]])
    if not stage.actors:
        return
    key, count = run["key"], len(stage.actors)
    times = stored.integers(f"{key}_scenario_actor_times", None, None)
    same = len(times) == count and all(np.array_equal(a.times, b) for a, b in zip(stage.actors, times))
    comparison.verdicts("stamps of the scenario's actors", not same)
    if not same:
        return
    poses = stored.floats(f"{key}_scenario_actor_poses", count, times.shape[1], 4, 4)
    for actor, facts, golden in zip(stage.actors, run["scenario_actors"], poses, strict=True):
        comparison.verdicts(
            "who is there, in order", actor.uuid != facts["uuid"] or actor.is_target != facts["is_target"]
        )
        comparison.numbers("sizes (m)", actor.size, facts["dims"])
        comparison.numbers("positions of the scenario's actors (m)", actor.poses[:, :3, 3], golden[:, :3, 3])
        if actor.uuid not in turning_freely:
            comparison.numbers("directions of the scenario's actors", actor.poses[:, :3, :3], golden[:, :3, :3])
