"""A scripted policy behind gRPC, rides by hand, and planners for the wire."""

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import grpc
import numpy as np

from benchmark.closed_loop.episodes import EpisodeSpec
from benchmark.extensions.alpasim.messages import EGODRIVER, METHODS, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import Poses, decode_trajectory, encode_trajectory
from benchmark.extensions.alpasim.server import GrpcServer
from benchmark.extensions.alpasim.session import EgodriverService
from benchmark.geometry import quaternion_from_yaw, rotation_matrix
from benchmark.planning import Planner
from benchmark.untrusted.files import GRPC_PICTURE
from tests.benchmark.closed_loop.seeing import Painted
from tests.benchmark.closed_loop.staged import staged
from tests.hand_made import scene_on_straight_road

Answer = Callable[["Scripted", Any], Any]


class Refused(Exception):
    """An error of gRPC."""

    def __init__(self, code: str, text: str = "no GPU") -> None:
        super().__init__(text)
        self.code = code


@dataclass
class Scripted:
    """Where a scripted policy is, and what it was asked, in order."""

    url: str = ""
    asked: list[tuple[str, Any]] = field(default_factory=list)
    metadata: list[dict[str, str]] = field(default_factory=list)

    def of(self, name: str) -> list[Any]:
        return [message for asked, message in self.asked if asked == name]

    @property
    def now(self) -> Poses:
        """The newest pose."""
        return decode_trajectory(self.of("submit_egomotion_observation")[-1].trajectory).at(slice(-1, None))


def ahead(log: Scripted, request: Any, *, seconds: float = 5.0, speed: float = 8.0, **changes: Any) -> Any:
    """A good answer of ``drive``: straight on from the newest pose, every 0.1 s."""
    steps = np.arange(round(seconds * 10) + 1)
    now = log.now
    forward = rotation_matrix(now.rotation[0])[:, 0]
    poses = Poses(
        int(request.time_now_us) + 100_000 * steps,
        now.position[0] + 0.1 * speed * steps[:, None] * forward,
        np.tile(now.rotation[0], (len(steps), 1)),
    )
    return build_message("DriveResponse", trajectory=encode_trajectory(replace(poses, **changes)))


@contextmanager
def scripted(**answers: Answer) -> Iterator[Scripted]:
    """A policy that answers calls as functions say, and all others as is usual; `None` hangs."""
    log = Scripted()

    class Calls(grpc.GenericRpcHandler):  # type: ignore[misc, unused-ignore]
        def service(self, details: Any) -> Any:
            name = details.method.removeprefix(EGODRIVER)

            def answer(data: bytes, context: Any) -> bytes:
                message = decode_message(METHODS[details.method][0], data, GRPC_PICTURE)
                log.asked.append((name, message))
                log.metadata.append(dict(context.invocation_metadata()))
                try:
                    made = answers.get(name, USUAL.get(name, nothing))(log, message)
                except Refused as refused:
                    context.abort(grpc.StatusCode[refused.code], str(refused))
                if made is None:
                    time.sleep(1.0)
                    return b""
                return made if isinstance(made, bytes) else encode_message(made)

            return grpc.unary_unary_rpc_method_handler(answer)

    server = grpc.server(ThreadPoolExecutor(8), handlers=(Calls(),))
    log.url = f"grpc://127.0.0.1:{server.add_insecure_port('127.0.0.1:0')}"
    server.start()
    try:
        yield log
    finally:
        server.stop(0).wait()


def nothing(log: Scripted, request: Any) -> Any:
    return build_message("Empty")


USUAL: Mapping[str, Answer] = {
    "drive": ahead,
    "get_version": lambda log, request: build_message("VersionId", version_id="scripted"),
}


@contextmanager
def serving(build: Callable[[], Planner], **options: Any) -> Iterator[GrpcServer]:
    """A server of a planner."""
    with GrpcServer(EgodriverService(build, **{"cameras": {}, **options})) as server:
        yield server


def on_stage(seconds: float = 4.0, **changes: Any) -> EpisodeSpec:
    """A straight road with small pictures."""
    return replace(staged(scene_on_straight_road((), seconds=seconds)), sensor=Painted(), **changes)


def straight(count: int = 3, speed: float = 5.0, yaw: float = 0.3, first_us: int = 1_000_000) -> Poses:
    """Poses 0.1 s apart, straight on."""
    steps = 0.1 * speed * np.arange(count)
    position = np.column_stack([steps * np.cos(yaw), steps * np.sin(yaw), np.zeros(count)])
    rotation = np.tile(quaternion_from_yaw(np.array(yaw)), (count, 1))
    return Poses(first_us + 100_000 * np.arange(count), position, rotation)
