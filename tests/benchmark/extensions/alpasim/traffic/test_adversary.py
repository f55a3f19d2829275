"""The served adversary: the same as in process, blind to the recorded future, and nobody but the ego is touched."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.agent_policy import TrafficSnapshot
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.plan_tracking import SUBSTEP_US
from benchmark.closed_loop.simulation_config import build_log_replay
from benchmark.extensions.alpasim.messages import METHODS, TRAFFIC, decode_message, encode_message
from benchmark.extensions.alpasim.traffic.answers import find_faults
from benchmark.extensions.alpasim.traffic.service import TrafficSettings
from benchmark.extensions.alpasim.traffic.serving import describe_session
from benchmark.extensions.alpasim.traffic.session_log import EGO, read_session
from benchmark.extensions.alpasim.traffic.session_scene import build_scene, estimate_frame
from benchmark.geometry import Floats
from benchmark.scene import EgoTrack
from benchmark.untrusted.files import GRPC_SESSION
from tests.benchmark.extensions.alpasim.traffic.made import (
    HANDOVER_US,
    Client,
    refusal,
    road_scene,
    session_request,
    simulate_request,
    track_of,
)

LAST_US = 6_000_000


def make_adversary(**options: Any) -> Any:
    made = pytest.importorskip("generation.extensions.reactive_adversary.adversary_maker")
    budget = {"rounds": 1, "candidates": 48, **options}
    return made.build_reactive_adversary_maker(knows="motion-only", **budget)


def served(adversary: str = "", **options: Any) -> Client:
    return Client(TrafficSettings("adversary", make_adversary(**options), adversary))


def place_ego(time_us: int) -> Floats:
    """An ego that slows down and moves over, as no recording says."""
    seconds = (time_us - 1_000_000) / 1e6
    free = max(seconds - 1.0, 0.0)
    return np.array([8.0 * seconds - 0.6 * free**2, 0.25 * min(free, 4.0), 0.78])


def run(client: Client, last_us: int = LAST_US) -> list[dict[str, Floats]]:
    return [client.ask(time_us, place_ego(time_us)) for time_us in range(1_100_000, last_us + 1, 100_000)]


def test_in_process_the_same_tracks_and_poses_give_the_same_adversary_bit_for_bit() -> None:
    client, request = served(), session_request()
    client.start(request)
    told = run(client)
    log = read_session(request)
    scene = build_scene(log, estimate_frame(log))
    maker = make_adversary()
    policy = DefaultBackend("adversary", adversary=maker).build_agents(
        scene, int(log.seed), HANDOVER_US, int(scene.timestamps_us[-1])
    )
    memory, moved = policy.init(HANDOVER_US, 0)
    size = log.ego.size[:2]
    places = {
        time_us: np.float32(place_ego(time_us)).astype(float)
        for time_us in range(HANDOVER_US - SUBSTEP_US, LAST_US + 1, SUBSTEP_US)
    }
    recorded = {time: log.ego.at(time)[0] for time in (HANDOVER_US - SUBSTEP_US, HANDOVER_US)}
    places |= recorded
    for time_us in range(HANDOVER_US, LAST_US, SUBSTEP_US):
        x, y = places[time_us][:2]
        speed = max(float(x - places[time_us - SUBSTEP_US][0]) / 0.1, 0.0)
        ego = np.array([x, y, *size, 0.0])
        moment = TrafficSnapshot(time_us, ego, speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        memory, moved = policy.act(memory, moment, 0)
        there = told[(time_us - 1_000_000) // SUBSTEP_US]
        own = policy.adversary(memory).agent  # type: ignore[attr-defined]
        np.testing.assert_array_equal(there[scene.agents.ids[own]][:2], np.float32(moved.boxes[-1, own, :2]))
    track = policy.adversary(memory)  # type: ignore[attr-defined]
    recorded_end = scene.agents.position[track.agent, track.start + len(track.poses) - 1, :2]
    assert np.hypot(*(track.poses[-1, :2] - recorded_end)) > 0.5 and len(track.replanned) >= 4


def test_the_egos_recorded_future_changes_nothing_and_where_it_really_is_does() -> None:
    usual, permuted, other = served(), served(), served()
    usual.start()
    request = session_request()
    later = [pose for pose in track_of(request, EGO).trajectory.poses if pose.timestamp_us > HANDOVER_US]
    order = np.random.default_rng(0).permutation(len(later))
    places = [(pose.pose.vec.x, pose.pose.vec.y) for pose in later]
    for pose, place in zip(later, order, strict=True):
        pose.pose.vec.x, pose.pose.vec.y = places[place]
    permuted.start(request)
    other.start()
    own, same = run(usual), run(permuted)
    assert all((one[name] == two[name]).all() for one, two in zip(own, same, strict=True) for name in one)
    stands = [
        other.ask(time_us, place_ego(min(time_us, HANDOVER_US))) for time_us in range(1_100_000, LAST_US + 1, 100_000)
    ]
    assert any((own[-1][name] != stands[-1][name]).any() for name in own[-1])


def test_in_a_drive_the_recording_after_its_start_is_not_known() -> None:
    scene, maker = road_scene(), make_adversary()
    start_us, end_us = int(scene.timestamps_us[scene.keyframes[2]]), int(scene.timestamps_us[-1])
    later = scene.timestamps_us > start_us
    position = scene.ego.position.copy()
    position[later] += [3.0, -20.0, 0.0]
    elsewhere = replace(scene, ego=EgoTrack(position, scene.ego.rotation))
    tracks = []
    for each in (scene, elsewhere):
        policy = maker.policy(each, 0, start_us, lambda _: build_log_replay(scene, start_us, end_us))
        tracks.append((policy.agent, policy.start, policy.scene.ego.position.tobytes()))
        assert maker.possible(each)
    assert tracks[0] == tracks[1]


@pytest.mark.parametrize("others", ["replay", "idm"])
def test_everybody_is_answered_and_nobody_but_the_ego_is_touched(others: str) -> None:
    client, request = served(others=others), session_request()
    client.start(request)
    log = read_session(request)
    before: dict[str, Floats] = {}
    for time_us in range(1_100_000, int(log.last_us), 100_000):
        sent = encode_message(simulate_request(time_us, place_ego(min(time_us, LAST_US))))
        answer = decode_message(
            METHODS[TRAFFIC + "simulate"][1], client.service.call(TRAFFIC + "simulate", sent, {}), GRPC_SESSION
        )
        faults, before = find_faults(answer, time_us, log.others, before, 0.1)
        assert not faults, time_us
    client.close()
    (world,) = client.ended
    assert world.adversary is not None and len(world.planned_s) >= 5
    assert not [pair for pair in world.touched if EGO not in pair]
    said = describe_session(world)
    assert "challenged" in said and "ms (95 %)" in said and "\n" not in said
    assert ("contacts among the others" in said) == (others == "idm")


def test_the_adversary_goes_on_beyond_its_log_and_stops_when_all_logs_are_over() -> None:
    request = session_request()
    chosen = read_session(request).others[0].uuid
    client = served(chosen)
    del track_of(request, chosen).trajectory.poses[45:]
    client.start(request)
    times = range(1_100_000, 16_000_001, 100_000)
    places = [client.ask(time_us, place_ego(min(time_us, LAST_US)))[chosen] for time_us in times]
    steps = np.hypot(*np.diff(places, axis=0)[:, :2].T)
    assert steps.max() < 2.5 and steps[-1] == 0.0


def test_who_challenges_can_be_named() -> None:
    request = session_request()
    name = read_session(request).others[1].uuid
    client = served(name)
    client.start(request)
    run(client, 2_300_000)
    client.close()
    assert describe_session(client.ended[0]).startswith(f"session of scene-9901: {name} challenged")
    error = refusal(served("nobody").start)
    assert error.code == "FAILED_PRECONDITION" and "leave --adversary out" in str(error)


def test_where_nobody_can_challenge_the_log_is_told() -> None:
    request = session_request()
    del request.logged_object_trajectories[1:]
    client = served()
    client.start(request)
    assert run(client, 2_500_000)[-1] == {}
    client.close()
    assert "nobody could challenge" in describe_session(client.ended[0])
