"""Scenarios: draws, and the actors that come of them."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.extensions.neuroncap.actors import Actor, Integers
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import Cast, Staged, staged
from benchmark.geometry import quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenFolder

_SHARED_SIZES: Final = "in_sequence"
"""In the name of a scenario whose runs share the renderer's sizes."""
_WHO: Final = ("uuid", "category", "is_target")
_FRAMES: Final = 400
"""Of a stand-in for frame stamps: longer than any recording."""


def compare_scenarios(comparison: Comparison, folder: GoldenFolder) -> None:
    """Compare every run of every scenario."""
    facts = folder.facts("scenarios.json")
    for each in facts["official"]:
        times = each["first_timestamp"] + each["frame_interval_us"] * np.arange(_FRAMES)
        _compare_runs(comparison, each, f"{each['type']}/{each['sequence']}", times, _cast(each["actor_sources"], {}))
    made = facts["synthetic"]
    tracks = {uuid: _track(track, uuid) for uuid, track in made["optimized_original_tracks"].items()}
    cast, times = _cast(made["original_actors"], tracks), np.array(made["frame_timestamps"], np.int64)
    for each in made["scenarios"]:
        _compare_runs(comparison, each, each["name"], times, cast)


def _cast(sources: dict[str, Any], tracks: Mapping[str, Actor]) -> Cast:
    kinds = {uuid: source["category"] for uuid, source in sources.items()}
    return Cast(kinds, {uuid: np.array(source["dims"], np.float64) for uuid, source in sources.items()}, tracks)


def _track(facts: dict[str, Any], uuid: str) -> Actor:
    """The renderer's own track: rows of x, y, z and the direction of its heading."""
    rows = np.array(facts["poses"], np.float64)
    poses = [transform_matrix(quaternion_from_yaw(np.arctan2(row[4], row[3])), row[:3]) for row in rows]
    return Actor(uuid, "", np.zeros(3), np.array(facts["timestamps"], np.int64), np.array(poses))


def _compare_runs(comparison: Comparison, facts: dict[str, Any], name: str, times: Integers, cast: Cast) -> None:
    scenario = Scenario.of(facts["scenario"], f"scenarios.json, {name}")
    modes = {uuid: actor.mode for actor in scenario.actors for uuid in actor.uuids}
    for run in facts["runs"]:
        draws = run["draws"]
        # A run with jitter switched off shuffles nobody.
        jitter = not scenario.actors or any(draw and draw[0] == "permutation" for draw in draws)
        ours = staged(scenario, run["run"], times, cast, CODE, jitter=jitter)
        at = comparison.at(f"{name}, run {run['run']}", "scenarios: ")
        at.verdicts("draws", [list(draw) for draw in ours.draws] != draws)
        found = (ours.start_frame, ours.end_us, ours.dim_scale)
        wanted = (run["start_frame"], run["end_time"], run["dim_scale"])
        at.verdicts("start, end, scale", [mine != theirs for mine, theirs in zip(found, wanted)])
        _compare_actors(at, ours, run["actors"], modes)
        if _SHARED_SIZES in name:
            cast = replace(cast, sizes=ours.sizes)


def _compare_actors(comparison: Comparison, ours: Staged, golden: list[Any], modes: Mapping[str, Any]) -> None:
    comparison.verdicts("who is there, in order", len(golden) != len(ours.actors))
    for actor, facts in zip(ours.actors, golden):
        # Stamps are above 2^50: JSON's numbers hold them exactly.
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
