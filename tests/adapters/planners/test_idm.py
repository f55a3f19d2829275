"""Lane following and distance keeping, on roads made by hand."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.planners.idm import IntelligentDriver
from benchmark.dynamics.idm import DriverParameters
from benchmark.dynamics.lane_path import build_lane_path, find_nearest_lane
from benchmark.geometry import Floats
from benchmark.planning import Command, Plan, SceneInfo
from benchmark.protocols.exact import ExactProtocol
from benchmark.road_map import Lane, RoadMap
from benchmark.scene import Scene
from tests.benchmark.fake_data import observation, sample_truth
from tests.hand_made import Car, scene_on_straight_road


def planned(scene: Scene, index: int) -> Plan:
    driver = IntelligentDriver()
    driver.reset(SceneInfo(scene.name, scene.road_map.location, ()))
    driver.reveal(scene)
    return driver.plan(observation(scene, index, {}))


def hits(scene: Scene, index: int) -> bool:
    plans = planned(scene, index).waypoints_in_lidar()[None]
    return bool(ExactProtocol().evaluate([sample_truth(scene, index)], plans).collision.any())


def test_on_a_free_road_it_speeds_up_to_the_limit_and_keeps_what_is_above_it() -> None:
    plan = planned(scene_on_straight_road((), ego_speed=8.0), 5)
    speed = np.diff(plan.waypoints[:, 0], prepend=0.0) / 0.5
    assert (np.diff(speed) > 0).all() and speed[-1] < DriverParameters().speed_limit
    assert np.abs(plan.waypoints[:, 1]).max() < 0.01
    assert plan.forecasts is not None and plan.forecasts.boxes.shape == (0, 5)
    assert plan.forecasts.trajectories.shape == (0, 1, 6, 2) and plan.forecasts.scores.shape == (0, 1)
    ahead = planned(scene_on_straight_road((), ego_speed=18.0), 5).waypoints
    assert np.diff(ahead[:, 0], prepend=0.0) / 0.5 == pytest.approx(18.0, abs=0.1)
    with pytest.raises(RuntimeError, match="reveal"):
        IntelligentDriver().plan(observation(scene_on_straight_road(), 0, {}))


@pytest.mark.parametrize("category", ["vehicle.car", "human.pedestrian.adult", "movable_object.barrier"])
def test_it_stops_for_whatever_stands_in_its_way(category: str) -> None:
    scene = scene_on_straight_road((Car(90.0, 198.25, 0.0, category=category, size=(0.8, 0.8, 1.7)),), ego_speed=10.0)
    assert not hits(scene, 2)
    rear = 90.0 - 0.4
    front = scene.ego.position[scene.keyframes[2], 0] + planned(scene, 2).waypoints[5, 0] + 1.39 + 4.084 / 2
    assert front < rear


@settings(max_examples=15, deadline=None)
@given(st.floats(12.0, 40.0), st.floats(0.0, 10.0), st.floats(0.0, 10.0))
def test_it_never_runs_into_a_leader_that_it_can_stop_for(gap: float, ego_speed: float, leader_speed: float) -> None:
    leader = Car(50.0 + 1.39 + 4.6 / 2 + 4.084 / 2 + gap, 198.25, leader_speed)
    scene = scene_on_straight_road((leader,), ego_speed=ego_speed)
    apart = scene.agents.boxes[0, :, 0] - scene.ego.boxes[:, 0] > 12.0
    index = 1
    if apart[scene.keyframes[index]]:
        assert not hits(scene, index)


def test_cars_beside_and_behind_do_not_matter_until_they_cut_in() -> None:
    free, beside, cutting_in = (
        planned(scene_on_straight_road(cars, ego_speed=8.0), 1).waypoints
        for cars in ((), (Car(56.0, 194.75, 8.0), Car(38.0, 198.25, 9.0)), (Car(66.0, 195.0, 8.0, yaw=0.35),))
    )
    assert beside == pytest.approx(free) and cutting_in[5, 0] < free[5, 0] - 0.5


def test_beside_its_lane_it_returns_to_the_middle() -> None:
    scene = scene_on_straight_road((), ego_y=199.0)
    ahead = planned(scene, 3).waypoints
    assert ahead[-1, 1] == pytest.approx(198.25 - 199.0, abs=0.1)
    assert (np.diff(ahead[:, 1]) <= 1e-9).all()


def test_without_a_lane_it_goes_straight() -> None:
    scene = scene_on_straight_road((), ego_y=230.0)
    assert planned(scene, 3).waypoints[:, 1] == pytest.approx(0.0)
    empty = replace(scene, road_map=RoadMap("boston-seaport", shapely.MultiPolygon()))
    assert planned(empty, 3).waypoints[:, 1] == pytest.approx(0.0)


def test_it_looks_at_nothing_of_the_future() -> None:
    scene = scene_on_straight_road((Car(90.0, 198.25, 2.0), Car(70.0, 194.75, 9.0)), ego_speed=9.0)
    index = 4
    later = np.arange(len(scene.timestamps_us)) > scene.keyframes[index]
    position = scene.agents.position.copy()
    position[:, later, 0] += 25.0
    changed = replace(scene, agents=replace(scene.agents, position=position))
    plan, other = planned(scene, index), planned(changed, index)
    assert (plan.waypoints == other.waypoints).all()
    assert plan.forecasts is not None and other.forecasts is not None
    assert (plan.forecasts.trajectories == other.forecasts.trajectories).all()


BUSY = (
    Car(80.0, 198.25, 6.0),
    Car(66.0, 195.0, 8.0, yaw=0.2),
    Car(90.0, 215.0, 5.0, yaw=-np.pi / 2),
    Car(120.0, 201.75, 9.0, np.pi),
    Car(38.0, 198.25, 12.0),
)
"""A leader, a car that cuts in, one that crosses, an oncoming one, one that follows."""


def test_its_forecasts_are_what_it_plans_by() -> None:
    plan = planned(scene_on_straight_road(BUSY, ego_speed=9.0), 4)
    # As it was before there were forecasts.
    before = [4.315527310005109, 8.320637442056494, 12.02350628019623, 14.609099980353776]
    assert plan.waypoints[:, 0] == pytest.approx([*before, 16.485110332335722, 18.57467409833096], abs=1e-9)
    assert not plan.waypoints[:, 1].any() and plan.forecasts is not None
    forecasts = plan.forecasts
    assert forecasts.boxes[:, :2] == pytest.approx(
        np.array([[24.0, 0.0], [13.681, -0.071], [22.0, 6.75], [34.0, 3.5], [-6.0, 0.0]])
    )
    assert np.abs(forecasts.boxes[:, 4]) == pytest.approx([0.0, 0.2, np.pi / 2, np.pi, 0.0], abs=1e-3)
    assert forecasts.scores.tolist() == [[1.0]] * 5
    seconds = 0.5 * np.arange(1, 7)
    leader, cutting_in, crossing, oncoming, follower = forecasts.trajectories[:, 0]
    assert leader[:, 0] == pytest.approx(24.0 + 6.0 * seconds) and not leader[:, 1].any()
    # It expects who cuts in to do so for a second and a half.
    assert cutting_in[:, 1] == pytest.approx(-0.071 + 8.0 * np.sin(0.2) * np.minimum(seconds, 1.5), abs=2e-3)
    assert crossing[:, 1] == pytest.approx(6.75 - 5.0 * seconds) and crossing[:, 0] == pytest.approx(22.0)
    assert oncoming[:, 0] == pytest.approx(34.0 - 9.0 * seconds) and oncoming[:, 1] == pytest.approx(3.5)
    assert follower[:, 0] == pytest.approx(-6.0 + 12.0 * seconds)


def test_its_forecasts_are_in_the_frame_of_its_plan() -> None:
    turned = Car(50.0, 198.25 + 20.0, 5.0, yaw=np.pi / 2)
    seen = planned(scene_on_straight_road((turned,), ego_speed=0.0), 3).forecasts
    assert seen is not None
    assert seen.boxes[0] == pytest.approx([0.0, 27.5, 4.6, 1.9, np.pi / 2], abs=1e-3)
    assert seen.trajectories[0, 0, :, 1] == pytest.approx(27.5 + 2.5 * np.arange(1, 7))


def fork() -> RoadMap:
    """A lane east that forks at x = 40: left and right bends of 15 m radius, and straight on."""
    angle = np.linspace(0.0, np.pi / 2, 20)
    bend = 15.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    lines: dict[str, Floats] = {
        "in": np.array([[0.0, 0.0], [40.0, 0.0]]),
        "left": np.array([40.0, 0.0]) + bend,
        "right": np.array([40.0, 0.0]) + bend * [1.0, -1.0],
        "straight": np.array([[40.0, 0.0], [120.0, 0.0]]),
    }
    after = {"in": ("left", "right", "straight")}
    lanes = {name: Lane(name, line, None, after.get(name, ()), (), name != "in") for name, line in lines.items()}
    return RoadMap("boston-seaport", shapely.MultiPolygon(), lanes=lanes)


@pytest.mark.parametrize(
    ("command", "end"),
    [(Command.LEFT, (55.0, 15.0)), (Command.RIGHT, (55.0, -15.0)), (Command.STRAIGHT, (70.0, 0.0))],
)
def test_the_command_chooses_the_branch(command: Command, end: tuple[float, float]) -> None:
    path = build_lane_path(fork(), np.array([30.0, 0.2, 0.0]), command, 5.0, 40.0)
    assert path is not None
    assert np.hypot(*(path.points - end).T).min() < 0.6


def test_it_slows_down_for_a_bend() -> None:
    base = scene_on_straight_road((), ego_x=10.0, ego_y=0.0, ego_speed=12.0)
    scene = replace(base, road_map=fork())
    driver = IntelligentDriver()
    driver.reveal(scene)
    seen = replace(observation(scene, 3, {}), command=Command.LEFT)
    assert driver.plan(seen).waypoints[5, 0] < 12.0 * 3 - 6.0


def test_lanes_the_other_way_are_not_followed() -> None:
    road = scene_on_straight_road(()).road_map
    east, west = (find_nearest_lane(road, np.array([100.0, y, yaw])) for y, yaw in ((198.4, 0.1), (201.6, np.pi)))
    assert east is not None and west is not None
    assert (east.identifier, west.identifier) == ("east-0", "west-0")
    assert find_nearest_lane(road, np.array([100.0, 198.25, np.pi / 2])) is None


def test_where_the_mapped_lane_ends_it_drives_on() -> None:
    scene = scene_on_straight_road((), ego_x=375.0, ego_speed=10.0)
    ahead = planned(scene, 3).waypoints
    assert ahead[5, 0] > 29.0 and np.abs(ahead[:, 1]).max() < 0.05
