"""Every switch does what it says; the loop is that of ten lines, pure, and clear about what it cannot drive."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.contact import EgoMoment, NeuroncapCar, NeuroncapContact, find_contact
from benchmark.extensions.neuroncap.loop import (
    Engine,
    NeuroncapEgoState,
    NeuroncapWorld,
    begin,
    compute_command,
    compute_future_moments,
    compute_moments,
    finish_run,
    is_running,
    step,
)
from benchmark.extensions.neuroncap.plan_path import UnusablePlanError
from benchmark.extensions.neuroncap.recording import build_actors
from benchmark.extensions.neuroncap.scenarios import Scenario
from benchmark.extensions.neuroncap.score import compute_reference_speed, score_impact, score_run
from benchmark.extensions.neuroncap.staging import StagedRun, stage_run
from benchmark.extensions.neuroncap.vehicle import Vehicle, drive_plan
from benchmark.geometry import Floats
from benchmark.planning import Command
from benchmark.records.neuroncap_aggregate import CODE, PAPER, NeuroncapSwitches, aggregate_runs
from tests.benchmark.extensions.neuroncap.golden_neuroncap import (
    SCENARIO,
    annotations_of,
    cast_of,
    made_inputs,
    plan_of,
    recording_of,
)
from tests.benchmark.extensions.neuroncap.made import (
    SECOND,
    constant,
    driven_by,
    engine,
    pose,
    scenario_engine,
    standing,
    straight,
)


def staged_run(switches: NeuroncapSwitches, run: int, **general: Any) -> StagedRun:
    recording = recording_of(made_inputs())
    scenario = Scenario.of({**SCENARIO, "general": {**SCENARIO["general"], **general}}, "made")
    return stage_run(scenario, run, recording.times, cast_of(recording), switches)


def vehicle(switches: NeuroncapSwitches, *, speed: float = 8.0, steering: float = 0.0) -> Vehicle:
    row = np.zeros(16, np.float32)
    row[13] = speed
    return Vehicle.start(pose(1200.0, 600.0, 0.3), row, 16 * steering, switches)


def state_at(x: float, time_us: int = 0, *, driven: bool = True, **signals: float) -> NeuroncapEgoState:
    row = np.zeros(16, np.float32)
    for place, value in signals.items():
        row[int(place.removeprefix("row_"))] = value
    return NeuroncapEgoState(time_us, pose(x), row, driven)


def touched(actor: Actor, switches: NeuroncapSwitches) -> bool:
    return find_contact(EgoMoment(0, pose(0.0), 1.0), [actor], NeuroncapCar.of(switches), switches) is not None


def last_place(switches: NeuroncapSwitches) -> tuple[float, int]:
    end = compute_future_moments(0, pose(0.0), constant(8.0), switches)[-1]
    return float(end.pose[0, 3]), end.time_us


def acceleration_said(switches: NeuroncapSwitches) -> list[float]:
    car = replace(vehicle(CODE), acceleration=1.0, yaw_rate=0.5, yaw_acceleration=0.2)
    return [float(value) for value in car.canbus(NeuroncapCar.of(switches), switches)[7:9]]


def car_sizes(car: NeuroncapCar) -> tuple[float, float, float]:
    return car.wheelbase_m, car.centre_ahead_m, car.width_m


SLOWING = straight(np.array([8.0] * 12 + [4.0] * 12 + [1.0, 1.0]))
DENSE = straight(np.full(20, 8.0), interval_us=SECOND // 4)
CONTACT = NeuroncapContact(0, "other", 0, 0.1, np.array([3.0, 0.0, 0.0]), np.array([0.0, 0.0, 4.0]), True)
RUNS = {"side": {"0001": {"run_0": {"ncap_score": 1.23456}, "run_1": {"ncap_score": 1.23456}}}}
VALUES: dict[str, tuple[Callable[[NeuroncapSwitches], Any], Any, Any]] = {
    "reference_speed": (lambda each: compute_reference_speed(SLOWING, 0, None, each), 1.0, 8.0),
    "reference_dt": (lambda each: compute_reference_speed(DENSE, 0, None, each), 8.0, 16.0),
    "box_centre": (lambda each: NeuroncapCar.of(each).box_ahead_m, 0.5, 1.39),
    "ego_length": (lambda each: NeuroncapCar.of(each).length_m, 4.018, 4.084),
    "contact_prefilter": (lambda each: touched(standing(2.0, z=30.0), each), False, True),
    "impact_speed_of_ego": (lambda each: state_at(0.0, row_13=-3.0, row_14=4.0).moment(each).speed, 5.0, -3.0),
    "impact_norm": (lambda each: CONTACT.impact_speed(each), 5.0, 3.0),
    "first_gap": (
        lambda each: len(compute_moments(state_at(0.0, driven=False), state_at(4.0, SECOND // 2), each)), 1, 10,
    ),
    "start_jitter_stream": (lambda each: [d[0] for d in staged_run(each, 0).draws].count("default_rng"), 2, 1),
    "vehicle": (lambda each: car_sizes(NeuroncapCar.of(each)), (3.089, 1.461, 1.85), (2.588, 1.39, 1.85)),
    "can_acceleration": (acceleration_said, [1.0 + 1.461 * 0.45, 0.0], [1.0 - 1.461 * 0.25, 1.461 * 0.2]),
    "plan_3s": (last_place, (20.0, 3 * SECOND), (24.0, 3 * SECOND)),
    "rounding": (lambda each: aggregate_runs(RUNS, each).overall["ncap_score"], 1.235, 1.23456),
}  # fmt: skip
"""What is read, by the code and by the paper."""


def check_last_state(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    recording = straight(np.full(20, 8.0), (standing(40.0 + 2.25 + 2.5),))
    worlds = [driven_by(engine(recording, each), constant(8.0)) for each in (code, paper)]
    assert worlds[0].contact is None and worlds[1].contact is not None
    assert [world.checked for world in worlds] == [10, 11]


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


def check_acceleration_clip(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    plan = np.column_stack([20.0 * np.arange(1, 7), 3.0 * np.arange(1, 7)])
    steps = [drive_plan(vehicle(each), plan, 0, NeuroncapCar.of(each), each) for each in (code, paper)]
    assert steps[0].commands[0, 0] == steps[1].commands[0, 0] == 6.0
    assert steps[0].unlimited[0, 0] > 6.0 == steps[1].unlimited[0, 0]
    assert steps[0].commands[0, 1] != steps[1].commands[0, 1]


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
    assert [touched(standing(3.0, kind="construction"), each) for each in (code, paper)] == [False, True]
    categories = ["vehicle.construction", "vehicle.emergency.police", "vehicle.car", "animal"]
    inputs = made_inputs() | {"instance_category": np.array(categories)}
    recording = recording_of(inputs)
    assert [actor.kind for actor in recording.actors] == ["car"]
    kept = build_actors(annotations_of(inputs), recording.times, paper)
    assert [actor.kind for actor in kept] == ["construction", "emergency", "car"]


def check_dims_jitter(code: NeuroncapSwitches, paper: NeuroncapSwitches) -> None:
    size = cast_of(recording_of(made_inputs())).sizes["made-2"]
    for each, same in ((code, False), (paper, True)):
        run = staged_run(each, 0, dim_jitter=0.2)
        actor = next(actor for actor in run.actors if actor.uuid == "made-2")
        assert run.dim_scale is not None and run.dim_scale != 1.0
        assert actor.size == pytest.approx(size * run.dim_scale, rel=1e-6)
        assert np.array_equal(run.sizes["made-2"], size) is same


CHECKS = {name.removeprefix("check_"): check for name, check in list(globals().items()) if name.startswith("check_")}


@pytest.mark.parametrize("name", [field.name for field in fields(NeuroncapSwitches)])
def test_a_switch_does_what_it_says(name: str) -> None:
    changed: dict[str, Any] = {name: "paper"}
    paper = replace(CODE, **changed)
    if name in VALUES:
        read, by_code, by_paper = VALUES[name]
        assert read(CODE) == pytest.approx(by_code) and read(paper) == pytest.approx(by_paper)
    else:
        CHECKS[name](CODE, paper)


def test_switches_have_names_that_lead_back_to_them() -> None:
    # The specification has 24.
    assert len(fields(NeuroncapSwitches)) == len(CHECKS) + len(VALUES) == 24
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


def reference_loop(made: Engine, model: str) -> tuple[list[Floats], int, Any]:
    """The same, as one would write it down first: poses, states checked, contact."""
    states, car, contact, checked, vehicle, switches = [made.frame(made.start_frame)], made.car, None, 0, None, CODE
    while contact is None and states[-1].time_us < made.end_us:
        now, plan = states[-1], plan_of(model, NeuroncapWorld(0, states[-1]))
        if len(states) > 1:
            contact, checked = first_contact(made, states[:-1]), checked + 1
        if contact is None and len(states) <= made.priming_steps:
            states.append(made.frame(made.start_frame + len(states)))
        elif contact is None:
            wheel = float(made.recording.steering_wheel[made.priming_steps])
            vehicle = vehicle or Vehicle.start(now.pose, now.canbus, wheel, switches)
            vehicle = drive_plan(vehicle, plan, now.time_us, car, switches).vehicle
            row = vehicle.canbus(car, switches)
            states.append(replace(now, time_us=now.time_us + 500_000, pose=vehicle.pose, canbus=row, is_driven=True))
    if contact is None:
        contact, checked = first_contact(made, states[:-1]), checked + 1
    return [state.pose for state in states], checked, contact


def first_contact(made: Engine, states: list[Any]) -> Any:
    instants = compute_moments(states[-2] if len(states) > 1 else None, states[-1], CODE)
    found = (find_contact(each, made.actors, made.car, CODE) for each in instants)
    return next((contact for contact in found if contact is not None), None)


def poses_and_end(made: Engine, model: str) -> tuple[list[Floats], NeuroncapWorld]:
    world, poses = begin(made), [begin(made).state.pose]
    while is_running(made, world):
        assert isinstance(world.state.time_us, int)
        world = step(made, world, plan_of(model, world))
        if world.contact is None:
            poses.append(world.state.pose)
    return poses, finish_run(made, world)


@pytest.mark.parametrize(("model", "run"), [("cv", 0), ("bend", 1), ("brake", 2), ("bend", 3)])
def test_the_steps_are_those_of_a_plain_loop_to_the_last_bit(model: str, run: int) -> None:
    made = scenario_engine(run)
    poses, world = poses_and_end(made, model)
    assert world.contact is not None or world.state.time_us >= made.end_us
    expected, checked, contact = reference_loop(made, model)
    assert len(poses) == len(expected) and all(np.array_equal(*pair) for pair in zip(poses, expected))
    assert world.checked == checked
    assert (world.contact is None) == (contact is None)
    if contact is not None and world.contact is not None:
        assert (world.contact.uuid, world.contact.time_us) == (contact.uuid, contact.time_us)


def test_a_step_changes_nothing_that_it_was_given_and_hides_no_state() -> None:
    made, plan = scenario_engine(1), constant(8.0)
    world = begin(made)
    for _ in range(3):
        world = step(made, world, plan)
    before = deepcopy(world)
    first, second = step(made, world, plan), step(made, world, plan)
    assert np.array_equal(world.state.pose, before.state.pose) and world.vehicle == before.vehicle
    assert np.array_equal(first.state.pose, second.state.pose) and first.vehicle == second.vehicle
    assert np.array_equal(plan, constant(8.0))
    assert all(field.name in NeuroncapWorld.__slots__ for field in fields(NeuroncapWorld))
    with pytest.raises(AttributeError):
        world.step = 3  # type: ignore[misc]


@pytest.mark.parametrize(
    "plan",
    [
        *(np.full((6, 2), value) for value in (np.nan, np.inf, 1e300)),
        np.zeros((7, 2)),
        np.zeros((0, 2)),
        np.zeros(6),
        "no",
    ],
)
def test_a_plan_that_cannot_be_driven_is_a_failure(plan: Any) -> None:
    made = scenario_engine(0)
    with pytest.raises(UnusablePlanError):
        step(made, begin(made), plan)


def test_an_actor_in_the_way_is_hit_when_the_boxes_meet() -> None:
    made = engine(straight(np.full(20, 8.0), (standing(30.0),)))
    world = driven_by(made, constant(8.0))
    assert world.contact is not None
    # Rear axle at the first instant at which 0.5 + 4.018 / 2 ahead of it reaches 30 - 4.5 / 2.
    reached = (30.0 - 2.25 - 0.5 - 2.009) / 8.0
    assert 0 <= world.contact.time_us / SECOND - reached < 0.051
    score = score_run(made, world)
    assert score.impact_speed == pytest.approx(8.0) and score.reference_speed == pytest.approx(8.0)
    assert score.score == pytest.approx(0.0, abs=1e-5)
    assert score.metrics["avg_collide@0.0s"] == 1 / world.checked


def test_no_contact_is_five_and_nothing_of_nothing_is_unknown() -> None:
    made = engine(straight(np.full(20, 8.0)))
    assert score_run(made, driven_by(made, constant(8.0))).score == 5.0
    assert score_impact(4.0, 8.0) == 2.0 and score_impact(9.0, 8.0) == 0.0 and score_impact(1.0, 0.0) == 0.0
    assert np.isnan(score_impact(0.0, 0.0))


def test_a_recording_that_ends_too_early_is_not_scored_as_code() -> None:
    short = straight(np.full(9, 8.0))
    made = engine(short, duration=3.0, start_frame=1)
    with pytest.raises(InputError, match="neuroncap@paper"):
        score_run(made, driven_by(made, constant(8.0)))
    paper = replace(made, switches=PAPER, car=NeuroncapCar.of(PAPER))
    assert score_run(paper, driven_by(paper, constant(8.0))).score == 5.0
