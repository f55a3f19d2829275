"""The default engine: physics that are physics, the same bytes in any company, recordings reproduced."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.closed_loop.agent_policy import make_coasting_plan
from benchmark.closed_loop.plan_tracking import INSTANT_US, LIMITS, SUBSTEP_S, follow_waypoints
from benchmark.closed_loop.simulation_config import build_simulation_config, interpolate_recorded_poses
from benchmark.closed_loop.simulation_state import EpisodeMotion
from benchmark.closed_loop.stepping import InfeasiblePlanError, begin_simulation, is_running, step, step_together
from benchmark.closed_loop.track_replay import TrackReplay
from benchmark.closed_loop.world_state import STEP_US, SimulationConfig, compute_ego_boxes
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M, EGO_WHEELBASE_M
from benchmark.dynamics.lane_path import build_lane_path
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap, to_local, wrap_angle
from benchmark.interactions.contacts import KINDS, ContactKind
from benchmark.planning import Command
from benchmark.scene import Scene
from tests.benchmark.closed_loop.made import bend, course, driven, same, straight, town_scene
from tests.hand_made import Car, scene_on_straight_road

TOWN = range(3)


def distances(scene: Scene) -> Floats:
    """How far from the recording a planner drives that answers it from where the ego is, every 0.05 s."""
    made = build_simulation_config(scene)
    world, found = begin_simulation(made), []
    while is_running(made, replace(world, contact=None)):
        ahead = interpolate_recorded_poses(scene, world.time_us + STEP_US * np.arange(1, 7))
        world = step(made, world, to_local(ahead[:, :2], world.ego.pose))
        assert world.trace is not None
        times = world.time_us - STEP_US + INSTANT_US * np.arange(1, 11)
        found.append(np.hypot(*(world.trace.egos[1:, :2] - interpolate_recorded_poses(scene, times)[:, :2]).T))
    assert world.contact is None
    return np.concatenate(found)


@pytest.fixture(scope="module")
def town() -> list[Scene]:
    return [town_scene(index) for index in TOWN]


def test_a_planner_that_gives_the_recording_reproduces_it(town: list[Scene]) -> None:
    worst = [float(distances(scene).max()) for scene in town]
    assert np.median(worst) < 0.3 and max(worst) < 1.0


def test_the_start_has_the_recorded_motion(town: list[Scene]) -> None:
    for scene in town:
        made = build_simulation_config(scene, keyframe=4)
        around = interpolate_recorded_poses(scene, [made.start_us - 100_000, made.start_us + 100_000])
        assert made.start.speed == pytest.approx(np.hypot(*(around[1] - around[0])[:2]) / 0.2, abs=0.5)
        assert made.start.yaw_rate == pytest.approx((around[1] - around[0])[2] / 0.2, abs=0.1)


def test_a_planner_that_follows_its_lane_never_leaves_it(town: list[Scene]) -> None:
    for scene in town:
        made = build_simulation_config(scene, duration_s=20.0)
        world = begin_simulation(replace(made, start=replace(made.start, speed=7.0)))
        path = build_lane_path(scene.road_map, world.ego.pose, Command.STRAIGHT, 7.0, 180.0)
        assert path is not None
        while is_running(made, replace(world, contact=None)):
            along = path.project(world.ego.pose[:2])[0] + 3.5 * np.arange(1, 7)
            world = step(made, world, to_local(path.at(along), world.ego.pose))
            assert world.trace is not None
            assert np.abs(path.project(world.trace.egos[:, :2])[1]).max() < 0.35


def plain_loop(made: SimulationConfig, plan: Floats, steps: int) -> tuple[Floats, tuple[int, int] | None]:
    """What one would write down first: the ego after some steps, and when it touches whom."""
    replay, row, time, contact = made.policy, np.array([made.start.row]).T, made.start_us, None
    assert isinstance(replay, TrackReplay)
    ignored = begin_simulation(made).ignored
    for _ in range(steps):
        rows = follow_waypoints(row, plan[:, :, None])
        for instant in range(1, 11):
            now = time + INSTANT_US * instant
            at = (now - made.start_us) // INSTANT_US
            own = compute_ego_boxes(rows[instant, :, 0])
            hit = replay.present[at] & ~ignored & boxes_overlap(own[None], replay.boxes[at])
            contact = (now, int(hit.argmax())) if contact is None and hit.any() else contact
        row, time = rows[-1], time + STEP_US
    return row[:, 0], contact


def test_the_steps_are_those_of_a_plain_loop_to_the_last_bit(town: list[Scene]) -> None:
    crash = course(Car(92.0, 198.25, 20.0), Car(92.0, 194.75))
    found = []
    for made in (build_simulation_config(town[1]), build_simulation_config(town[2]), crash):
        plan = bend(9.0, -200.0)
        row, contact = plain_loop(made, plan, 12)
        world = driven(made, plan, 12)[-1]
        assert world.ego.row == tuple(row)
        assert (None if world.contact is None else (world.contact.time_us, world.contact.agent)) == contact
        found.append(contact)
    assert found[-1] is not None


def test_company_and_order_change_no_byte(town: list[Scene]) -> None:
    courses = [build_simulation_config(scene) for scene in town] * 2
    courses += [replace(made, latency_us=latency) for made, latency in zip(courses[:3], (100_000, 300_000, 700_000))]
    rng = np.random.default_rng(3)
    plans = [straight(speed) + rng.normal(0, 0.5, (6, 2)) for speed in rng.uniform(0, 12, len(courses))]
    alone = [driven(made, plan, 6)[-1] for made, plan in zip(courses, plans)]
    for order in (np.arange(len(courses)), rng.permutation(len(courses)), np.arange(len(courses))[::2]):
        worlds = [begin_simulation(courses[index]) for index in order]
        for _ in range(6):
            worlds = step_together([courses[i] for i in order], worlds, [plans[i] for i in order])
        assert all(same(world, alone[index]) for world, index in zip(worlds, order))


def test_a_step_changes_nothing_that_it_was_given() -> None:
    made, plan = course(Car(90.0, 198.25, 3.0)), straight(8.0)
    world = driven(made, plan, 2)[-1]
    before = deepcopy(world)
    first, second = step(made, world, plan), step(made, world, plan)
    assert same(first, second) and same(world, before) and np.array_equal(plan, straight(8.0))


def test_constant_speed_is_constant_speed_and_time_whole_microseconds() -> None:
    worlds = driven(course(), straight(8.0), 10)
    assert [world.step for world in worlds] == list(range(11))
    ego = worlds[-1].ego
    assert ego.x == pytest.approx(50.0 + 8.0 * 5.0, abs=1e-6) and ego.y == pytest.approx(198.25, abs=1e-9)
    assert ego.speed == pytest.approx(8.0, abs=1e-9)
    assert [world.time_us - course().start_us for world in worlds] == [500_000 * number for number in range(11)]
    assert all(isinstance(world.time_us, int) for world in worlds)


def test_a_motion_is_linear_between_instants_and_stands_still_before_and_after() -> None:
    ego, times = np.outer([0.0, 1.0], np.arange(1.0, 8.0)), np.array([0, 100_000])
    alone = np.zeros((0, 2, 3)), np.zeros((0, 2)), np.zeros((0, 2), np.bool_)
    motion = EpisodeMotion(times, ego, *alone, times[:1])
    for time_us, share in ((-50_000, 0.0), (0, 0.0), (50_000, 0.5), (100_000, 1.0), (150_000, 1.0)):
        expected = share * ego[1]
        expected[2] = share * wrap_angle(ego[1, 2])
        assert motion.at(time_us) == pytest.approx(expected)


def test_contact_is_seen_within_a_twentieth_of_a_second() -> None:
    made = course(Car(90.0, 198.25))
    world = driven(made, straight(8.0), 10)[-1]
    assert world.contact is not None
    begins = (90.0 - 2.3 - 50.0 - EGO_CENTER_FROM_REAR_AXLE_M - EGO_LENGTH_M / 2) / 8.0
    assert 0 <= (world.contact.time_us - made.start_us) / 1e6 - begins <= 0.05
    pair = world.contact.pair
    assert pair.impact_speed == pytest.approx([8.0]) and KINDS[pair.kinds[0]] == ContactKind.STOPPED_TRACK
    assert not is_running(made, world)


def test_a_plan_to_stop_brakes_as_hard_as_the_car_can_and_no_harder() -> None:
    worlds = driven(course(ego_speed=15.0), np.zeros((6, 2)), 8)
    assert worlds[-1].ego.speed == 0.0 and worlds[-1].ego == worlds[-2].ego
    # 15^2 / (2 8) and what the brakes need to build up.
    assert 14.0 < worlds[-1].ego.x - 50.0 < 21.0
    # Whom the ego overlaps at the start never counts as hit.
    assert driven(course(Car(51.0, 198.25, 8.0)), straight(8.0), 6)[-1].contact is None


def test_a_car_does_not_drive_backwards_or_turn_on_the_spot() -> None:
    for plan in (-straight(3.0), np.column_stack([np.zeros(6), np.arange(1.0, 7.0)]), np.tile([5.0, 0.0], (6, 1))):
        for world in driven(course(ego_speed=2.0), plan, 6):
            assert world.ego.speed >= 0.0 and np.isfinite(world.ego.row).all()
            if world.trace is not None:
                turned = np.abs(np.diff(world.trace.egos[:, 2]))
                assert (turned <= world.trace.egos[1:, 3].max() * 0.05 * np.tan(0.6) / EGO_WHEELBASE_M + 1e-12).all()


@settings(max_examples=20, deadline=None)
@given(
    speed=st.floats(0, 30),
    steering=st.floats(-0.5, 0.5),
    waypoints=st.lists(st.floats(-100, 100), min_size=12, max_size=12),
)
def test_any_plan_stays_within_the_limits_of_the_car(speed: float, steering: float, waypoints: list[float]) -> None:
    egos = np.array([[0.0], [0.0], [0.3], [speed], [0.0], [steering]])
    rows = follow_waypoints(egos, np.array(waypoints).reshape(6, 2, 1))[:, :, 0]
    assert np.isfinite(rows).all() and (rows[:, 3] >= 0).all()
    assert (rows[:, 4] <= LIMITS.acceleration_m_s2 + 1e-9).all() and (rows[:, 4] >= -LIMITS.braking_m_s2 - 1e-9).all()
    assert (np.abs(rows[:, 5]) <= LIMITS.steering_rad + 1e-12).all()
    # While they turn the wheels; a car that begins beyond its grip may only turn them back.
    turned = np.abs(np.diff(rows[::2, 5]))
    assert (turned[1:] <= LIMITS.steering_rate_rad_s * SUBSTEP_S + 1e-9).all()


def test_a_bend_is_driven_and_held_beyond_the_end_of_the_plan() -> None:
    turning = replace(course().start, steering=float(np.arctan(EGO_WHEELBASE_M / 40)))
    made, centre = replace(course(ego_speed=8.0), start=turning), np.array([50.0, 198.25 + 40.0])
    # With a latency of 4 s all that is driven, after 4 s of coasting, is what lies beyond the end of a plan of 3 s.
    for latency_us in (0, 4_000_000, 4_200_000):
        world = driven(replace(made, latency_us=latency_us), bend(8.0, 40.0), 16)[-1]
        assert world.ego.speed == pytest.approx(8.0, abs=0.05)
        assert np.hypot(*(world.ego.pose[:2] - centre)) == pytest.approx(40.0, abs=0.2)


@pytest.mark.parametrize("latency_us", [0, 100_000, 300_000, 500_000, 800_000, 1_500_000])
def test_a_plan_takes_effect_so_much_later(latency_us: int) -> None:
    made = course(ego_speed=10.0, latency_us=latency_us)
    worlds = driven(made, np.zeros((6, 2)), 8)
    speeds = np.concatenate([world.trace.egos[1:, 3] for world in worlds if world.trace is not None])
    slower = np.flatnonzero(speeds < 10.0 - 1e-6)
    # The first instant after the first sub-step in which the brakes are on.
    assert slower[0] * INSTANT_US == latency_us


def test_a_latency_that_does_not_divide_and_a_course_without_time_are_refused() -> None:
    for latency_us in (-100_000, 50_000, 333_333):
        with pytest.raises(InputError, match="is not a multiple of the 100 ms"):
            course(latency_us=latency_us)
    scene = scene_on_straight_road()
    with pytest.raises(InputError, match="ends when it starts"):
        build_simulation_config(scene, keyframe=len(scene.keyframes) - 1)
    with pytest.raises(InputError, match="no keyframe number 99"):
        build_simulation_config(scene, keyframe=99)


UNUSABLE: list[Any] = [
    *(np.full((6, 2), number) for number in (np.nan, np.inf, 1e5)),
    *(np.zeros(shape) for shape in ((5, 2), (17, 2), 12)),
    *("no", None),
]


def test_a_plan_that_cannot_be_driven_is_a_failure() -> None:
    made = course()
    for plan in UNUSABLE:
        with pytest.raises(InfeasiblePlanError, match="scene-9901"):
            step(made, begin_simulation(made), plan)


def test_coasting_keeps_speed_and_curvature() -> None:
    made = course()
    turning = replace(made.start, steering=0.1)
    radius = EGO_WHEELBASE_M / np.tan(0.1)
    plan = make_coasting_plan(turning, 0)
    assert np.hypot(plan.waypoints[:, 0], plan.waypoints[:, 1] - radius) == pytest.approx(np.full(6, radius))
    assert make_coasting_plan(made.start, 0).waypoints == pytest.approx(straight(made.start.speed))
