"""Whole runs: recordings as the engine reads them, then every state, check and contact with the recorded plans."""

from pathlib import Path

import numpy as np

from benchmark.errors import InputError
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
from benchmark.extensions.neuroncap.verification.golden_set import TOLERANCE, NcapArrays, NcapFacts
from benchmark.extensions.neuroncap.verification.replays import compare_run
from benchmark.geometry import transform_matrix
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison


def loop_files(folder: Path) -> list[NcapFacts]:
    """The scenes of a folder of loops, each of whose files can be read.

    Args:
        folder: ``loops`` of a set.

    Returns:
        One object for each scene.

    Raises:
        InputError: If a file is missing or damaged.
    """
    scenes = [NcapFacts.read(folder / _inside(each, "file")) for each in NcapFacts.read_list(folder / "index.json")]
    for facts in scenes:
        for name in ("arrays", "inputs"):
            NcapArrays.read(folder / _inside(facts, name))
    return scenes


def _inside(facts: NcapFacts, name: str) -> str:
    """A file's name that stays in its folder."""
    text = facts.text(name)
    if Path(text).name != text:
        raise InputError(f"{facts.path}: {name} {text!r} is no plain file name; get the set again")
    return text


def compare_loops(comparison: Comparison, folder: Path) -> None:
    """Replay all runs.

    Args:
        comparison: Takes the errors.
        folder: ``loops`` of a set.

    Raises:
        InputError: If a file cannot be used.
    """
    failed = 0
    for facts in loop_files(folder):
        recording = _recording(comparison, NcapArrays.read(folder / _inside(facts, "inputs")))
        stored = NcapArrays.read(folder / _inside(facts, "arrays"))
        given = facts.table("scenario") if facts.known("scenario") else None
        scenario = Scenario() if given is None else Scenario.of(given, facts.path.name)
        cast, knows = Cast.of(recording.actors), frozenset(facts.texts("renderer_knows"))
        for run in facts.objects("runs"):
            if run.known("error"):
                failed += 1
                continue
            number = run.whole("run") if run.known("run") else 0
            where = f"{facts.path.name}, {run.text('key')}"
            stage = staged(scenario, number, recording.times, cast, CODE)
            _compare_stage(comparison, stage, run, stored, where, turning_freely=_optimized(scenario))
            engine = Engine.of(
                recording,
                stage,
                priming_steps=scenario.priming_steps,
                renderer_knows=knows,
                switches=CODE,
                check_futures=run.flag("evaluate_future_collisions"),
            )
            compare_run(comparison, engine, run, stored, where, turning_freely=_optimized(scenario))
    if failed:
        comparison.note("loops: inferences", f"{failed} runs in which the published engine itself failed are left out")


def _recording(comparison: Comparison, stored: NcapArrays) -> Recording:
    """The recording as we read it, compared with what the published engine made of the same messages."""
    where = stored.path.name
    times = stored.integers("timestamps", None)
    frames = len(times)
    if frames < 2 or (np.diff(times) <= 0).any():
        raise InputError(f"{stored.path}: timestamps are fewer than two, or do not rise; fetch the file again")
    rotation, place = stored.floats("ego_quaternion_wxyz", frames, 4), stored.floats("ego_translation", frames, 3)
    poses = np.array([transform_matrix(*each) for each in zip(rotation, place)])
    comparison.numbers(
        "loops: recorded poses (m)", poses, stored.floats("ego_pose", frames, 4, 4), TOLERANCE, where=where
    )
    can_times, wheel_times = stored.integers("can_pose_utime", None), stored.integers("can_steer_utime", None)
    if not len(can_times) or not len(wheel_times):
        raise InputError(f"{stored.path} has no CAN messages; fetch or make the file again")
    canbus = at_frames(times, can_times, stored.floats("can_pose_signals", len(can_times), CAN_COLUMNS))
    wheel = steering_at_frames(times, wheel_times, stored.floats("can_steer_degrees", len(wheel_times)))
    for name, ours, array in (
        ("CAN rows", canbus, stored.floats("canbus_at_frame", frames, CAN_COLUMNS)),
        ("steering wheel", wheel, stored.floats("steering_wheel_at_frame", frames)),
    ):
        comparison.verdicts(f"loops: {name} at frames", ours.astype(np.float64) != array, where=where)
    actors = actors_of(_annotations(stored, frames), times, CODE)
    uuids = stored.texts("engine_actor_uuids")
    kinds = stored.texts("engine_actor_classes", len(uuids))
    same = [(actor.uuid, actor.kind) for actor in actors] == list(zip(uuids, kinds))
    comparison.verdicts("loops: recorded actors, in order", np.array([not same]), where=where)
    recording = Recording(times, poses, canbus, wheel, actors)
    path = stored.floats("reference_trajectory", frames, 3)
    comparison.numbers("loops: recorded path (m)", recording.path, path, TOLERANCE, where=where)
    return recording


def _annotations(stored: NcapArrays, frames: int) -> Annotations:
    instance, tokens = stored.integers("ann_instance", None), stored.texts("instance_tokens")
    count = len(instance)
    frame = stored.integers("ann_frame", count)
    beyond = (instance < 0).any() or (instance >= len(tokens)).any() or (frame < 0).any() or (frame >= frames).any()
    if beyond:
        raise InputError(f"{stored.path}: annotations name instances or frames that are not there; get the file again")
    return Annotations(
        frame=frame,
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
    comparison: Comparison,
    stage: Staged,
    run: NcapFacts,
    stored: NcapArrays,
    where: str,
    *,
    turning_freely: frozenset[str],
) -> None:
    """Draws, start and end, and the actors as they were sent to the renderer."""
    wrong = [list(draw) for draw in stage.draws] != run.rows("draws")
    comparison.verdicts("loops: draws", np.array([wrong]), where=where)
    started = [stage.start_frame != run.whole("start_frame"), stage.end_us != run.whole("end_time")]
    comparison.verdicts("loops: start and end", np.array(started), where=where)
    if not stage.actors:
        return
    key, count = run.text("key"), len(stage.actors)
    times = stored.integers(f"{key}_scenario_actor_times", None, None)
    same = len(times) == count and all(np.array_equal(a.times, b) for a, b in zip(stage.actors, times))
    comparison.verdicts("loops: stamps of the scenario's actors", np.array([not same]), where=where)
    if not same:
        return
    poses = stored.floats(f"{key}_scenario_actor_poses", count, times.shape[1], 4, 4)
    for number, (actor, facts) in enumerate(zip(stage.actors, run.objects("scenario_actors"))):
        other = actor.uuid != facts.text("uuid") or actor.is_target != facts.flag("is_target")
        comparison.verdicts("loops: who is there, in order", np.array([other]), where=where)
        comparison.numbers("loops: sizes (m)", actor.size, facts.numbers("dims", 3), TOLERANCE, where=where)
        place = actor.poses[:, :3, 3]
        name = "loops: positions of the scenario's actors (m)"
        comparison.numbers(name, place, poses[number, :, :3, 3], TOLERANCE, where=where)
        if actor.uuid not in turning_freely:
            turned = actor.poses[:, :3, :3]
            name = "loops: directions of the scenario's actors"
            comparison.numbers(name, turned, poses[number, :, :3, :3], TOLERANCE, where=where)
