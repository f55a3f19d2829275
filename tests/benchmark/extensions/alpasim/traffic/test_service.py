"""The traffic service by its calls: logs that are told as they were sent, damaged sessions, golden ones."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.extensions.alpasim.messages import build_message
from benchmark.extensions.alpasim.traffic import session_log
from benchmark.extensions.alpasim.traffic.service import TrafficSettings
from benchmark.extensions.alpasim.traffic.serving import describe_session
from benchmark.extensions.alpasim.traffic.session_log import EGO, find_category, read_session
from benchmark.extensions.alpasim.traffic.verification import REACTIONS, SESSIONS
from tests.benchmark.extensions.alpasim.traffic.made import (
    HANDOVER_US,
    Client,
    refusal,
    road_scene,
    session_request,
    simulate_request,
    to_place,
    track_of,
)

GOLDEN = Path(__file__).resolve().parents[6] / "shared" / "golden" / "alpasim"


def test_replayed_traffic_is_told_as_it_was_sent() -> None:
    client, request = Client(), session_request()
    client.start(request)
    log = read_session(request)
    for time_us in (1_200_000, 2_000_000, 2_083_333, 4_500_000):
        told = client.ask(time_us)
        assert told.keys() == {track.uuid for track in log.others}
        for track in log.others:
            np.testing.assert_array_equal(told[track.uuid], np.float32(track.at(time_us)[0]))
    stored = track_of(request, log.others[0].uuid).trajectory.poses[13]
    (place,) = (
        to_place(update)
        for update in client.call(
            "simulate", simulate_request(stored.timestamp_us + 3_600_000, np.zeros(3))
        ).object_trajectory_updates
        if update.object_id == log.others[3].uuid
    )
    assert place[2] == log.others[3].poses.position[0, 2]


def test_who_comes_later_or_leaves_earlier_is_there_while_the_log_is() -> None:
    client, request = Client(), session_request()
    late, early = (track.object_id for track in request.logged_object_trajectories[1:3])
    del track_of(request, late).trajectory.poses[:40]
    del track_of(request, early).trajectory.poses[40:]
    client.start(request)
    first, last = client.ask(2_100_000), client.ask(5_500_000)
    assert late not in first and early in first
    assert late in last and early not in last


def test_nothing_of_the_egos_recorded_future_is_read() -> None:
    usual, other = Client(TrafficSettings("idm")), Client(TrafficSettings("idm"))
    usual.start()
    request = session_request()
    later = [pose for pose in track_of(request, EGO).trajectory.poses if pose.timestamp_us > HANDOVER_US]
    assert len(later) > 50
    for number, pose in enumerate(later):
        pose.pose.vec.x, pose.pose.vec.y = 37.0 * (number % 5), float("nan")
    later[0].timestamp_us, later[-1].timestamp_us = later[-1].timestamp_us, later[0].timestamp_us
    other.start(request)
    for one, two in zip(usual.drive(5_000_000), other.drive(5_000_000), strict=True):
        assert one.keys() == two.keys() and all((one[name] == two[name]).all() for name in one)


def test_others_that_answer_brake_for_an_ego_that_stands() -> None:
    client = Client(TrafficSettings("idm"))
    scene = road_scene()
    client.start(session_request(scene))
    behind, stands = scene.agents.ids[1], np.array([30.0, -3.5, 0.78])
    for time_us in range(1_100_000, 6_000_001, 100_000):
        told = client.ask(time_us, stands if time_us > HANDOVER_US else None)
    assert told[behind][0] < stands[0] - 2.0
    client.close()
    assert "0 contacts among the others" in describe_session(client.ended[0])


DAMAGED: dict[str, Callable[[Any], None]] = {
    "no track of EGO": lambda request: request.logged_object_trajectories.pop(0),
    "more than once": lambda request: setattr(request.logged_object_trajectories[1], "object_id", EGO),
    "has no poses": lambda request: request.logged_object_trajectories[1].ClearField("trajectory"),
    "has the size": lambda request: setattr(request.logged_object_trajectories[1].aabb, "size_x", 1e9),
    "position that is NaN": lambda request: setattr(
        request.logged_object_trajectories[2].trajectory.poses[3].pose.vec, "x", float("nan")
    ),
    "times of object": lambda request: setattr(
        request.logged_object_trajectories[2].trajectory.poses[3], "timestamp_us", 1
    ),
    "not a unit quaternion": lambda request: setattr(
        request.logged_object_trajectories[2].trajectory.poses[3].pose.quat, "w", 1.1
    ),
    "no pose up to the hand-over": lambda request: setattr(request, "handover_time_us", 5),
    "no handover_time_us": lambda request: request.ClearField("handover_time_us"),
    "no session_uuid": lambda request: request.ClearField("session_uuid"),
    "too many": lambda request: setattr(
        request.logged_object_trajectories[1].trajectory.poses[-1], "timestamp_us", 10**15
    ),
    "more than 1000": lambda request: request.logged_object_trajectories.extend(
        [build_message("ObjectTrajectory", object_id=str(number)) for number in range(10_000)]
    ),
}


@pytest.mark.parametrize("sentence", DAMAGED)
def test_damaged_sessions_are_refused_with_a_sentence_and_the_server_lives_on(sentence: str) -> None:
    client, request = Client(), session_request()
    DAMAGED[sentence](request)
    error = refusal(client.start, request)
    assert error.code == "INVALID_ARGUMENT" and sentence in str(error) and "\n" not in str(error)
    client.start()
    assert len(client.ask(2_100_000)) == 4


def test_times_that_run_backwards_gaps_and_egos_that_are_nowhere_are_refused_and_change_nothing() -> None:
    client, usual = Client(TrafficSettings("idm")), Client(TrafficSettings("idm"))
    for each in (client, usual):
        each.start()
        each.drive(3_000_000)
    nowhere, empty = np.array([np.nan, 0.0, 0.0]), build_message("TrafficRequest", session_uuid="a")
    empty.time_query_us = 3_100_000
    assert "went back" in str(refusal(client.ask, 2_900_000))
    assert "later than EGO was seen" in str(refusal(client.ask, 60_000_000))
    assert "NaN" in str(refusal(client.ask, 3_100_000, nowhere))
    assert "no pose of EGO" in str(refusal(client.call, "simulate", empty))
    one, two = client.ask(3_100_000), usual.ask(3_100_000)
    assert all((one[name] == two[name]).all() for name in two)
    again = client.ask(3_100_000)
    assert all((one[name] == again[name]).all() for name in one)


def test_sessions_have_names() -> None:
    client = Client()
    assert refusal(client.ask, 2_100_000).code == "NOT_FOUND"
    client.start()
    assert refusal(client.start).code == "ALREADY_EXISTS"
    client.start(session_request(name="b"), "b")
    client.ask(4_000_000, name="b")
    client.ask(2_100_000)
    client.close()
    client.close()
    assert refusal(client.ask, 2_200_000).code == "NOT_FOUND" and len(client.ended) == 1
    metadata = client.call("get_metadata", build_message("Empty"))
    assert metadata.minimum_history_length_us == 500_000
    assert list(client.call("get_available_scenes", build_message("Empty")).scene_ids) == ["*"]


def test_half_seconds_are_driven_in_tenths_of_them() -> None:
    often, seldom = Client(TrafficSettings("idm")), Client(TrafficSettings("idm"))
    for client in (often, seldom):
        client.start()
    often.drive(5_000_000)
    for time_us in range(1_500_000, 5_000_001, 500_000):
        told = seldom.ask(time_us)
    usual = often.ask(5_000_000)
    for name, place in usual.items():
        np.testing.assert_allclose(told[name], place, atol=1e-4)


def test_classes_of_others_are_categories_here() -> None:
    assert find_category("automobile", (4.5, 1.9)) == find_category("", (4.5, 1.9)) == "vehicle.car"
    assert find_category("other_vehicle", (12.0, 2.6)) == "vehicle.bus.rigid"
    assert find_category("person", (0.7, 0.7)) == find_category("", (0.7, 0.7)) == "human.pedestrian.adult"
    assert find_category("", (1.8, 0.6)) == "vehicle.bicycle"
    assert session_log.MOST_OBJECTS < 10_000


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="the golden sessions are not here")
@pytest.mark.parametrize(("golden", "folder"), [(SESSIONS, "traffic"), (REACTIONS, "reactions")])
def test_recorded_sessions_and_reactions_agree(golden: Any, folder: str) -> None:
    checks = golden.verify(GOLDEN / folder)
    assert checks and all(check.ok for check in checks)
