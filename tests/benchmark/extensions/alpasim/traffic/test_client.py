"""Other simulators' traffic in our drives: over gRPC, kept with the row, and driven again without it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.adversary import ScriptedTracks
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import Episode, EpisodeSpec, run_episode
from benchmark.closed_loop.observation_builder import NoSensor
from benchmark.closed_loop.reference_drivers import simulate_reference_drivers
from benchmark.closed_loop.scoring import score_episode
from benchmark.closed_loop.simulation_state import RecordedCan
from benchmark.errors import InputError
from benchmark.extensions.alpasim.messages import decode_message, encode_message
from benchmark.extensions.alpasim.server import GrpcServer
from benchmark.extensions.alpasim.traffic.client import build_remote_traffic, find_class
from benchmark.extensions.alpasim.traffic.service import TrafficService, TrafficSettings
from benchmark.interactions.reaction import Driver
from benchmark.planning import EgoState
from benchmark.records.drive_schema import EpisodeRow
from benchmark.runs.drive_rows import build_episode_row, decode_adversary_track
from benchmark.scene import Scene
from benchmark.untrusted.files import GRPC_SESSION
from tests.benchmark.closed_loop.staged import Watching
from tests.benchmark.extensions.alpasim.traffic.made import road_scene

STANDING = EgoState(np.zeros(3), np.zeros(3), np.zeros(4), np.zeros(2), np.zeros(2), 0.0, None, "derived")


class Changed(TrafficService):
    """Answers `simulate` as a function changes it."""

    def __init__(self, settings: TrafficSettings, change: Callable[[Any], None] = lambda answer: None) -> None:
        self.open: list[str] = []
        self.starts: list[Any] = []
        super().__init__(settings, lambda world: self.open.append(world.scene.name))
        self._change = change

    def call(self, path: str, data: bytes, metadata: Any) -> bytes:
        answer = super().call(path, data, metadata)
        if path.endswith("start_session"):
            self.starts.append(decode_message("TrafficSessionRequest", data, GRPC_SESSION))
        if not path.endswith("simulate"):
            return answer
        message = decode_message("TrafficReturn", answer, GRPC_SESSION)
        self._change(message)
        return encode_message(message)


@contextmanager
def traffic(service: TrafficService) -> Iterator[DefaultBackend]:
    with GrpcServer(service, limits=GRPC_SESSION) as server:
        yield DefaultBackend("adversary", adversary=build_remote_traffic(f"them={server.url}"))


def drive(scene: Scene, maker: DefaultBackend, speed: float = 8.0) -> tuple[Episode, EpisodeRow]:
    can = RecordedCan.of(STANDING for _ in scene.keyframes)
    spec = EpisodeSpec(scene, can, 0, maker, NoSensor(), 30.0)
    episode = run_episode(spec, Watching(speed))
    assert episode.failure is None
    return episode, build_episode_row(spec, episode, score_episode(scene, episode))


def test_replayed_traffic_of_a_service_is_a_drive_among_replayed_tracks() -> None:
    scene, service = road_scene(), Changed(TrafficSettings())
    with traffic(service) as maker:
        assert maker.adversary is not None and maker.adversary.facts["traffic"] == "them"
        driven, row = drive(scene, maker)
        usual, _ = drive(scene, DefaultBackend("replay"))
    np.testing.assert_array_equal(driven.motion.position, usual.motion.position)
    assert row.adversary is not None and not row.adversary.traffic
    (start,) = service.starts
    last = max(pose.timestamp_us for pose in start.logged_object_trajectories[0].trajectory.poses)
    assert last == start.handover_time_us == 2_000_000


def test_traffic_that_reacts_is_kept_and_driven_again_without_the_service() -> None:
    scene, service = road_scene(), Changed(TrafficSettings("idm"))
    with traffic(service) as maker:
        driven, row = drive(scene, maker, 1.0)
    assert row.adversary is not None and row.adversary.traffic
    stored = EpisodeRow.model_validate_json(row.model_dump_json())
    track = decode_adversary_track(stored)
    assert track is not None
    again = replace(maker, adversary=ScriptedTracks({(scene.name, 0): track}, "replay"))
    episode, other = drive(scene, again, 1.0)
    np.testing.assert_array_equal(episode.motion.position, driven.motion.position)
    np.testing.assert_array_equal(episode.motion.present, driven.motion.present)
    assert other.model_dump() == row.model_dump()


def test_who_is_not_answered_is_gone_and_may_come_back() -> None:
    scene = road_scene()
    gone, asked = scene.agents.ids[1], []

    def hide(answer: Any) -> None:
        asked.append(1)
        if 10 < len(asked) < 20:
            for place, update in reversed([*enumerate(answer.object_trajectory_updates)]):
                if update.object_id == gone:
                    del answer.object_trajectory_updates[place]

    with traffic(Changed(TrafficSettings(), hide)) as maker:
        driven, row = drive(scene, maker)
    start = len(driven.motion.times_us) - len(asked)
    present = driven.motion.present[1, start:]
    assert present[:10].all() and not present[10:19].any() and present[19:].all()
    assert row.adversary is not None and [each.agent for each in row.adversary.traffic] == [1]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda answer: answer.object_trajectory_updates.add(object_id="nobody"), "unknown object"),
        (
            lambda answer: setattr(answer.object_trajectory_updates[0].trajectory.poses[0].pose.vec, "x", float("nan")),
            "NaN",
        ),
    ],
)
def test_answers_that_cannot_be_taken_end_the_drive_in_a_sentence(change: Callable[[Any], None], sentence: str) -> None:
    with traffic(Changed(TrafficSettings(), change)) as maker, pytest.raises(InputError, match=sentence):
        drive(road_scene(), maker)


def test_reference_drivers_have_sessions_of_their_own_which_end() -> None:
    scene, service = road_scene(), Changed(TrafficSettings("idm"))
    with traffic(service) as maker:
        outcome = simulate_reference_drivers(scene, maker.course(scene, 0), [Driver.CC, Driver.IDM])
        assert len(outcome) == len(service.starts) == 2
        assert len({start.session_uuid for start in service.starts}) == 2
    assert len(service.open) == 2


def test_classes_of_alpasim() -> None:
    names = ("vehicle.car", "vehicle.bus.bendy", "vehicle.construction", "human.pedestrian.adult", "static_object")
    assert [find_class(name) for name in names] == ["automobile", "bus", "other_vehicle", "person", "unknown"]
