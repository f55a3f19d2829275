from dataclasses import replace

import numpy as np

from benchmark.dynamics.bicycle import DriverLimits
from benchmark.scene import Scene
from generation.search.candidates import (
    ExclusionReason,
    compute_eligibility,
    draw_candidates,
    find_exclusion_reason,
    find_launch_frame,
)
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_motion import compute_initial_state, is_driving_forward
from tests.generation.search.one_vehicle import choose
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters()
NEAR = Car(62.0, 194.75, 8.0)


def scene_of(*cars: Car, seconds: float = 12.0) -> Scene:
    return scene_on_straight_road(cars, seconds=seconds)


def test_parked_ones_are_chosen_on_request_and_nobody_from_nobody() -> None:
    scene = scene_of(NEAR, Car(75.0, 205.25, 0.0), Car(38.0, 201.75, 8.0, category="vehicle.truck"))
    assert choose(scene, HYPER, 0) == (0, 2)
    assert choose(scene, HyperParameters(parked=True), 0) == (0, 1, 2)
    assert choose(scene_of(), HYPER, 0) == draw_candidates(scene_of(), [], HYPER, 0) == ()


def test_at_most_ten_are_drawn_and_the_seed_decides_which() -> None:
    cars = [Car(30.0 + 5.0 * row, y, 8.0) for row in range(8) for y in (194.75, 201.75)]
    scene = scene_of(*cars)
    drawn = {choose(scene, HYPER, seed) for seed in range(5)}
    assert all(len(choice) == 10 and choice == tuple(sorted(choice)) for choice in drawn)
    assert len(drawn) > 1
    assert choose(scene, HYPER, 3) == choose(scene, HYPER, 3)


def test_vehicles_that_stay_near_the_ego_are_preferred() -> None:
    going_along = [Car(30.0 + 8.0 * row, 194.75, 8.0) for row in range(5)]
    oncoming = [Car(80.0 + 8.0 * row, y, 9.0, np.pi) for row in range(8) for y in (201.75, 205.25)]
    scene = scene_of(*going_along, *oncoming)
    along = set(range(len(going_along)))

    def met(preference: float) -> int:
        hyper = HyperParameters(staying_preference=preference)
        return sum(len(along & set(choose(scene, hyper, seed))) for seed in range(20))

    assert met(2.0) > 1.2 * met(0.0)


def test_launch_waits_for_history_and_for_the_distance() -> None:
    assert find_launch_frame(scene_of(NEAR), 0, HYPER) == HYPER.history_frames
    approaching = scene_of(Car(130.0, 201.75, 8.0, np.pi))
    frame = find_launch_frame(approaching, 0, HYPER)
    assert frame is not None
    gap = np.linalg.norm(approaching.agents.position[0, :, :2] - approaching.ego.boxes[:, :2], axis=1)
    assert gap[frame] < HYPER.launch_distance_m <= gap[frame - 1]


def test_launch_needs_presence_and_enough_time_left() -> None:
    scene = scene_of(NEAR)
    valid = scene.agents.valid.copy()
    valid[0, 20] = False
    gap = replace(scene, agents=replace(scene.agents, valid=valid))
    assert find_launch_frame(gap, 0, HYPER) == 12
    valid[0, :30] = False
    late = replace(scene, agents=replace(scene.agents, valid=valid))
    assert find_launch_frame(late, 0, HYPER) == 42
    valid[0, :80] = False
    assert find_launch_frame(replace(scene, agents=replace(scene.agents, valid=valid)), 0, HYPER) is None


def test_reversing_and_sliding_cars_are_not_launched() -> None:
    scene = scene_of(NEAR)
    for turn in (np.pi, 0.8):
        turned = replace(scene, agents=replace(scene.agents, yaw=scene.agents.yaw + turn))
        assert not is_driving_forward(turned, 0, 30)
        assert find_exclusion_reason(turned, 0, HYPER) is not None


def test_initial_state_is_the_recorded_motion() -> None:
    state = compute_initial_state(scene_of(NEAR), 0, 24, DriverLimits())
    assert abs(state.speed - 8.0) < 1e-6
    assert abs(state.acceleration) < 1e-6
    assert abs(state.steering) < 1e-6
    np.testing.assert_allclose(state.pose, [62.0 + 16.0 - 0.3 * 4.6, 194.75, 0.0])
    # A car that drifts backwards starts standing.
    assert compute_initial_state(scene_of(Car(62.0, 194.75, -0.2)), 0, 24, DriverLimits()).speed == 0.0


def test_initial_state_of_a_turning_accelerating_car() -> None:
    scene = scene_of(NEAR)
    time = scene.seconds
    yaw = 0.2 * time
    distance = 6.0 * time + 0.5 * 1.0 * time**2
    steps = np.diff(distance, prepend=0.0)
    position = scene.agents.position.copy()
    position[0, :, 0] = 62.0 + np.cumsum(steps * np.cos(yaw))
    position[0, :, 1] = 194.75 + np.cumsum(steps * np.sin(yaw))
    agents = replace(scene.agents, position=position, yaw=yaw[None])
    state = compute_initial_state(replace(scene, agents=agents), 0, 24, DriverLimits())
    assert abs(state.speed - 8.0) < 0.2
    assert abs(state.acceleration - 1.0) < 0.2
    assert abs(state.speed * np.tan(state.steering) / (0.6 * 4.6) - 0.2) < 0.02


def test_every_reason_has_its_scene() -> None:
    scene = scene_of(
        NEAR,
        Car(62.0, 201.75, 8.0, category="human.pedestrian.adult"),
        Car(40.0, 194.75, 8.0, category="vehicle.bicycle"),
        Car(75.0, 205.25, 0.0),
        Car(90.0, 194.75, 8.0),
        Car(62.0, 212.0, 8.0),
        Car(62.0, 201.75, -8.0, np.pi),
        Car(38.0, 201.75, 8.0, category="vehicle.truck"),
    )
    scene = replace(scene, adversaries=(scene.agents.ids[7],))
    assert [find_exclusion_reason(scene, agent, HYPER) for agent in range(8)] == [
        None,
        ExclusionReason.NOT_FOUR_WHEELED,
        ExclusionReason.NOT_FOUR_WHEELED,
        ExclusionReason.PARKED,
        ExclusionReason.NEVER_NEAR,
        ExclusionReason.OFF_ROAD,
        ExclusionReason.NO_LAUNCH,
        ExclusionReason.ALREADY_ADVERSARY,
    ]
    for ego_speed, reason in ((2.0, None), (0.0, ExclusionReason.EGO_STANDS)):
        slow = scene_on_straight_road((Car(62.0, 194.75, 2.0),), seconds=12.0, ego_speed=ego_speed)
        assert find_exclusion_reason(slow, 0, HYPER) is reason


def test_every_object_is_accounted_for() -> None:
    cars = [Car(30.0 + 5.0 * row, y, 8.0) for row in range(8) for y in (194.75, 201.75)]
    scene = scene_of(*cars, Car(62.0, 208.0, 1.0, category="human.pedestrian.adult"))
    for seed in range(3):
        seen = compute_eligibility(scene, HYPER, seed)
        assert tuple(vehicle.agent for vehicle in seen.chosen) == choose(scene, HYPER, seed)
        counts = seen.not_tried()
        assert len(seen.chosen) + sum(counts.values()) == seen.objects == len(scene.agents)
        assert counts[ExclusionReason.NOT_FOUR_WHEELED] == 1
        eligible = sum(find_exclusion_reason(scene, agent, HYPER) is None for agent in range(len(scene.agents)))
        assert counts[ExclusionReason.NOT_DRAWN] == eligible - 10 > 0
        assert seen.row(())["tried"] == 10
