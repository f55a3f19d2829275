"""Small recordings and engines of one line."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.loop import Engine, NeuroncapWorld, begin, finish_run, is_running, step
from benchmark.extensions.neuroncap.recording import NeuroncapRecording
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.staging import stage_run
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.records.neuroncap_aggregate import CODE, NeuroncapSwitches
from tests.benchmark.extensions.neuroncap.golden_neuroncap import SCENARIO, cast_of, made_inputs, recording_of

SECOND = 1_000_000
KNOWN = frozenset(("made-0", "made-1", "made-2"))


def pose(x: float, y: float = 0.0, yaw: float = 0.0, z: float = 0.0) -> Floats:
    return transform_matrix(quaternion_from_yaw(np.array(yaw)), [x, y, z])


def standing(x: float, y: float = 0.0, *, kind: str = "car", z: float = 0.0, seconds: float = 60.0) -> Actor:
    times = np.arange(0, int(seconds * SECOND) + 1, SECOND // 2)
    return Actor("other", kind, np.array([1.8, 4.5, 1.5]), times, np.tile(pose(x, y, 0.0, z), (len(times), 1, 1)), True)


def straight(speeds: Floats, actors: tuple[Actor, ...] = (), interval_us: int = SECOND // 2) -> NeuroncapRecording:
    """A recording that drives along x with a speed for each frame."""
    times = interval_us * np.arange(len(speeds))
    x = np.concatenate([[0.0], np.cumsum(speeds[:-1]) * 0.5])
    canbus = np.zeros((len(speeds), 16), np.float32)
    canbus[:, 0], canbus[:, 3], canbus[:, 13] = x, 1.0, speeds
    poses = np.array([pose(each) for each in x])
    return NeuroncapRecording(times, poses, canbus, np.zeros(len(speeds), np.float32), actors)


def engine(
    recording: NeuroncapRecording, switches: NeuroncapSwitches = CODE, *, duration: float = 5.0, **changes: Any
) -> Engine:
    """A run from the first frame with the recording's own actors."""
    stage = stage_run(Scenario(duration_s=duration), 0, recording.times, cast_of(recording), switches)
    made = Engine.of(recording, stage, priming_steps=1, renderer_knows=frozenset(), switches=switches)
    return replace(made, **changes)


def scenario_engine(run: int, switches: NeuroncapSwitches = CODE, *, futures: bool = False) -> Engine:
    """A run of the made-up scenario."""
    recording, scenario = recording_of(made_inputs()), Scenario.of(SCENARIO, "made")
    stage = stage_run(scenario, run, recording.times, cast_of(recording), switches)
    given: dict[str, Any] = {"renderer_knows": KNOWN, "switches": switches, "check_futures": futures}
    return Engine.of(recording, stage, priming_steps=scenario.priming_steps, **given)


def constant(speed: float) -> Floats:
    """A plan straight on."""
    return np.column_stack([0.5 * speed * np.arange(1, PLAN_STEPS + 1), np.zeros(PLAN_STEPS)])


def driven_by(made: Engine, plan: Floats) -> NeuroncapWorld:
    world = begin(made)
    while is_running(made, world):
        world = step(made, world, plan)
    return finish_run(made, world)
