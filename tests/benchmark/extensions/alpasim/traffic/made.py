"""Traffic sessions by hand: a straight road, cars on it, and a client that calls a service without a socket."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from benchmark.extensions.alpasim.messages import METHODS, TRAFFIC, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import LocalFrame, Poses, encode_trajectory
from benchmark.extensions.alpasim.sessions import CallRefusedError
from benchmark.extensions.alpasim.traffic.client import encode_session
from benchmark.extensions.alpasim.traffic.service import TrafficService, TrafficSettings
from benchmark.extensions.alpasim.traffic.session_log import EGO
from benchmark.extensions.alpasim.traffic.session_world import SessionWorld
from benchmark.geometry import Floats
from benchmark.scene import Scene
from benchmark.untrusted.files import GRPC_SESSION
from tests.hand_made import Car, scene_on_straight_road

CARS = (Car(80.0, 198.25, 8.0), Car(40.0, 194.75, 10.0), Car(120.0, 201.75, 9.0, np.pi), Car(90.0, 191.0))
HANDOVER_US = 2_000_000


def road_scene(seconds: float = 8.0) -> Scene:
    return scene_on_straight_road(CARS, seconds=seconds)


def session_request(scene: Scene | None = None, name: str = "a", seed: int = 0) -> Any:
    """The start of a session; the ego's recorded future is in it, as AlpaSim sends it."""
    scene = scene or road_scene()
    frame = LocalFrame(np.array([*scene.ego.position[0, :2], 0.0]), int(scene.timestamps_us[0]))
    request = encode_session(scene, frame, int(scene.timestamps_us[-1]), name, seed)
    request.handover_time_us = HANDOVER_US
    return request


class Client:
    """Calls a service as AlpaSim's runtime does; ``ended`` are the worlds of sessions that are over."""

    def __init__(self, settings: TrafficSettings | None = None) -> None:
        self.ended: list[SessionWorld] = []
        self.service = TrafficService(settings or TrafficSettings(), self.ended.append)

    def call(self, method: str, message: Any) -> Any:
        answer = self.service.call(TRAFFIC + method, encode_message(message), {})
        return decode_message(METHODS[TRAFFIC + method][1], answer, GRPC_SESSION)

    def start(self, request: Any | None = None, name: str = "a") -> None:
        self.call("start_session", request or session_request(name=name))

    def ask(self, time_us: int, ego: Floats | None = None, name: str = "a") -> dict[str, Floats]:
        """x, y, z of everybody; the ego is told at (3,) x, y, z, or else as it drives by itself at 8 m/s."""
        place = np.array([8.0 * (time_us - 1_000_000) / 1e6, 0.0, 0.78]) if ego is None else ego
        answer = self.call("simulate", simulate_request(time_us, place, name))
        return {update.object_id: to_place(update) for update in answer.object_trajectory_updates}

    def drive(self, last_us: int, name: str = "a", speed: float = 8.0) -> list[dict[str, Floats]]:
        """Answers every 0.1 s, of an ego that drives straight on at a speed."""
        times = range(1_100_000, last_us + 1, 100_000)
        return [self.ask(time, np.array([speed * (time - 1_000_000) / 1e6, 0.0, 0.78]), name) for time in times]

    def close(self, name: str = "a") -> None:
        self.call("close_session", build_message("TrafficSessionCloseRequest", session_uuid=name))


def simulate_request(time_us: int, place: Floats, name: str = "a") -> Any:
    poses = Poses(np.array([time_us]), place[None], np.array([[1.0, 0.0, 0.0, 0.0]]))
    update = {"object_id": EGO, "trajectory": encode_trajectory(poses)}
    return build_message("TrafficRequest", session_uuid=name, time_query_us=time_us, object_trajectory_updates=[update])


def to_place(update: Any) -> Floats:
    vec = update.trajectory.poses[0].pose.vec
    return np.array([vec.x, vec.y, vec.z])


def refusal(call: Any, *given: Any, **named: Any) -> CallRefusedError:
    """The error of a call that has to be refused."""
    try:
        call(*given, **named)
    except CallRefusedError as error:
        return error
    raise AssertionError("it was answered")


def track_of(request: Any, name: str) -> Any:
    tracks: Iterable[Any] = request.logged_object_trajectories
    return next(track for track in tracks if track.object_id == name)
