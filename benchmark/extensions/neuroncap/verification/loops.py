"""Whole runs: recordings as the engine reads them, then every state, check and contact with the recorded plans."""

from pathlib import Path
from typing import Any

import numpy as np

from benchmark.extensions.neuroncap.loop import Engine
from benchmark.extensions.neuroncap.recording import (
    CAN_COLUMNS,
    Annotations,
    Recording,
    actors_of,
    at_frames,
    steering_at_frames,
)
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import Cast, Staged, staged
from benchmark.extensions.neuroncap.verification.golden_set import with_nan
from benchmark.extensions.neuroncap.verification.replays import compare_run
from benchmark.geometry import transform_matrix
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays, GoldenFolder


def compare_loops(comparison: Comparison, folder: GoldenFolder) -> None:
    """Replay all runs."""
    loops = GoldenFolder(folder.path / "loops")
    failed = 0
    for name in (each["file"] for each in loops.facts("index.json")):
        facts = loops.facts(_inside(name), gaps=True)
        recording = _recording(comparison, loops.arrays(_inside(facts["inputs"])))
        stored = loops.arrays(_inside(facts["arrays"]))
        given = facts["scenario"]
        scenario = Scenario() if given is None else Scenario.of(with_nan(given), name)
        cast, knows = Cast.of(recording.actors), frozenset(facts["renderer_knows"])
        for run in facts["runs"]:
            if run["error"] is not None:
                failed += 1
                continue
            at = comparison.at(f"{name}, {run['key']}", "loops: ")
            stage = staged(scenario, run["run"] or 0, recording.times, cast, CODE)
            _compare_stage(at, stage, run, stored, turning_freely=_optimized(scenario))
            engine = Engine.of(
                recording,
                stage,
                priming_steps=scenario.priming_steps,
                renderer_knows=knows,
                switches=CODE,
                check_futures=run["evaluate_future_collisions"],
            )
            compare_run(at, engine, run, stored, turning_freely=_optimized(scenario))
    if failed:
        comparison.note("loops: inferences", f"{failed} runs in which the published engine itself failed are left out")


def _inside(name: str) -> str:
    """A file's name that stays in its folder."""
    if Path(name).name != name:
        raise ValueError(f"{name!r} is no plain file name")
    return name


def _recording(comparison: Comparison, stored: GoldenArrays) -> Recording:
    """The recording as we read it, compared with what the published engine made of the same messages."""
    at, times = comparison.at(stored.path.name, "loops: "), stored.integers("timestamps", None)
    frames = len(times)
    rotation, place = stored.floats("ego_quaternion_wxyz", frames, 4), stored.floats("ego_translation", frames, 3)
    poses = np.array([transform_matrix(*each) for each in zip(rotation, place)])
    at.numbers("recorded poses (m)", poses, stored.floats("ego_pose", frames, 4, 4))
    can_times, wheel_times = stored.integers("can_pose_utime", None), stored.integers("can_steer_utime", None)
    canbus = at_frames(times, can_times, stored.floats("can_pose_signals", len(can_times), CAN_COLUMNS))
    wheel = steering_at_frames(times, wheel_times, stored.floats("can_steer_degrees", len(wheel_times)))
    at.same("CAN rows at frames", canbus.astype(np.float64), stored.floats("canbus_at_frame", frames, CAN_COLUMNS))
    at.same("steering wheel at frames", wheel.astype(np.float64), stored.floats("steering_wheel_at_frame", frames))
    actors = actors_of(_annotations(stored), times, CODE)
    golden = list(zip(stored.texts("engine_actor_uuids"), stored.texts("engine_actor_classes")))
    at.verdicts("recorded actors, in order", [(actor.uuid, actor.kind) for actor in actors] != golden)
    recording = Recording(times, poses, canbus, wheel, actors)
    at.numbers("recorded path (m)", recording.path, stored.floats("reference_trajectory", frames, 3))
    return recording


def _annotations(stored: GoldenArrays) -> Annotations:
    instance, tokens = stored.integers("ann_instance", None), stored.texts("instance_tokens")
    count = len(instance)
    return Annotations(
        frame=stored.integers("ann_frame", count),
        instance=instance,
        translation=stored.floats("ann_translation", count, 3),
        rotation=stored.floats("ann_quaternion_wxyz", count, 4),
        size=stored.floats("ann_size_wlh", count, 3),
        tokens=tokens,
        categories=stored.texts("instance_category", len(tokens)),
    )


def _optimized(scenario: Scenario) -> frozenset[str]:
    """Actors on the renderer's own track, beyond whose end the published rotation is noise times 1e5."""
    return frozenset(uuid for actor in scenario.actors if actor.mode == "optimized" for uuid in actor.uuids)


def _compare_stage(
    comparison: Comparison, stage: Staged, run: dict[str, Any], stored: GoldenArrays, *, turning_freely: frozenset[str]
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
