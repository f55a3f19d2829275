"""Our own families: the recorded drive meets them, and a car that stops does not hit what stands."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.extensions.neuroncap.loop import Engine, NeuroncapWorld, begin, finish_run, is_running, step
from benchmark.extensions.neuroncap.recording import NeuroncapRecording, build_own_scenarios
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import RenderableActors, stage_run
from benchmark.geometry import Floats, to_local
from benchmark.records.neuroncap_aggregate import PAPER
from tests.benchmark.extensions.neuroncap.golden_neuroncap import made_inputs, recording_of
from tests.benchmark.extensions.neuroncap.made import KNOWN, straight


@pytest.fixture(scope="module")
def recording() -> NeuroncapRecording:
    return recording_of(made_inputs())


def recorded_plan(recording: NeuroncapRecording, world: NeuroncapWorld) -> Floats:
    path, seconds = recording.path, (recording.times - recording.times[0]) / 1e6
    asked = (world.state.time_us - int(recording.times[0])) / 1e6 + 0.5 * np.arange(1, 7)
    places = np.column_stack([np.interp(asked, seconds, path[:, axis]) for axis in range(2)])
    pose = world.state.pose
    return to_local(places, np.array([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])]))


def driven(recording: NeuroncapRecording, scenario: Scenario, run: int, *, stops: bool) -> NeuroncapWorld:
    stage = stage_run(scenario, run, recording.times, RenderableActors.of(recording.actors), PAPER)
    made = Engine.of(recording, stage, priming_steps=scenario.priming_steps, renderer_knows=KNOWN, switches=PAPER)
    world = begin(made)
    while is_running(made, world):
        world = step(made, world, np.zeros((6, 2)) if stops else recorded_plan(recording, world))
    return finish_run(made, world)


@pytest.mark.parametrize("family", ["stationary", "frontal", "side"])
def test_the_recorded_drive_meets_the_target(recording: NeuroncapRecording, family: str) -> None:
    scenario = build_own_scenarios(recording)[family]
    assert scenario.draws and [actor.is_target for actor in scenario.actors] == [True]
    worlds = [driven(recording, scenario, run, stops=False) for run in range(6)]
    hits = [world.contact for world in worlds if world.contact is not None]
    assert len(hits) >= 5 and all(hit.is_target for hit in hits)
    expected = int(recording.times[16])
    assert all(abs(hit.time_us - expected) < 1_800_000 for hit in hits)
    assert len({hit.time_us for hit in hits}) > 1


def test_who_stops_does_not_hit_what_stands(recording: NeuroncapRecording) -> None:
    scenario = build_own_scenarios(recording)["stationary"]
    assert all(driven(recording, scenario, run, stops=True).contact is None for run in range(6))


def test_a_recording_that_meets_nobody_has_none(recording: NeuroncapRecording) -> None:
    assert build_own_scenarios(straight(np.full(30, 0.5), recording.actors)) == {}
    assert build_own_scenarios(straight(np.full(12, 8.0), recording.actors)) == {}
    assert build_own_scenarios(replace(recording, actors=())) == {}
