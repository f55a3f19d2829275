"""The loop: equal to a loop of ten lines, pure, and clear about what it cannot drive."""

from copy import deepcopy
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.contact import NeuroncapCar, find_contact
from benchmark.extensions.neuroncap.loop import (
    Engine,
    NeuroncapWorld,
    begin,
    compute_moments,
    finish_run,
    is_running,
    step,
)
from benchmark.extensions.neuroncap.plan_path import UnusablePlanError
from benchmark.extensions.neuroncap.score import score_impact, score_run
from benchmark.extensions.neuroncap.vehicle import Vehicle, drive_plan
from benchmark.geometry import Floats
from benchmark.records.neuroncap_aggregate import CODE, PAPER
from tests.benchmark.extensions.neuroncap.golden_neuroncap import plan_of
from tests.benchmark.extensions.neuroncap.made import (
    SECOND,
    constant,
    driven_by,
    engine,
    scenario_engine,
    standing,
    straight,
)


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


def test_six_identical_points_are_driven() -> None:
    made = engine(straight(np.full(20, 8.0)))
    near, far = driven_by(made, np.zeros((6, 2))), driven_by(made, np.tile([5.0, 0.0], (6, 1)))
    assert near.vehicle is not None and abs(near.vehicle.speed) < 0.2
    assert far.vehicle is not None and np.isfinite(far.vehicle.columns).all()


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
