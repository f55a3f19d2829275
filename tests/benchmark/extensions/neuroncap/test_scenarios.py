"""Scenarios: the official ones are all there, wrong ones are refused in a sentence."""

import json
from collections import Counter
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.scenarios import Scenario, read_official_scenarios
from benchmark.extensions.neuroncap.staging import stage_run
from benchmark.records.neuroncap_aggregate import CODE
from tests.benchmark.extensions.neuroncap.golden_neuroncap import SCENARIO, SHARED, cast_of, made_inputs, recording_of

EVALUATED = {
    "stationary": "0099 0101 0103 0106 0108 0278 0331 0783 0796 0966",
    "frontal": "0103 0106 0110 0346 0923",
    "side": "0103 0108 0110 0278 0921",
}


def test_the_official_scenarios_are_all_there() -> None:
    known = read_official_scenarios()
    for family, sequences in EVALUATED.items():
        assert [each.sequence for each in known if each.family == family and each.evaluated] == sequences.split()
    assert Counter(each.evaluated for each in known) == {True: 20, False: 1}
    assert all(sum(actor.is_target for actor in each.scenario.actors) == each.evaluated for each in known)
    assert all(each.scenario.draws for each in known)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_the_packaged_numbers_are_those_of_the_golden_set() -> None:
    golden = json.loads((SHARED / "scenarios.json").read_text())["official"]
    for ours, theirs in zip(read_official_scenarios(), golden, strict=True):
        assert (ours.family, ours.sequence) == (theirs["type"], theirs["sequence"])
        facts = json.loads(json.dumps(theirs["scenario"]).replace("times_without_effect", "times"))
        expected = Scenario.of(facts, "golden")
        for actor, other in zip(ours.scenario.actors, expected.actors, strict=True):
            assert (actor.uuids, actor.flipped, actor.jitter) == (other.uuids, other.flipped, other.jitter)
            assert actor.initial_yaw == other.initial_yaw and actor.is_target == other.is_target
            assert np.array_equal(actor.times, other.times) and np.array_equal(actor.positions, other.positions)  # type: ignore[arg-type]
        assert (ours.scenario.start_frame, ours.scenario.duration_s) == (expected.start_frame, expected.duration_s)


def changed(actor: dict[str, Any] | None = None, **general: Any) -> dict[str, Any]:
    target = {**SCENARIO["actors"][0], **(actor or {})}
    return {"general": {**SCENARIO["general"], **general}, "actors": [target]}


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({"actors": []}, "general"),
        (changed(time_step=0.1), "steps of 0.1 s"),
        (changed(duration="long"), "duration is not a finite number"),
        (changed(start_jitter=-1), "not a whole number of at least 0"),
        (changed({"mode": "overide"}), "did you mean override"),
        (changed({"uuids": []}), "names no actor"),
        (changed({"positions": [[0.0, 0.0, 0.0]]}), "positions is missing"),
        (changed({"times": [5.0, 1.0]}), "must be two or more in ascending order"),
        (changed({"dims": [1.0, None, 1.0]}), "dims"),
        (changed({"jitter": 3}), "not a table"),
        ({"general": {}, "actors": [SCENARIO["actors"][0]] * 2}, "more than one target"),
    ],
)
def test_a_wrong_scenario_is_refused(facts: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        Scenario.of(facts, "scenario.json")


def test_an_actor_that_nobody_knows_is_refused() -> None:
    recording = recording_of(made_inputs())
    for actor, says in (
        ({"uuids": ["nobody"]}, "not an instance"),
        ({"mode": "optimized", "uuids": ["made-3"]}, "track"),
    ):
        cast = cast_of(recording)
        tracks = {uuid: track for uuid, track in cast.tracks.items() if uuid != "made-3"}
        with pytest.raises(InputError, match=says):
            scenario = Scenario.of(changed(actor), "made")
            stage_run(scenario, 0, recording.times, type(cast)(cast.kinds, cast.sizes, tracks), CODE)


def test_a_recording_that_is_too_short_is_refused() -> None:
    recording = recording_of(made_inputs())
    with pytest.raises(InputError, match="needs more than the 30 frames"):
        stage_run(Scenario.of(changed(start_frame=29), "made"), 0, recording.times, cast_of(recording), CODE)


def test_a_run_is_its_index_and_nothing_else() -> None:
    recording, scenario = recording_of(made_inputs()), Scenario.of(SCENARIO, "made")
    runs = [stage_run(scenario, run, recording.times, cast_of(recording), CODE) for run in (4, 5, 4)]
    assert runs[0].draws == runs[2].draws != runs[1].draws
    assert all(np.array_equal(a.poses, b.poses) for a, b in zip(runs[0].actors, runs[2].actors))


def test_what_draws_nothing_says_so() -> None:
    fixed = {**SCENARIO["actors"][1], "is_target_actor": True}
    still = Scenario.of({"general": {"start_frame": 3, "duration": 7.0}, "actors": [fixed]}, "made")
    assert not still.draws and not Scenario().draws and Scenario.of(SCENARIO, "made").draws
