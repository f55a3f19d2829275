"""Every switch does what it says, and the presets are named."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.contact import EgoMoment, NeuroncapCar, NeuroncapContact, find_contact
from benchmark.extensions.neuroncap.loop import (
    NeuroncapEgoState,
    begin,
    compute_command,
    compute_future_moments,
    compute_moments,
    step,
)
from benchmark.extensions.neuroncap.recording import build_actors
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.score import compute_reference_speed
from benchmark.extensions.neuroncap.staging import StagedRun, stage_run
from benchmark.extensions.neuroncap.vehicle import Vehicle, drive_plan
from benchmark.planning import Command
from benchmark.records.neuroncap_aggregate import CODE, PAPER, NeuroncapSwitches, aggregate_runs
from tests.benchmark.extensions.neuroncap.golden_neuroncap import (
    SCENARIO,
    annotations_of,
    cast_of,
    made_inputs,
    recording_of,
)
from tests.benchmark.extensions.neuroncap.made import (
    SECOND,
    constant,
    driven_by,
    engine,
    pose,
    standing,
    straight,
)

SLOWING = np.array([8.0] * 12 + [4.0] * 12 + [1.0, 1.0])


def both(switch: str) -> tuple[NeuroncapSwitches, NeuroncapSwitches]:
    changed: dict[str, Any] = {switch: "paper"}
    return CODE, replace(CODE, **changed)


def staged_run(switches: NeuroncapSwitches, run: int, **general: Any) -> StagedRun:
    recording = recording_of(made_inputs())
    scenario = Scenario.of({**SCENARIO, "general": {**SCENARIO["general"], **general}}, "made")
    return stage_run(scenario, run, recording.times, cast_of(recording), switches)


def vehicle(switches: NeuroncapSwitches, *, speed: float = 8.0, steering: float = 0.0) -> Vehicle:
    row = np.zeros(16, np.float32)
    row[13] = speed
    return Vehicle.start(pose(1200.0, 600.0, 0.3), row, 16 * steering, switches)


def check_reference_speed(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    recording = straight(SLOWING)
    assert [compute_reference_speed(recording, 0, None, each) for each in (code, paper)] == pytest.approx([1.0, 8.0])


def check_reference_dt(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    recording = straight(np.full(20, 8.0), interval_us=SECOND // 4)
    assert [compute_reference_speed(recording, 0, None, each) for each in (code, paper)] == pytest.approx([8.0, 16.0])


def check_box_centre(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    assert [NeuroncapCar.of(each).box_ahead_m for each in (code, paper)] == [0.5, 1.39]


def check_ego_length(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    assert [NeuroncapCar.of(each).length_m for each in (code, paper)] == [float(np.float32(4.018)), 4.084]
    assert NeuroncapCar.of(paper).width_m == 1.85


def check_contact_prefilter(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    above = standing(2.0, z=30.0)
    found = [find_contact(EgoMoment(0, pose(0.0), 1.0), [above], NeuroncapCar.of(each), each) for each in (code, paper)]
    assert found[0] is None and found[1] is not None


def check_impact_speed_of_ego(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    row = np.zeros(16, np.float32)
    row[13], row[14] = -3.0, 4.0
    state = NeuroncapEgoState(0, pose(0.0), row, True)
    assert [state.moment(each).speed for each in (code, paper)] == [5.0, -3.0]


def check_impact_norm(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    contact = NeuroncapContact(0, "other", 0, 0.1, np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, 4.0]), True)
    assert [contact.impact_speed(each) for each in (code, paper)] == [5.0, 3.0]


def check_last_state(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    recording = straight(np.full(20, 8.0), (standing(40.0 + 2.25 + 2.5),))
    worlds = [driven_by(engine(recording, each), constant(8.0)) for each in (code, paper)]
    assert worlds[0].contact is None and worlds[1].contact is not None
    assert [world.checked for world in worlds] == [10, 11]


def check_first_gap(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    row = np.zeros(16, np.float32)
    before, state = NeuroncapEgoState(0, pose(0.0), row, False), NeuroncapEgoState(SECOND // 2, pose(4.0), row, True)
    assert [len(compute_moments(before, state, each)) for each in (code, paper)] == [1, 10]


def check_time_step_of_actors(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    steps = [set(np.diff(staged_run(each, 0).actors[0].times).tolist()) for each in (code, paper)]
    assert steps[0] == {538461, 538462} and steps[1] == {500_000}


def check_actor_window(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    run = next(run for run in range(20) if staged_run(code, run).start_frame == 2)
    times = recording_of(made_inputs()).times
    first = [int(staged_run(each, run).actors[0].times[0]) for each in (code, paper)]
    assert first == [int(times[3]), int(times[2])]


def check_jitter_times(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    target = {**SCENARIO["actors"][0], "positions": [[300.0, 100.0, 0.0], [400.0, 100.0, 0.0]]}
    target["jitter"] = {**target["jitter"], "times": [0.0, 5.0]}
    facts = {"general": SCENARIO["general"], "actors": [target]}
    recording = recording_of(made_inputs())
    runs = [
        stage_run(Scenario.of(facts, "made"), 1, recording.times, cast_of(recording), each) for each in (code, paper)
    ]
    assert runs[1].draws[: len(runs[0].draws)] == runs[0].draws and len(runs[1].draws) == len(runs[0].draws) + 1
    speeds = [np.linalg.norm(np.diff(run.actors[0].poses[:2, :2, 3], axis=0)) for run in runs]
    shifted = runs[1].draws[-1][-1]
    assert speeds[1] / speeds[0] == pytest.approx(20.0 / (20.0 + shifted), rel=1e-9)


def check_start_jitter_stream(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    names = [[draw[0] for draw in staged_run(each, 0).draws] for each in (code, paper)]
    assert [each.count("default_rng") for each in names] == [2, 1]


def check_steering_index(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    recording = replace(straight(np.full(20, 8.0)), steering_wheel=np.arange(20, dtype=np.float32))
    for each, frame in ((code, 1), (paper, 4)):
        made = engine(recording, each, start_frame=3)
        world = begin(made)
        for _ in range(2):
            world = step(made, world, np.zeros((6, 2)))
        assert world.vehicle is not None and world.vehicle.steering == pytest.approx(frame / 16)


def check_reinsertion(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    plan = np.column_stack([4.0 * np.arange(1, 7), 0.1 * np.arange(1, 7) ** 2])
    ends = [drive_plan(vehicle(each), plan, 0, NeuroncapCar.of(each), each).states for each in (code, paper)]
    # The first sub-step is the same; then the one that is put back starts the whole turn anew.
    assert ends[0][0] == pytest.approx(ends[1][0])
    assert abs(ends[0][-1][2] - ends[1][-1][2]) > 1e-4


def check_vehicle(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    assert [NeuroncapCar.of(each).wheelbase_m for each in (code, paper)] == [3.089, 2.588]
    assert [NeuroncapCar.of(each).centre_ahead_m for each in (code, paper)] == [1.461, 1.39]


def check_acceleration_clip(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    plan = np.column_stack([20.0 * np.arange(1, 7), 3.0 * np.arange(1, 7)])
    steps = [drive_plan(vehicle(each), plan, 0, NeuroncapCar.of(each), each) for each in (code, paper)]
    assert steps[0].commands[0, 0] == steps[1].commands[0, 0] == 6.0
    assert steps[0].unlimited[0, 0] > 6.0 == steps[1].unlimited[0, 0]
    assert steps[0].commands[0, 1] != steps[1].commands[0, 1]


def check_can_acceleration(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    car = replace(vehicle(code), acceleration=1.0, yaw_rate=0.5, yaw_acceleration=0.2)
    rows = [car.canbus(NeuroncapCar.of(each), each)[7:9].tolist() for each in (code, paper)]
    assert rows[0] == pytest.approx([1.0 + 1.461 * 0.45, 0.0])
    assert rows[1] == pytest.approx([1.0 - 1.461 * 0.25, 1.461 * 0.2])


def check_float32(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    ends = [drive_plan(vehicle(each), constant(8.0), 0, NeuroncapCar.of(each), each).vehicle for each in (code, paper)]
    difference = np.hypot(ends[0].x - ends[1].x, ends[0].y - ends[1].y)
    assert 0 < difference < 2e-4


def check_command_extension(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    # The recording comes to rest; the car has gone beyond its end and looks to the right.
    path = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    found = [compute_command(pose(30.0, -1.0, -0.5), 5.0, path, each) for each in (code, paper)]
    assert found == [Command.STRAIGHT, Command.LEFT]
    recording = straight(np.full(5, 2.0))
    assert {compute_command(recording.poses[4], 2.0, recording.path, each) for each in (code, paper)} == {
        Command.STRAIGHT
    }


def check_classes(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    digger = standing(3.0, kind="construction")
    found = [
        find_contact(EgoMoment(0, pose(0.0), 1.0), [digger], NeuroncapCar.of(each), each) for each in (code, paper)
    ]
    assert found[0] is None and found[1] is not None
    inputs = made_inputs()
    inputs["instance_category"] = np.array(
        ["vehicle.construction", "vehicle.emergency.police", "vehicle.car", "animal"]
    )
    recording = recording_of(inputs)
    assert [actor.kind for actor in recording.actors] == ["car"]
    kept = build_actors(annotations_of(inputs), recording.times, paper)
    assert [actor.kind for actor in kept] == ["construction", "emergency", "car"]


def check_plan_3s(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    ends = [compute_future_moments(0, pose(0.0), constant(8.0), each)[-1] for each in (code, paper)]
    assert [end.pose[0, 3] for end in ends] == [20.0, 24.0] and {end.time_us for end in ends} == {3 * SECOND}


def check_dims_jitter(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    size = cast_of(recording_of(made_inputs())).sizes["made-2"]
    for each, same in ((code, False), (paper, True)):
        run = staged_run(each, 0, dim_jitter=0.2)
        actor = next(actor for actor in run.actors if actor.uuid == "made-2")
        assert run.dim_scale is not None and run.dim_scale != 1.0
        assert actor.size == pytest.approx(size * run.dim_scale, rel=1e-6)
        assert np.array_equal(run.sizes["made-2"], size) is same


def check_rounding(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    runs = {"side": {"0001": {"run_0": {"ncap_score": 1.23456}, "run_1": {"ncap_score": 1.23456}}}}
    assert [aggregate_runs(runs, each).overall["ncap_score"] for each in (code, paper)] == [1.235, 1.23456]


CHECKS: dict[str, Callable[[NeuroncapSwitches, NeuroncapSwitches], None]] = {
    name.removeprefix("check_"): check for name, check in list(globals().items()) if name.startswith("check_")
}


@pytest.mark.parametrize("field", fields(NeuroncapSwitches), ids=lambda field: field.name)
def test_a_switch_does_what_it_says(field: Any) -> None:
    CHECKS[field.name](*both(field.name))


def test_there_are_the_24_switches_of_the_specification() -> None:
    assert len(fields(NeuroncapSwitches)) == len(CHECKS) == 24


def test_switches_have_names_that_lead_back_to_them() -> None:
    assert (CODE.name, PAPER.name) == ("neuroncap@code", "neuroncap@paper")
    mixed = replace(CODE, vehicle="paper", rounding="paper")
    assert mixed.name == "neuroncap@code+vehicle=paper+rounding=paper"
    assert NeuroncapSwitches.named(mixed.name) == mixed
    assert NeuroncapSwitches.named(replace(PAPER, float32="code").name) == replace(PAPER, float32="code")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("neuroncap", "use neuroncap@code or neuroncap@paper"),
        ("neuroncap@cod", "not an engine"),
        ("neuroncap@code+vehicel=paper", "did you mean vehicle"),
        ("neuroncap@code+vehicle=zoe", "must be code or paper"),
        ("neuroncap@code+vehicle", "must be code or paper"),
    ],
)
def test_a_wrong_name_is_refused(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        NeuroncapSwitches.named(name)
