"""The recorded path as a route: where one is beside it, and the command."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.closed_loop.route import EXTENSION_M, Route
from benchmark.datasets.sample_truth import compute_truth
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.planning import Command
from benchmark.scene import EgoTrack, Scene
from tests.benchmark.closed_loop.made import town_scene
from tests.hand_made import scene_on_straight_road


def along(points: Floats) -> Scene:
    """A scene whose ego goes through points, looking along them."""
    scene = scene_on_straight_road((), seconds=len(points) / 12)
    step = np.gradient(points, axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    return replace(scene, ego=EgoTrack(np.column_stack([points, np.zeros(len(points))]), quaternion_from_yaw(yaw)))


def test_a_place_is_a_station_and_a_distance() -> None:
    route = Route.of(scene_on_straight_road(ego_x=50.0, ego_y=198.25, ego_speed=8.0))
    place = route.place(np.array([70.0, 200.25]))
    assert place.station == pytest.approx(20.0) and place.aside == pytest.approx(2.0)
    assert route.at(np.array([20.0])) == pytest.approx(np.array([[70.0, 198.25]]))


def test_past_its_end_the_route_goes_straight_on() -> None:
    route = Route.of(scene_on_straight_road(ego_speed=8.0))
    beyond = route.at(np.array([route.end_m + 30.0, route.end_m + EXTENSION_M + 30.0]))
    assert beyond == pytest.approx(np.array([[50 + route.end_m + 30, 198.25], [50 + route.end_m + 130, 198.25]]))
    assert route.place(np.array([50 + route.end_m + 30, 198.25])).station == pytest.approx(route.end_m + 30)


def test_a_path_that_crosses_itself_is_followed_from_where_one_was() -> None:
    turn = np.linspace(0, 2 * np.pi, 200)
    loop = np.column_stack([np.sin(turn), 1 - np.cos(turn)]) * 20 + [100.0, 200.0]
    before = np.column_stack([np.linspace(60, 99.8, 60), np.full(60, 200.0)])
    after = np.column_stack([np.linspace(100.2, 140, 60), np.full(60, 200.0)])
    route = Route.of(along(np.concatenate([before, loop, after])))
    crossing = np.array([100.0, 200.0])
    first, second = route.place(crossing, 38.0).station, route.place(crossing, 160.0).station
    assert first == pytest.approx(40.0, abs=0.5) and second == pytest.approx(40 + 2 * np.pi * 20, abs=1.0)


@pytest.mark.parametrize("index", range(2))
def test_beside_the_recording_commands_are_those_of_the_data_set(index: int) -> None:
    scene = town_scene(index)
    route, station = Route.of(scene), None
    poses, seconds = scene.ego.pose[scene.keyframes], scene.seconds[scene.keyframes]
    truths = compute_truth(scene, [str(number) for number in range(len(poses))])
    found = []
    for pose, second in zip(poses, seconds):
        station = route.place(pose, station).station
        found.append(route.command(station, float(second)))
    agree = [command is truth.command for command, truth in zip(found, truths)]
    # The lateral displacement that decides is interpolated between frames.
    assert np.mean(agree) >= 0.97


def test_a_command_is_about_the_route_and_not_about_the_car() -> None:
    turn = np.linspace(0, np.pi / 2, 60)
    straight = np.column_stack([np.linspace(40, 99, 60), np.full(60, 200.0)])
    bend = np.column_stack([np.sin(turn), 1 - np.cos(turn)]) * 20 + [100.0, 200.0]
    route = Route.of(along(np.concatenate([straight, bend])))
    assert route.command(10.0, 0.8) is Command.STRAIGHT
    assert route.command(65.0, 0.0) is Command.LEFT
    assert route.command(route.end_m + 20.0, 30.0) is Command.STRAIGHT


def test_where_the_recording_stood_the_moment_nearest_to_now_counts() -> None:
    standing = np.tile([100.0, 200.0], (96, 1))
    turn = np.linspace(0, np.pi / 2, 60)
    coming = np.column_stack([np.linspace(60, 99.5, 48), np.full(48, 200.0)])
    bend = np.column_stack([np.sin(turn), 1 - np.cos(turn)]) * 20 + [100.0, 200.0]
    route = Route.of(along(np.concatenate([coming, standing, bend[1:]])))
    station = route.place(np.array([100.0, 200.0])).station
    assert route.command(station, 5.0) is Command.STRAIGHT
    assert route.command(station, 12.0) is Command.LEFT
    assert route.command(station, 60.0) is Command.LEFT


def test_the_recorded_ego_keeps_its_motion_past_the_end() -> None:
    scene = scene_on_straight_road(ego_speed=8.0, seconds=4.0)
    route = Route.of(scene)
    inside, past = route.recorded_at(np.array([2.0, float(scene.seconds[-1]) + 1.0]))
    assert inside == pytest.approx(np.array([66.0, 198.25]))
    assert past == pytest.approx(scene.ego.position[-1, :2] + [8.0, 0.0])
