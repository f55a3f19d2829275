"""The built-in golden set of NeuroNCAP.

``python -m tests.benchmark.extensions.neuroncap.golden_neuroncap`` writes it again. What the published code said of
made-up cases is thinned out of the set beside this repository; recorded paths and sizes do not go into it. The whole
runs are made up here, and what is said of them holds this implementation to what it said before.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.neuroncap.actors import compute_heading
from benchmark.extensions.neuroncap.loop import (
    Engine,
    NeuroncapWorld,
    begin,
    find_command,
    finish_run,
    is_running,
    step,
)  # fmt: skip
from benchmark.extensions.neuroncap.recording import (
    NeuroncapAnnotations,
    NeuroncapRecording,
    build_actors,
    select_messages,
    select_steering,
)  # fmt: skip
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.score import score_run
from benchmark.extensions.neuroncap.staging import RenderableActors, stage_run
from benchmark.extensions.neuroncap.verification import BUILT_IN
from benchmark.extensions.neuroncap.verification.loops import CheckRow, list_checks
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_aggregate import CODE
from tests.benchmark.extensions.golden_sets.altered import load

SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden" / "neuroncap"
START_US = 1_700_000_000_000_000
FRAMES = 30
SPEED, RADIUS = 8.0, 70.0
Arrays = dict[str, NDArray[Any]]
KNOWN = ("made-0", "made-1", "made-2")
AGGREGATES = (
    "one_nan_score", "null_for_a_whole_type", "a_sequence_without_runs", "a_run_without_a_key",
    "run_folder_without_metrics", "half_thousandths",
)  # fmt: skip
SCENARIO: dict[str, Any] = {
    "general": {"start-frame": 3, "priming_steps": 2, "time_step": 0.5, "duration": 7.0, "start_jitter": 1},
    "actors": [
        {
            "mode": "override",
            "uuids": ["made-0", "made-1"],
            "is_target_actor": True,
            "times": [0.0, 20.0],
            "positions": [[343.9, 115.6, 0.0], [343.9, 115.6, 0.0]],
            "initial-yaw": 0.7,
            "jitter": {"longitudinal": 2.0, "lateral": 0.5, "long_lat_angle": 0.7, "yaw_jitter": 0.4},
        },
        {"mode": "optimized", "uuid": "made-2"},
    ],
}


def made_inputs() -> Arrays:
    """A recording on a bend: everything that the engine reads of it."""
    times = START_US + 500_000 * np.arange(FRAMES) + np.array([0, 3_000, -4_000, 6_000, -2_000] * 6)
    ego = _bend((times - START_US) / 1e6, 0.0, SPEED)
    can_times = START_US - 400_000 + 20_000 * np.arange(FRAMES * 25 + 40)
    motion = _bend((can_times - START_US) / 1e6, 0.0, SPEED)
    signals = np.zeros((len(can_times), 16))
    signals[:, :2], signals[:, 3:7] = motion[:, :2], quaternion_from_yaw(motion[:, 2])
    signals[:, 8], signals[:, 9] = SPEED**2 / RADIUS, 9.8
    signals[:, 12], signals[:, 13] = SPEED / RADIUS, SPEED
    others = [
        _bend((times - START_US) / 1e6 + 3.0, 3.5, SPEED),
        _bend(np.full(FRAMES, 5.0), -4.0, SPEED),
        _bend((times - START_US) / 1e6 - 4.0, -3.5, 0.7 * SPEED),
        _bend(np.full(FRAMES, 9.0), 8.0, SPEED),
    ]
    frame, instance = (index.ravel() for index in np.meshgrid(np.arange(FRAMES), np.arange(4), indexing="ij"))
    boxes = np.array([others[i][f] for f, i in zip(frame, instance)])
    sizes = np.array([[1.9, 4.5, 1.6], [2.0, 4.8, 1.7], [1.8, 4.2, 1.5], [0.7, 0.7, 1.8]])
    return {
        "timestamps": times,
        "ego_translation": np.column_stack([ego[:, :2], np.zeros(FRAMES)]),
        "ego_quaternion_wxyz": quaternion_from_yaw(ego[:, 2]),
        "can_pose_utime": can_times,
        "can_pose_signals": np.round(signals, 9),
        "can_steer_utime": can_times[::2],
        "can_steer_degrees": np.full(len(can_times[::2]), 16 * np.degrees(np.arctan(2.588 / RADIUS))),
        "instance_tokens": np.array([f"made-{number}" for number in range(4)]),
        "instance_category": np.array(["vehicle.car", "vehicle.car", "vehicle.car", "human.pedestrian.adult"]),
        "ann_frame": frame,
        "ann_instance": instance,
        "ann_translation": np.column_stack([boxes[:, :2], sizes[instance, 2] / 2]),
        "ann_quaternion_wxyz": quaternion_from_yaw(boxes[:, 2]),
        "ann_size_wlh": sizes[instance],
    }


def _bend(seconds: Floats, aside: float, speed: float) -> Floats:
    """(T, 3) poses on a bend to the left, so far to the left of its middle."""
    angle = speed * np.asarray(seconds) / RADIUS
    radius = RADIUS - aside
    return np.column_stack([300.0 + radius * np.sin(angle), 170.0 - radius * np.cos(angle), angle])


def annotations_of(inputs: Arrays) -> NeuroncapAnnotations:
    """The annotations among them."""
    return NeuroncapAnnotations(
        frame=inputs["ann_frame"],
        instance=inputs["ann_instance"],
        translation=inputs["ann_translation"],
        rotation=inputs["ann_quaternion_wxyz"],
        size=inputs["ann_size_wlh"],
        tokens=inputs["instance_tokens"].tolist(),
        categories=inputs["instance_category"].tolist(),
    )


def recording_of(inputs: Arrays) -> NeuroncapRecording:
    """The recording as the engine reads it."""
    times = inputs["timestamps"]
    poses = zip(inputs["ego_quaternion_wxyz"], inputs["ego_translation"])
    return NeuroncapRecording(
        times=times,
        poses=np.array([transform_matrix(*pose) for pose in poses]),
        canbus=select_messages(times, inputs["can_pose_utime"], inputs["can_pose_signals"]),
        steering_wheel=select_steering(times, inputs["can_steer_utime"], inputs["can_steer_degrees"]),
        actors=build_actors(annotations_of(inputs), times, CODE),
    )


def cast_of(recording: NeuroncapRecording) -> RenderableActors:
    """Its own actors, as a renderer has them."""
    return RenderableActors.of(recording.actors)


def single(values: Floats) -> Floats:
    return np.asarray(values.astype(np.float32), np.float64)


def plan_of(model: str, world: NeuroncapWorld) -> Floats:
    """What a planner of three lines answers."""
    seconds = 0.5 * np.arange(1, PLAN_STEPS + 1)
    speed = float(world.state.canbus[13])
    if model == "brake":
        seconds = np.minimum(seconds, speed / 6.0) - 1.5 / speed * np.minimum(seconds, speed / 6.0) ** 2
    turn = speed / RADIUS if model == "bend" else 0.0
    along = np.sin(turn * seconds) * RADIUS if turn else speed * seconds
    aside = (1 - np.cos(turn * seconds)) * RADIUS
    return single(np.column_stack([along, aside]))


def made_loops() -> tuple[dict[str, Arrays], dict[str, Any]]:
    """Arrays and JSON by file."""
    inputs = made_inputs()
    recording = recording_of(inputs)
    inputs |= {
        "ego_pose": recording.poses,
        "canbus_at_frame": recording.canbus,
        "steering_wheel_at_frame": recording.steering_wheel,
        "engine_actor_uuids": np.array([actor.uuid for actor in recording.actors]),
        "engine_actor_classes": np.array([actor.kind for actor in recording.actors]),
        "reference_trajectory": recording.path,
    }
    arrays: Arrays = {}
    runs = [
        made_run(recording, arrays, f"r{index:03d}", model, run=run, futures=futures)
        for index, (model, run, futures) in enumerate(
            (("cv", 0, False), ("bend", 1, True), ("brake", 2, False), ("bend", 3, False))
        )
    ]
    facts = {
        "scene": "made",
        "scenario": SCENARIO,
        "renderer_knows": [*KNOWN],
        "inputs": "made_inputs.npz",
        "arrays": "made.npz",
        "runs": runs,
    }
    index = [{"file": "made.json"}]
    return {"loops/made_inputs": inputs, "loops/made": arrays}, {"loops/made": facts, "loops/index": index}


def made_run(
    recording: NeuroncapRecording, arrays: Arrays, key: str, model: str, *, run: int, futures: bool
) -> dict[str, Any]:
    """One run, written down as the published engine's are."""
    scenario = Scenario.of(SCENARIO, "made")
    stage = stage_run(scenario, run, recording.times, cast_of(recording), CODE)
    given: dict[str, Any] = {"renderer_knows": frozenset(KNOWN), "switches": CODE, "check_futures": futures}
    engine = Engine.of(recording, stage, priming_steps=scenario.priming_steps, **given)
    world, log = begin(engine), _Log(engine)
    while is_running(engine, world):
        plan = plan_of(model, world)
        log.worlds.append(world)
        log.plans.append(plan)
        waiting = world.waiting
        after = step(engine, world, plan)
        log.checks += list_checks(engine, waiting, len(log.plans) - 2)
        if after.contact is None:
            log.steps.append(after)
        world = after
    log.checks += list_checks(engine, world.waiting, len(log.plans) - 1)
    world = finish_run(engine, world)
    arrays |= {f"{key}_{name}": array for name, array in log.arrays().items()}
    arrays[f"{key}_scenario_actor_times"] = np.array([actor.times for actor in stage.actors])
    arrays[f"{key}_scenario_actor_poses"] = np.array([actor.poses for actor in stage.actors])
    return {
        "run": run,
        "key": key,
        "model": model,
        "draws": stage.draws,
        "error": None,
        "n_infer_calls": len(log.plans),
        "evaluate_future_collisions": futures,
        "start_frame": stage.start_frame,
        "end_time": stage.end_us,
        "scenario_actors": [
            {"uuid": actor.uuid, "dims": actor.size.tolist(), "is_target": actor.is_target} for actor in stage.actors
        ],
        **said_of(engine, world),
    }


def said_of(engine: Engine, world: NeuroncapWorld) -> dict[str, Any]:
    """Score and contact of a finished run."""
    scores = {
        reading: score_run(replace(engine, switches=replace(CODE, reference_speed=reading)), world)
        for reading in ("code", "paper")
    }
    contact = world.contact
    hit = contact and {
        "actor": contact.uuid,
        "actor_index": contact.index,
        "time": contact.time_us,
        "iou": contact.iou,
        "ego_velocity": contact.ego_velocity.tolist(),
        "actor_velocity": contact.actor_velocity.tolist(),
        "is_target": contact.is_target,
    }
    return {
        "n_states_checked": world.checked,
        "n_engine_actors": len(engine.actors),
        "impact_speed": scores["code"].impact_speed,
        **{f"nns_{reading}": score.score for reading, score in scores.items()},
        **{f"reference_speed_{reading}": score.reference_speed for reading, score in scores.items()},
        "metrics": scores["code"].metrics,
        "collision": hit,
    }


class _Log:
    """What a run leaves, array by array."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.plans: list[Floats] = []
        self.worlds: list[NeuroncapWorld] = []
        self.steps: list[NeuroncapWorld] = []
        self.checks: list[CheckRow] = []

    def arrays(self) -> Arrays:
        states, steps = [world.state for world in self.worlds], [world.state for world in self.steps]
        driven = [world.last for world in self.steps if world.last is not None]
        boxes = [
            (number, index, *pose[:3, 3], compute_heading(pose), *actor.size[:2])
            for number, state in enumerate(states)
            for index, actor in enumerate(self._engine.actors)
            if actor.is_there(state.time_us) and actor.kind == "car"
            for pose in (actor.pose_at(state.time_us),)
        ]
        return {
            "state_pose": np.array([state.pose for state in states]),
            "state_time": np.array([state.time_us for state in states]),
            "state_canbus": np.array([state.canbus for state in states]),
            "command": np.array([find_command(self._engine, world) for world in self.worlds], np.int8),
            "plan": np.array(self.plans, np.float32),
            "post_pose": np.array([state.pose for state in steps]),
            "post_time": np.array([state.time_us for state in steps]),
            "post_canbus": np.array([state.canbus for state in steps]),
            "post_auto": np.array([state.is_driven for state in steps]),
            "substep_state": np.array([last.states for last in driven]),
            "substep_command": np.array([last.commands for last in driven]),
            "check": np.array(self.checks, np.float64),
            "actor_box": np.array(boxes, np.float64),
        }


def thinned() -> tuple[dict[str, Arrays], dict[str, Any]]:
    """What the published code said of made-up cases: arrays and JSON by file, from the set beside this repository."""
    arrays = {
        "vehicle": _some_cases(load(SHARED / "vehicle.npz")),
        "contact": _some_checks(load(SHARED / "contact.npz")),
        "command": _made_up_paths(load(SHARED / "command.npz")),
    }
    scenarios = json.loads((SHARED / "scenarios.json").read_text())
    # Sizes of recorded cars stay where they are; stand-ins are nobody's.
    scenarios["official"] = [
        {**each, "runs": each["runs"][:2]}
        for each in scenarios["official"]
        if all("stand-in" in source["origin"] for source in each["actor_sources"].values())
    ][::2]
    for each in scenarios["synthetic"]["scenarios"]:
        each["runs"] = each["runs"][:2]
    aggregate = json.loads((SHARED / "aggregate.json").read_text())
    cases = [case for case in aggregate["cases"] if case["name"] in AGGREGATES]
    return arrays, {"scenarios": scenarios, "aggregate": {"cases": cases}}


def _some_cases(arrays: Arrays) -> Arrays:
    names = arrays["name"]
    kept = np.flatnonzero((np.arange(len(names)) % 6 == 0) | (names == "reverse") | (names == "waypoints_2"))
    steps = np.isin(arrays["step_case"], kept)
    thin = {
        name: array[steps] if len(array) == len(steps) else array[kept] if len(array) == len(names) else array
        for name, array in arrays.items()
    }
    thin["step_case"] = np.searchsorted(kept, thin["step_case"])
    return thin


def _some_checks(arrays: Arrays) -> Arrays:
    checks = np.arange(0, len(arrays["kind"]), 5)
    actors = np.flatnonzero(np.isin(arrays["actor_case"], checks))
    poses = np.isin(arrays["pose_actor"], actors)
    of_pose, of_actor = ("pose_actor", "pose_time", "pose"), ("actor_case", "actor_class", "actor_dims")
    thin = {
        name: array[poses if name in of_pose else actors if name in of_actor else checks]
        for name, array in arrays.items()
    }
    thin["actor_case"] = np.searchsorted(checks, thin["actor_case"])
    thin["pose_actor"] = np.searchsorted(actors, thin["pose_actor"])
    return thin


def _made_up_paths(arrays: Arrays) -> Arrays:
    made = [index for index, name in enumerate(arrays["path_names"]) if not str(name).startswith("scene-")]
    kept = np.isin(arrays["path"], made)
    thin = {name: arrays[name][kept] for name in ("path", "pose", "speed", "command")}
    return thin | {f"polyline_{index}": arrays[f"polyline_{index}"] for index in made}


def write(folder: Path = BUILT_IN) -> None:
    """Write the set."""
    made, thin = made_loops(), thinned()
    for name, held in {**made[0], **thin[0]}.items():
        path = folder / f"{name}.npz"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, **held)
    for name, facts in {**made[1], **thin[1]}.items():
        (folder / f"{name}.json").write_text(json.dumps(facts, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    write()
