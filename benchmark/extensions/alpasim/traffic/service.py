"""AlpaSim's TrafficService without a socket: calls in, answers out, sessions side by side.

Up to the hand-over everybody is told from the log. What the ego does later is known from its updates alone.
"""

import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.adversary import ADVERSARY, AdversaryFactory
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.constants import VERSION
from benchmark.errors import InputError
from benchmark.extensions.alpasim.messages import METHODS, TRAFFIC, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import SECOND_US, Poses, decode_trajectory, encode_trajectory
from benchmark.extensions.alpasim.session import API_VERSION
from benchmark.extensions.alpasim.sessions import CallRefusedError, SessionTable
from benchmark.extensions.alpasim.traffic.session_log import EGO, SessionLog, read_session, require_poses
from benchmark.extensions.alpasim.traffic.session_scene import MapFrame, build_scene, estimate_frame
from benchmark.extensions.alpasim.traffic.session_world import SessionWorld
from benchmark.scene import Scene
from benchmark.untrusted.files import GRPC_SESSION, to_one_line

LONGEST_STEP_S: Final = 10.0
"""Between two queries: all of it is driven at once."""
_HISTORY_US: Final = 500_000


@dataclass(frozen=True, slots=True)
class TrafficSettings:
    """How everybody but the ego behaves.

    ``agents`` and ``maker`` are as of `DefaultBackend`; ``adversary`` names who challenges, else it is chosen. ``find``
    gives the map of a session, `estimate_frame` by default; ``seed`` is added to those of sessions.
    """

    agents: str = "replay"
    maker: AdversaryFactory | None = None
    adversary: str = ""
    find: Callable[[SessionLog], MapFrame] = estimate_frame
    seed: int = 0

    def build_world(self, log: SessionLog) -> SessionWorld:
        """The world of a session; raises `CallRefusedError`."""
        if self.adversary and self.adversary not in {track.uuid for track in log.others}:
            raise CallRefusedError(
                "FAILED_PRECONDITION", f"there is no object {self.adversary} in the session; leave --adversary out"
            )
        try:
            frame = self.find(log)
        except InputError as error:
            raise CallRefusedError("FAILED_PRECONDITION", str(error)) from error
        scene = build_scene(log, frame, self.adversary)
        start_us, end_us = log.handover_us, int(scene.timestamps_us[-1])
        policy, answers = None, self.agents == "idm"
        if self.agents == ADVERSARY and self.maker is not None:
            answers = self.maker.others == "idm"
            policy = self._pursue(scene, self.run_of(log), start_us, end_us)
        if policy is None:
            plain = "idm" if answers else "replay"
            policy = DefaultBackend(plain).build_agents(scene, 0, start_us, end_us)
        return SessionWorld(log, frame, scene, policy, everybody_answers=answers)

    def run_of(self, log: SessionLog) -> int:
        """Number of the run of a session: its seed, and ours."""
        return int(log.seed) + self.seed

    def _pursue(self, scene: Scene, run: int, start_us: int, end_us: int) -> Any:
        try:
            return DefaultBackend(ADVERSARY, adversary=self.maker).build_agents(scene, run, start_us, end_us)
        except InputError:
            return None


@dataclass(slots=True)
class _Session:
    world: SessionWorld
    lock: threading.Lock = field(default_factory=threading.Lock)
    asked_us: int = 0


class TrafficService:
    """Answers calls with the poses of everybody; safe to call from several threads."""

    prefix: Final = TRAFFIC

    def __init__(self, settings: TrafficSettings, ended: Callable[[SessionWorld], None] | None = None) -> None:
        """``ended`` is given the world of each session that a client closes or forgets."""
        self._settings, self._ended = settings, ended
        self._sessions: SessionTable[_Session] = SessionTable(self._end)
        self._planning = threading.Lock()
        self._calls: dict[str, Callable[[Any], Any]] = {
            "start_session": self._start,
            "close_session": self._close,
            "simulate": self._simulate,
            "get_metadata": self._tell_metadata,
            "get_available_scenes": self._tell_scenes,
        }

    def call(self, path: str, data: bytes, metadata: Mapping[str, str]) -> bytes:
        """The answer to a call, in bytes; `CallRefusedError` where there is none, `LookupError` for an unknown path."""
        name = path.removeprefix(TRAFFIC)
        call = self._calls[name]
        try:
            request = decode_message(METHODS[path][0], data, GRPC_SESSION)
        except ValueError as error:
            raise CallRefusedError("INVALID_ARGUMENT", f"{name} cannot be read: {error}") from error
        return encode_message(call(request))

    def close(self) -> None:
        """End all sessions."""
        self._sessions.close_all()

    def _tell_metadata(self, request: Any) -> Any:
        version = {"version_id": f"challenger-bench-{VERSION}", "grpc_api_version": API_VERSION}
        return build_message("TrafficModuleMetadata", version_id=version, minimum_history_length_us=_HISTORY_US)

    def _tell_scenes(self, request: Any) -> Any:
        return build_message("AvailableScenesReturn", scene_ids=["*"])

    def _start(self, request: Any) -> Any:
        if not request.session_uuid:
            raise CallRefusedError("INVALID_ARGUMENT", "there is no session_uuid")
        if not request.handover_time_us:
            raise CallRefusedError("INVALID_ARGUMENT", "there is no handover_time_us")
        log = read_session(request)
        with self._planning:
            world = self._guard("start", lambda: self._settings.build_world(log))
        self._sessions.add(request.session_uuid, lambda: _Session(world))
        return build_message("SessionRequestStatus")

    def _close(self, request: Any) -> Any:
        self._sessions.close(request.session_uuid)
        return build_message("Empty")

    def _end(self, session: _Session) -> None:
        with session.lock:
            session.world.note_contacts()
        if self._ended is not None:
            self._ended(session.world)

    def _simulate(self, request: Any) -> Any:
        session, query_us = self._sessions.find(request.session_uuid), min(request.time_query_us, 1 << 62)
        with session.lock:
            world = session.world
            if query_us < session.asked_us:
                raise CallRefusedError(
                    "INVALID_ARGUMENT", f"time_query_us went back, from {session.asked_us} to {query_us}"
                )
            known_us = max(world.told_us, world.log.handover_us)
            if query_us - known_us > LONGEST_STEP_S * SECOND_US:
                raise CallRefusedError(
                    "INVALID_ARGUMENT",
                    f"time_query_us is {(query_us - known_us) / SECOND_US:.1f} s later than {EGO} was seen; ask at "
                    f"least every {LONGEST_STEP_S:g} s",
                )
            self._take_ego(world, request, query_us)
            if query_us > world.log.handover_us:
                with self._planning:
                    self._guard("simulate", lambda: world.advance(query_us))
            session.asked_us = query_us
            return _tell(world, query_us)

    def _take_ego(self, world: SessionWorld, request: Any, query_us: int) -> None:
        """Poses of the ego that are new; after the hand-over there must be one at the time that is asked for."""
        told = [update.trajectory for update in request.object_trajectory_updates if update.object_id == EGO]
        for trajectory in told:
            poses = decode_trajectory(trajectory)
            require_poses(poses, EGO)
            new = (poses.times_us > world.told_us) & (poses.times_us <= query_us)
            if new.any():
                world.tell(Poses(poses.times_us[new], poses.position[new], poses.rotation[new]))
        if query_us > max(world.told_us, world.log.handover_us):
            raise CallRefusedError(
                "INVALID_ARGUMENT", f"there is no pose of {EGO} at {query_us} us among object_trajectory_updates"
            )

    def _guard(self, doing: str, work: Callable[[], Any]) -> Any:
        try:
            return work()
        except CallRefusedError:
            raise
        except Exception as error:
            sentence = f"the traffic failed at {doing}: {type(error).__name__}: {to_one_line(error) or 'no reason'}"
            print(sentence, file=sys.stderr, flush=True)
            raise CallRefusedError("INTERNAL", sentence) from error


def _tell(world: SessionWorld, query_us: int) -> Any:
    """Everybody who is there, one pose each."""
    updates = []
    for number, track in enumerate(world.log.others):
        placed = world.place(number, query_us)
        if placed is not None:
            poses = Poses(np.array([query_us]), placed[0][None], placed[1][None])
            updates.append({"object_id": track.uuid, "trajectory": encode_trajectory(poses)})
    return build_message("TrafficReturn", object_trajectory_updates=updates)
