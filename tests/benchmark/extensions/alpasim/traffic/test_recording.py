"""Sessions that are over as scenes of ours, and maps that are given."""

from pathlib import Path

import numpy as np
import pytest

import benchmark
from benchmark.api.serving import SessionStore
from benchmark.errors import InputError
from benchmark.extensions.alpasim.traffic.given_maps import find_map_in
from benchmark.extensions.alpasim.traffic.recording import SessionRecorder, build_session_scene, place_on_map, report_of
from benchmark.extensions.alpasim.traffic.service import TrafficSettings
from benchmark.extensions.alpasim.traffic.session_log import read_session
from tests.benchmark.extensions.alpasim.traffic.made import Client, refusal, road_scene, session_request
from tests.benchmark.extensions.alpasim.traffic.test_adversary import place_ego, run, served
from tests.benchmark.fake_data import FakeData


def test_a_session_is_a_scene_with_its_adversary_and_opens_as_a_data_set(tmp_path: Path) -> None:
    store = SessionStore(tmp_path)
    for client, name in ((served(), "a"), (Client(), "b")):
        client.start(session_request(name="a"))
        run(client, 7_500_000)
        client.close()
        (world,) = client.ended
        scene = build_session_scene(world)
        assert scene is not None
        at = int(np.searchsorted(scene.timestamps_us, 6_000_000))
        np.testing.assert_allclose(scene.ego.boxes[at, :2], place_ego(6_000_000)[:2], atol=1e-5)
        report = report_of(world, scene)
        assert report["scene_id"] == "scene-9901" and report["careful_human_survives"] is True
        assert (
            (report["adversary"] is not None) == bool(report["decisions"]) == bool(scene.adversaries) == (name == "a")
        )
        placed = place_on_map(scene)
        store.write(placed, report)
    data = benchmark.open_data(str(tmp_path))
    assert data.scene_names("adv") == ("scene-2001",) and data.scene_names("val") == ("scene-2002",)
    stored = data.scene("scene-2001")
    assert len(stored.adversaries) == 1 and len(stored.agents) == 4 and stored.agents.position.min() > 0.0
    again = SessionStore(tmp_path)
    again.write(placed, report)
    assert benchmark.open_data(str(tmp_path)).scene_names("val") == ("scene-2002", "scene-2003")


def test_sessions_that_cannot_be_kept_are_told(tmp_path: Path) -> None:
    said: list[str] = []
    client = Client()
    request = session_request()
    request.handover_time_us = 1_500_000
    client.start(request)
    client.close()
    recorder = SessionRecorder(lambda scene, report: None, said.append)
    recorder.record(client.ended[0])
    recorder.close()
    assert said == ["session of scene-9901 is too short to be kept"]


def test_a_map_is_found_by_the_name_of_the_scene_wherever_the_session_has_its_origin() -> None:
    scene = road_scene()
    find = find_map_in(FakeData({scene.name: scene}))
    frame = find(read_session(session_request(scene)))
    assert frame.road_map is scene.road_map
    poses = np.array([[3.0, 1.0, 0.2]])
    np.testing.assert_allclose(frame.to_session(frame.to_map(poses)), poses, atol=1e-9)
    np.testing.assert_allclose(frame.to_map(np.zeros((1, 3)))[0, :2], scene.ego.position[0, :2], atol=1e-4)
    client = Client(TrafficSettings("idm", find=find))
    client.start(session_request(scene))
    told = client.drive(4_000_000)
    plain = Client()
    plain.start(session_request(scene))
    parked = scene.agents.ids[3]
    np.testing.assert_allclose(told[-1][parked], plain.drive(4_000_000)[-1][parked], atol=1e-4)


def test_maps_of_other_places_are_refused() -> None:
    scene = road_scene()
    find = find_map_in(FakeData({scene.name: scene}))
    request = session_request(scene)
    for pose in request.logged_object_trajectories[0].trajectory.poses[5:]:
        pose.pose.vec.y += 9.0
    with pytest.raises(InputError, match="it is another recording"):
        find(read_session(request))
    unknown = session_request(scene)
    unknown.scene_id = "elsewhere"
    error = refusal(Client(TrafficSettings(find=find)).start, unknown)
    assert error.code == "FAILED_PRECONDITION" and "has no scene elsewhere" in str(error)
