"""A scripted server, an observation by hand, and planners for the wire."""

import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.http.requests import CAMERAS
from benchmark.extensions.http.server import PlannerServer
from benchmark.extensions.http.session import PlannerSession
from benchmark.geometry import quaternion_from_yaw, transform_matrix
from benchmark.machine.storage import content_seed
from benchmark.planning import CameraView, Command, EgoState, Observation, Plan, PlanFrame, Planner, SceneInfo
from benchmark.scene import Camera, Scene
from generation.sources.rig import build_default_cameras, build_default_lidar

SHARED = Path(__file__).resolve().parents[4].parent / "shared" / "golden" / "neuroncap" / "http"
START_US = 1_700_000_000_000_000
Reply = tuple[int, bytes] | None
"""Status and body; ``None`` hangs up."""
GOOD = b'{"trajectory": [[1, 0], [2, 0], [3, 0], [4, 0], [5, 0], [6, 0]], "aux_outputs": {}}'


def small_cameras() -> tuple[Camera, ...]:
    return tuple(camera.resized(8, 6) for camera in build_default_cameras())


def picture(number: int, shape: tuple[int, int] = (6, 8)) -> NDArray[np.uint8]:
    rows, columns = np.indices(shape)
    return np.asarray(np.stack([10 * number + rows, 100 + columns, np.full(shape, 7)], axis=-1), np.uint8)


def observed(index: int = 0, *, speed: float = 8.0, yaw: float = 0.3, **changes: Any) -> Observation:
    """The sample of that number in a scene, half a second apart."""
    pose = np.array([speed * 0.5 * index, 20.0, yaw])
    row = np.array([speed, 0.0, 0.0, 0.25, 0.5, 9.81, 0.0, 0.0, 0.0625])
    cameras = {camera.name: camera for camera in small_cameras()}
    time_us = START_US + 500_000 * index
    views = {
        name: CameraView(cameras[name], Path(name), time_us, np.eye(4), partial(picture, number))
        for number, name in enumerate(CAMERAS)
    }
    ego = EgoState(
        pose=pose,
        position=np.array([pose[0], pose[1], 0.5]),
        rotation=quaternion_from_yaw(np.array(yaw)),
        velocity=row[:2],
        acceleration=row[3:5],
        yaw_rate=0.0625,
        steering_angle=0.1,
        source="can_bus",
        can_motion=row,
        can_motion_after=row,
    )
    made = Observation(
        scene="scene-1",
        sample_token=f"token-{index}",
        index=index,
        timestamp_us=time_us,
        views=views,
        lidar=build_default_lidar(),
        ego=ego,
        past_poses=np.tile(pose, (5, 1)),
        past_valid=np.arange(5) >= 4 - index,
        command=Command.LEFT,
    )
    return replace(made, **changes)


class Looking:
    """Answers by everything that the wire carries: speed, command, time and every pixel."""

    name = "looking"

    def __init__(self) -> None:
        self.resets = 0
        self.seen: list[Observation] = []

    def reset(self, scene: SceneInfo) -> None:
        self.resets += 1
        self.seen = []

    def plan(self, observation: Observation) -> Plan:
        self.seen.append(observation)
        seconds = 0.5 * np.arange(1, 7)
        # Whole numbers: cameras come in another order over the wire, and sums of fractions depend on it.
        pixels = [view.load() for view in observation.views.values()]
        light = sum(int(each.sum()) for each in pixels) / max(sum(each.size for each in pixels), 1) / 1e4
        aside = (int(observation.command) - 2) * 0.01 + light + 1e-3 * (observation.timestamp_us % 7)
        speed = float(observation.ego.velocity[0]) + 0.1 * float(observation.ego.yaw_rate) + 0.01 * observation.index
        return Plan(np.column_stack([speed * seconds, aside * seconds]), PlanFrame.EGO)


@dataclass
class Scripted:
    """Where a scripted server is, and what it was asked, in order: method, path, headers and body."""

    url: str
    asked: list[tuple[str, str, Mapping[str, str], bytes]] = field(default_factory=list)

    @property
    def paths(self) -> list[str]:
        return [path for _, path, _, _ in self.asked]


@contextmanager
def scripted(answer: Callable[[str, bytes], Reply]) -> Iterator[Scripted]:
    """A server that answers as a function says; it never sends anything that the function did not."""
    log = Scripted("")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self._answer()

        def do_POST(self) -> None:
            self._answer()

        def _answer(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            log.asked.append((self.command, self.path, {k.lower(): v for k, v in self.headers.items()}, body))
            reply = answer(self.path, body)
            if reply is None:
                self.close_connection = True
                return
            self.send_response(reply[0])
            self.send_header("content-type", "application/json")
            self.send_header("content-length", str(len(reply[1])))
            self.end_headers()
            self.wfile.write(reply[1])

        def log_message(self, format: str, *values: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    log.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=partial(server.serve_forever, poll_interval=0.01), daemon=True)
    thread.start()
    try:
        yield log
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def free_port() -> int:
    """A port at which nobody listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@dataclass(frozen=True)
class Painted:
    """A sensor whose small pictures depend on where the car is and when, to the last bit."""

    name: str = "painted"

    @property
    def facts(self) -> Mapping[str, Any]:
        return {}

    def look(self, scene: Scene) -> "Painted":
        return self

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return small_cameras()

    def views(self, driven: Scene) -> dict[str, CameraView]:
        pose = transform_matrix(driven.ego.rotation[-1], driven.ego.position[-1])
        time_us = int(driven.timestamps_us[-1])
        found = {}
        for camera in small_cameras():
            seed = content_seed(camera.name, driven.ego.position[-1].tolist(), time_us)
            pixels = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
            found[camera.name] = CameraView(camera, Path(camera.name), time_us, pose, pixels.copy)
        return found


@contextmanager
def serving(planner: Planner) -> Iterator[str]:
    """Address of a server of a planner, in a thread."""
    with PlannerServer(PlannerSession(planner, tensors=True)) as server:
        yield server.url
