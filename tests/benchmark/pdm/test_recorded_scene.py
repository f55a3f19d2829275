"""What a recorded scene gives: speeds, objects, route, and plans as poses of the rear axle."""

import numpy as np
import pytest

from benchmark.geometry import Floats
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.pdm.recorded_scene import RecordedScene, estimate_motion, estimate_object_velocity
from benchmark.planning import Plan, PlanFrame
from benchmark.waypoints import waypoints_in_lidar
from tests.hand_made import Car, scene_on_straight_road


def test_speed_and_acceleration_are_those_along_and_across_the_body() -> None:
    seconds = np.arange(30) / 12
    yaw = 0.4
    along = 3.0 * seconds + 0.5 * 1.2 * seconds**2
    poses = np.column_stack([along * np.cos(yaw), along * np.sin(yaw), np.full(30, yaw)])
    motion = estimate_motion(poses, seconds)
    assert motion[:, :3] == pytest.approx(poses)
    assert motion[:, 3] == pytest.approx(3.0 + 1.2 * seconds) and motion[:, 5] == pytest.approx(np.full(30, 1.2))
    assert np.abs(motion[:, [4, 6, 7]]).max() < 1e-9


@pytest.mark.parametrize(("frames", "speed"), [(1, 0.0), (2, 2.0), (3, 2.0)])
def test_a_recording_of_a_few_frames_still_has_a_speed(frames: int, speed: float) -> None:
    seconds = np.arange(frames) * 0.5
    poses = np.column_stack([2.0 * seconds, np.zeros(frames), np.zeros(frames)])
    assert estimate_motion(poses, seconds)[0, 3] == pytest.approx(speed)


def test_velocities_are_central_one_sided_or_zero() -> None:
    position = np.zeros((1, 5, 2))
    position[0, :, 0] = [0.0, 1.0, 4.0, 9.0, 16.0]
    seconds = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    found = estimate_object_velocity(position, np.array([[True, True, True, False, True]]), seconds)[0, :, 0]
    assert found.tolist()[:3] == [2.0, 4.0, 6.0] and found[4] == 0.0


def test_surroundings_know_where_the_recording_begins_and_who_is_there() -> None:
    recorded = RecordedScene(scene_on_straight_road((Car(80.0, 198.25, 8.0), Car(30.0, 220.0, category="animal"))))
    assert recorded.complete.tolist() == [True] * 10 + [False] * 6
    around = recorded.build_context(np.array([0, 3, 9]))
    assert around.has_history.tolist() == [False, True, True]
    assert around.now[:, 3] == pytest.approx([8.0] * 3) and np.abs(around.now[:, 4:]).max() < 1e-3
    assert around.traffic.offsets.tolist() == [0, 2, 4, 6]
    assert around.traffic.is_agent.tolist() == [True, False] * 3
    assert around.traffic.speed == pytest.approx([8.0, 0.0] * 3)
    assert around.traffic.box[2, [0, 30], 0] == pytest.approx([92.0, 116.0])


def test_recorded_plans_are_the_recorded_futures_of_the_rear_axle() -> None:
    plans = RecordedScene(scene_on_straight_road()).build_recorded_plans(np.array([2]))
    assert plans[0] == pytest.approx(np.column_stack([4.0 * np.arange(1, 7), np.zeros((6, 2))]), abs=1e-9)


def test_the_route_is_the_recorded_path_and_a_hundred_metres_straight_ahead() -> None:
    route = RecordedScene(scene_on_straight_road()).route
    assert np.hypot(*np.diff(route[:-101], axis=0).T) == pytest.approx(np.full(len(route) - 102, 0.5))
    assert route[0] == pytest.approx([50.0, 198.25]) and route[-1] == pytest.approx(route[-101] + [100.0, 0.0])


def test_plans_of_both_frames_are_the_same_poses() -> None:
    def both(ego: Floats) -> list[Floats]:
        lidar = waypoints_in_lidar(ego, "ego", 0.94)
        plans = Plan(ego, PlanFrame.EGO), Plan(lidar, PlanFrame.LIDAR)
        return [plan_to_poses(plan, 0.94) for plan in plans]

    angle = 0.1 * np.arange(1, 7)
    of_axle, of_lidar = both(np.column_stack([20 * np.sin(angle), 20 - 20 * np.cos(angle)]))
    # Moved back by the lidar's chords, which point 0.94 m / 20 m to the side of the car's heading.
    assert np.abs(of_lidar - of_axle)[:, 2].max() < 0.02 and np.abs(of_lidar - of_axle).max() < 0.05
    straight = np.column_stack([3.0 * np.arange(1, 7), np.zeros(6)])
    of_axle, of_lidar = both(straight)
    assert of_axle == pytest.approx(np.column_stack([straight, np.zeros(6)])) and of_lidar == pytest.approx(of_axle)


def test_headings_are_those_of_chords_and_held_where_the_car_hardly_moves() -> None:
    waypoints = np.array([[1.0, 1.0], [2.0, 2.0], [2.1, 2.0], [2.1, 2.0], [2.1, 2.0], [2.1, 2.0]])
    heading = plan_to_poses(Plan(waypoints, PlanFrame.EGO), 0.94)[:, 2]
    assert heading[0] == pytest.approx(np.pi / 4)
    assert heading[1] == pytest.approx(np.arctan2(1.0, 1.1)) and (heading[2:] == heading[1]).all()
    assert plan_to_poses(Plan(np.zeros((6, 2)), PlanFrame.EGO), 0.94).tolist() == np.zeros((6, 3)).tolist()
