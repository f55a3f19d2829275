"""Scenarios with their draws and actors, and single contacts and commands."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.extensions.neuroncap.actors import Actor, Integers
from benchmark.extensions.neuroncap.contact import EgoMoment, NeuroncapCar, find_contact
from benchmark.extensions.neuroncap.loop import compute_command
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import RenderableActors, StagedRun, stage_run
from benchmark.geometry import quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_aggregate import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder


def compare_contacts(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all checks, with the published box and with a longer one that lies further ahead."""
    stored = folder.arrays("contact.npz")
    checks = len(stored.texts("kind"))
    poses, speed = stored.floats("ego", checks, 4, 4), stored.floats("speed", checks)
    time, actors = stored.integers("time", checks), _read_actors(stored, checks)
    hit, other_hit = stored.integers("hit", checks), stored.integers("hit_alt", checks)
    iou = stored.floats("iou", checks)
    ego_velocity, actor_velocity = stored.floats("ego_velocity", checks, 3), stored.floats("actor_velocity", checks, 3)
    car = NeuroncapCar.of(CODE)
    other = replace(car, box_ahead_m=EGO_CENTER_FROM_REAR_AXLE_M, length_m=float(np.float32(EGO_LENGTH_M)))
    for number in range(checks):
        at = comparison.at(f"contact.npz, check {number}")
        ego = EgoMoment(int(time[number]), poses[number], float(speed[number]))
        contact_of_code = find_contact(ego, actors[number], car, CODE)
        again = find_contact(ego, actors[number], other, CODE)
        for name, contact, golden in (("", contact_of_code, hit), (" with the other box", again, other_hit)):
            index = -1 if contact is None else contact.index
            at.verdicts(f"contact{name}: who is touched", bool(index != golden[number]))
        if contact_of_code is not None and contact_of_code.index == hit[number]:
            at.numbers("contact: IoU", contact_of_code.iou, iou[number])
            at.numbers("contact: velocity of the ego (m/s)", contact_of_code.ego_velocity, ego_velocity[number])
            at.numbers("contact: velocity of the actor (m/s)", contact_of_code.actor_velocity, actor_velocity[number])


def _read_actors(stored: GoldenArrays, checks: int) -> list[list[Actor]]:
    """Actors of each check, in order."""
    case = stored.integers("actor_case", None)
    kinds, sizes = stored.texts("actor_class", len(case)), stored.floats("actor_dims", len(case), 3)
    owner = stored.integers("pose_actor", None)
    times, poses = stored.integers("pose_time", len(owner)), stored.floats("pose", len(owner), 4, 4)
    actors_by_check: list[list[Actor]] = [[] for _ in range(checks)]
    for number, check in enumerate(case.tolist()):
        own = owner == number
        actors_by_check[check].append(Actor(str(number), kinds[number], sizes[number], times[own], poses[own]))
    return actors_by_check


def compare_commands(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare all commands."""
    stored = folder.arrays("command.npz")
    which = stored.integers("path", None)
    poses, speed = stored.floats("pose", len(which), 4, 4), stored.floats("speed", len(which))
    paths = {number: stored.floats(f"polyline_{number}", None, 3) for number in np.unique(which).tolist()}
    ours = [compute_command(pose, float(v), paths[line], CODE) for pose, v, line in zip(poses, speed, which.tolist())]
    comparison.at("command.npz").same("command", ours, stored.integers("command", len(which)))


_SHARED_SIZES: Final = "in_sequence"
"""In the name of a scenario whose runs share the renderer's sizes."""
_WHO: Final = ("uuid", "category", "is_target")
_FRAMES: Final = 400
"""Of a stand-in for frame stamps: longer than any recording."""


def compare_scenarios(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare every run of every scenario."""
    facts = folder.facts("scenarios.json")
    for scenario in facts["official"]:
        times = scenario["first_timestamp"] + scenario["frame_interval_us"] * np.arange(_FRAMES)
        _compare_runs(
            comparison,
            scenario,
            f"{scenario['type']}/{scenario['sequence']}",
            times,
            _read_renderable_actors(scenario["actor_sources"], {}),
        )
    synthetic = facts["synthetic"]
    tracks = {uuid: _read_track(track, uuid) for uuid, track in synthetic["optimized_original_tracks"].items()}
    cast, times = (
        _read_renderable_actors(synthetic["original_actors"], tracks),
        np.array(synthetic["frame_timestamps"], np.int64),
    )
    for scenario in synthetic["scenarios"]:
        _compare_runs(comparison, scenario, scenario["name"], times, cast)


def _read_renderable_actors(sources: dict[str, Any], tracks: Mapping[str, Actor]) -> RenderableActors:
    kinds = {uuid: source["category"] for uuid, source in sources.items()}
    return RenderableActors(
        kinds, {uuid: np.array(source["dims"], np.float64) for uuid, source in sources.items()}, tracks
    )


def _read_track(facts: dict[str, Any], uuid: str) -> Actor:
    """The renderer's own track: rows of x, y, z and the direction of its heading."""
    rows = np.array(facts["poses"], np.float64)
    poses = [transform_matrix(quaternion_from_yaw(np.arctan2(row[4], row[3])), row[:3]) for row in rows]
    return Actor(uuid, "", np.zeros(3), np.array(facts["timestamps"], np.int64), np.array(poses))


def _compare_runs(
    comparison: Comparison, facts: dict[str, Any], name: str, times: Integers, cast: RenderableActors
) -> None:
    scenario = Scenario.of(facts["scenario"], f"scenarios.json, {name}")
    modes = {uuid: actor.mode for actor in scenario.actors for uuid in actor.uuids}
    for run in facts["runs"]:
        draws = run["draws"]
        # A run with jitter switched off shuffles no actors.
        jitter = not scenario.actors or any(draw and draw[0] == "permutation" for draw in draws)
        ours = stage_run(scenario, run["run"], times, cast, CODE, jitter=jitter)
        at = comparison.at(f"{name}, run {run['run']}", "scenarios: ")
        at.verdicts("draws", [list(draw) for draw in ours.draws] != draws)
        staging = (ours.start_frame, ours.end_us, ours.dim_scale)
        wanted = (run["start_frame"], run["end_time"], run["dim_scale"])
        at.verdicts("start, end, scale", [mine != theirs for mine, theirs in zip(staging, wanted)])
        _compare_actors(at, ours, run["actors"], modes)
        if _SHARED_SIZES in name:
            cast = replace(cast, sizes=ours.sizes)


def _compare_actors(comparison: Comparison, ours: StagedRun, golden: list[Any], modes: Mapping[str, Any]) -> None:
    comparison.verdicts("who is there, in order", len(golden) != len(ours.actors))
    for actor, facts in zip(ours.actors, golden):
        # Stamps are above 2^50, which JSON's numbers hold exactly.
        rows = np.array(facts["rows"], np.float64)
        same = np.array_equal(actor.times, rows[:, 0].astype(np.int64))
        is_other = [actor.uuid, actor.kind, actor.is_target] != [facts[name] for name in _WHO]
        comparison.verdicts("who is there, in order", is_other)
        comparison.verdicts("stamps", not same)
        comparison.numbers("sizes (m)", actor.size, facts["dims"])
        if not same or is_other:
            continue
        comparison.numbers("positions (m)", actor.poses[:, :3, 3], rows[:, 1:4])
        if modes.get(actor.uuid) == "override":
            comparison.numbers("directions", actor.poses[:, :3, 0], rows[:, 4:])
