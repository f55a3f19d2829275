"""Scenarios: draws, and the actors that come of them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.extensions.neuroncap.actors import Actor, Integers
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import Cast, Staged, staged
from benchmark.extensions.neuroncap.verification.golden_set import TOLERANCE, NcapFacts
from benchmark.geometry import quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_switches import CODE
from benchmark.verification.checks import Comparison

_SHARED_SIZES: Final = "in_sequence"
"""In the name of a scenario whose runs share the renderer's sizes."""
_FRAMES: Final = 400
"""Of a stand-in for frame stamps: longer than any recording."""


def compare_scenarios(comparison: Comparison, path: Path) -> None:
    """Compare every run of every scenario.

    Args:
        comparison: Takes the errors.
        path: ``scenarios.json``.

    Raises:
        InputError: If the file cannot be used.
    """
    facts = NcapFacts.read(path)
    for each in facts.objects("official"):
        times = each.whole("first_timestamp") + each.whole("frame_interval_us") * np.arange(_FRAMES)
        name = f"{each.text('type')}/{each.text('sequence')}"
        _compare_runs(comparison, each, name, times, _cast(each.inner("actor_sources"), {}))
    made = facts.inner("synthetic")
    times = made.numbers("frame_timestamps", None).astype(np.int64)
    tracks = made.inner("optimized_original_tracks")
    cast = _cast(made.inner("original_actors"), {uuid: _track(tracks.inner(uuid), uuid) for uuid in tracks})
    for each in made.objects("scenarios"):
        _compare_runs(comparison, each, each.text("name"), times, cast)


def _cast(sources: NcapFacts, tracks: Mapping[str, Actor]) -> Cast:
    kinds = {uuid: sources.inner(uuid).text("category") for uuid in sources}
    return Cast(kinds, {uuid: sources.inner(uuid).numbers("dims", 3) for uuid in sources}, tracks)


def _track(facts: NcapFacts, uuid: str) -> Actor:
    """The renderer's own track: rows of x, y, z and the direction of its heading."""
    times = facts.numbers("timestamps", None).astype(np.int64)
    rows = facts.numbers("poses", len(times), 5)
    poses = [transform_matrix(quaternion_from_yaw(np.arctan2(row[4], row[3])), row[:3]) for row in rows]
    return Actor(uuid, "", np.zeros(3), times, np.array(poses))


def _compare_runs(comparison: Comparison, facts: NcapFacts, name: str, times: Integers, cast: Cast) -> None:
    scenario = Scenario.of(facts.table("scenario"), f"{facts.path.name}, {name}")
    modes = {uuid: actor.mode for actor in scenario.actors for uuid in actor.uuids}
    for run in facts.objects("runs"):
        draws = run.rows("draws")
        # A run with jitter switched off shuffles nobody.
        jitter = not scenario.actors or any(draw and draw[0] == "permutation" for draw in draws)
        ours = staged(scenario, run.whole("run"), times, cast, CODE, jitter=jitter)
        where = f"{name}, run {run.whole('run')}"
        comparison.verdicts("scenarios: draws", np.array([[list(draw) for draw in ours.draws] != draws]), where=where)
        wrong = [
            ours.start_frame != run.whole("start_frame"),
            ours.end_us != run.whole("end_time"),
            ours.dim_scale != (run.number("dim_scale") if run.known("dim_scale") else None),
        ]
        comparison.verdicts("scenarios: start, end, scale", np.array(wrong), where=where)
        _compare_actors(comparison, ours, run, modes, where)
        if _SHARED_SIZES in name:
            cast = replace(cast, sizes=ours.sizes)


def _compare_actors(comparison: Comparison, ours: Staged, run: NcapFacts, modes: Mapping[str, Any], where: str) -> None:
    golden = run.objects("actors") if run.rows("actors") else []
    comparison.verdicts("scenarios: who is there, in order", np.array([len(golden) != len(ours.actors)]), where=where)
    for actor, facts in zip(ours.actors, golden):
        rows = facts.numbers("rows", None, 7)
        # Stamps are above 2^50: JSON's numbers hold them exactly.
        same = len(rows) == len(actor.times) and np.array_equal(actor.times, rows[:, 0].astype(np.int64))
        is_other = (actor.uuid, actor.kind, actor.is_target) != (
            facts.text("uuid"),
            facts.text("category"),
            facts.flag("is_target"),
        )
        comparison.verdicts("scenarios: who is there, in order", np.array([is_other]), where=where)
        comparison.verdicts("scenarios: stamps", np.array([not same]), where=where)
        comparison.numbers("scenarios: sizes (m)", actor.size, facts.numbers("dims", 3), TOLERANCE, where=where)
        if not same or is_other:
            continue
        place = actor.poses[:, :3, 3]
        comparison.numbers("scenarios: positions (m)", place, rows[:, 1:4], TOLERANCE, where=where)
        if modes.get(actor.uuid) == "override":
            forward = actor.poses[:, :3, 0]
            comparison.numbers("scenarios: directions", forward, rows[:, 4:], TOLERANCE, where=where)
