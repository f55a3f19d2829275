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

from benchmark.extensions.http.requests import CAMERAS
from benchmark.extensions.http.server import PlannerServer
from benchmark.extensions.http.session import PlannerSession
from benchmark.geometry import quaternion_from_yaw
from benchmark.planning import CameraView, Command, EgoState, Observation, Planner
from generation.sources.rig import build_default_lidar
from tests.benchmark.closed_loop.seeing import picture, small_cameras

SHARED = Path(__file__).resolve().parents[4].parent / "shared" / "golden" / "neuroncap" / "http"
START_US = 1_700_000_000_000_000
Reply = tuple[int, bytes] | None
"""Status and body; ``None`` hangs up."""
GOOD = b'{"trajectory": [[1, 0], [2, 0], [3, 0], [4, 0], [5, 0], [6, 0]], "aux_outputs": {}}'


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


@contextmanager
def serving(planner: Planner) -> Iterator[str]:
    """Address of a server of a planner, in a thread."""
    with PlannerServer(PlannerSession(planner, tensors=True)) as server:
        yield server.url
