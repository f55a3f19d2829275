"""Traffic of another simulator in our drives: a TrafficService at ``grpc://HOST:PORT`` moves everybody but the ego.

One session a drive. It is told all tracks of the scene, and of the ego what is past, then where the ego really is.
Recordings are told in the frame of the drive's first pose; who comes back within a millimetre of its track is on it.
"""

import contextlib
import uuid
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.adversary import DECIMALS, AdversaryTrack, place_traffic
from benchmark.closed_loop.agent_policy import AgentMotion, AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import SUBSTEP_US
from benchmark.errors import InputError
from benchmark.extensions.alpasim.connection import EgodriverConnection
from benchmark.extensions.alpasim.messages import TRAFFIC, build_message
from benchmark.extensions.alpasim.poses import LocalFrame, Poses, encode_trajectory
from benchmark.extensions.alpasim.traffic.answers import TrafficAnswerError, read_traffic
from benchmark.extensions.alpasim.traffic.session_log import EGO
from benchmark.geometry import Floats, quaternion_from_yaw, wrap_angle, yaw_of_quaternion
from benchmark.machine.address import ALIVE_S, DEADLINE_S, Address
from benchmark.machine.extension import require_extra
from benchmark.planning import ModelFailedError
from benchmark.scene import Scene
from benchmark.untrusted.files import to_one_line

ON_TRACK_M: Final = 1e-3
ON_TRACK_RAD: Final = 1e-3
_CLOSE_S: Final = 5.0
_EGO_HEIGHT_M: Final = 1.56
_CLASS_OF_CATEGORY: Final[Mapping[str, str]] = {
    "vehicle.car": "automobile",
    "vehicle.truck": "heavy_truck",
    "vehicle.bus": "bus",
    "vehicle.trailer": "trailer",
    "vehicle.bicycle": "cyclist",
    "vehicle.motorcycle": "motorcycle",
    "human.pedestrian.stroller": "stroller",
    "human": "person",
    "animal": "animal",
    "vehicle": "other_vehicle",
}


def encode_session(scene: Scene, frame: LocalFrame, start_us: int, name: str, seed: int) -> Any:
    """A ``TrafficSessionRequest`` of a scene; the ego's poses end with the start of the drive."""
    ego, agents, times = scene.ego.boxes, scene.agents, scene.timestamps_us
    past = times <= start_us
    height = scene.ego.position[:, 2] + 0.5 * _EGO_HEIGHT_M
    own = np.column_stack([ego[:, :2], height])[past], ego[past, 4]
    size = np.array([*ego[0, 2:4], _EGO_HEIGHT_M])
    tracks = [_encode_object(frame, EGO, size, "automobile", times[past], *own)]
    for row, identifier in enumerate(agents.ids):
        there = agents.valid[row]
        if there.any():
            known = times[there], agents.position[row, there], agents.yaw[row, there]
            label = find_class(agents.categories[row])
            tracks.append(_encode_object(frame, identifier, agents.size[row], label, *known))
    return build_message(
        "TrafficSessionRequest",
        session_uuid=name,
        scene_id=scene.name,
        random_seed=seed,
        logged_object_trajectories=tracks,
        handover_time_us=frame.to_local_us(start_us),
    )


def _encode_object(
    frame: LocalFrame, name: str, size: Floats, label: str, times_us: Any, position: Floats, yaw: Floats
) -> dict[str, Any]:
    poses = frame.to_local(Poses(times_us, position, quaternion_from_yaw(yaw)))
    still = bool(np.ptp(poses.position[:, :2], axis=0).max() < ON_TRACK_M)
    return {
        "aabb": dict(zip(("size_x", "size_y", "size_z"), np.asarray(size).tolist())),
        "trajectory": encode_trajectory(poses),
        "object_id": name,
        "is_static": still,
        "label_class": label,
    }


def find_class(category: str) -> str:
    """AlpaSim's class of a category of nuScenes."""
    parts = category.split(".")
    names = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((_CLASS_OF_CATEGORY[name] for name in names if name in _CLASS_OF_CATEGORY), "unknown")


class _Session:
    """An open session; it is closed when nobody holds it any more."""

    def __init__(self, connection: EgodriverConnection, frame: LocalFrame) -> None:
        self.name, self.frame, self.connection = str(uuid.uuid4()), frame, connection
        self.end = weakref.finalize(self, _close, connection, self.name)


def _close(connection: EgodriverConnection, name: str) -> None:
    with contextlib.suppress(Exception):
        connection.call("close_session", build_message("TrafficSessionCloseRequest", session_uuid=name), _CLOSE_S)
    connection.close()


@dataclass(frozen=True, slots=True)
class TrafficMemory:
    """Memory of remote traffic: its session, and (N, 3) rounded poses of all after each 0.1 s, NaN where one is gone.

    ``left`` is who ever left its recording, and after how many steps.
    """

    session: _Session
    others: Any
    rows: tuple[Floats, ...]
    left: Mapping[int, int]


@dataclass(frozen=True, slots=True)
class RemoteTraffic:
    """Policy of everybody but the ego that a TrafficService has; ``others`` is the recording."""

    scene: Scene
    run: int
    start_us: int
    others: AgentPolicy[Any]
    connect: Callable[[], EgodriverConnection]
    name: str = "adversary"
    draws: bool = False

    def init(self, time_us: int, key: int) -> tuple[TrafficMemory, AgentMotion]:
        """Begin a session; all are where they were recorded."""
        origin = np.array([*self.scene.ego.position[0, :2], 0.0])
        session = _Session(self.connect(), LocalFrame(origin, int(self.scene.timestamps_us[0])))
        request = encode_session(self.scene, session.frame, time_us, session.name, self.run)
        ask(session.connection, "start_session", request)
        memory, moved = self.others.init(time_us, key)
        return TrafficMemory(session, memory, (), {}), moved

    def act(self, memory: TrafficMemory, moment: TrafficSnapshot, key: int) -> tuple[TrafficMemory, AgentMotion]:
        """The next 0.1 s: everybody where the service has them."""
        others, moved = self.others.act(memory.others, moment, key)
        answered = self._simulate(memory.session, moment)
        row, left = np.full((len(self.scene.agents), 3), np.nan), dict(memory.left)
        for agent, identifier in enumerate(self.scene.agents.ids):
            pose = answered.get(identifier)
            if pose is not None:
                row[agent] = np.round(pose, DECIMALS) + 0.0
            if agent not in left and not _is_on_track(moved, agent, row[agent]):
                left[agent] = len(memory.rows)
        later = replace(memory, others=others, rows=(*memory.rows, row), left=left)
        return later, place_traffic(moved, moment, {agent: row[agent] for agent in sorted(left)})

    def adversary(self, memory: TrafficMemory) -> AdversaryTrack:
        """Who went farthest from its recording so far, and all who left it."""
        agents, times = self.scene.agents, self.scene.timestamps_us
        start = int(np.searchsorted(times, self.start_us))
        rows = np.array(memory.rows).reshape(-1, len(agents), 3)
        clock = self.start_us + SUBSTEP_US * np.arange(len(rows) + 1)
        reached = times[start:][times[start:] <= clock[-1]]
        farthest, off_m = 0, -1.0
        for agent in memory.left:
            there = agents.valid[agent]
            recorded = np.column_stack(
                [np.interp(clock[1:], times[there], column) for column in agents.position[agent, there, :2].T]
            )
            away = np.hypot(*(rows[:, agent, :2] - recorded).T)
            most = float(np.nanmax(away, initial=-1.0)) if np.isfinite(away).any() else -1.0
            farthest, off_m = (agent, most) if most > off_m else (farthest, off_m)
        first = np.array([*agents.position[farthest, start, :2], agents.yaw[farthest, start]])
        driven = np.concatenate([first[None], rows[:, farthest]])
        known = np.isfinite(driven).all(axis=1)
        columns = (driven[known, 0], driven[known, 1], np.unwrap(driven[known, 2]))
        poses = np.column_stack([np.interp(reached, clock[known], column) for column in columns])
        poses[:, 2] = wrap_angle(poses[:, 2])
        traffic = tuple((agent, first, rows[first:, agent]) for agent, first in sorted(memory.left.items()))
        return AdversaryTrack(farthest, start, np.round(poses, DECIMALS) + 0.0, (), traffic)

    def _simulate(self, session: _Session, moment: TrafficSnapshot) -> dict[str, Floats]:
        """(3,) poses of everybody who is there 0.1 s later, global."""
        assert moment.ego_after is not None
        ego, query_us = moment.ego_after, moment.time_us + SUBSTEP_US
        height = self.scene.ego.position[0, 2] + 0.5 * _EGO_HEIGHT_M
        rotation = quaternion_from_yaw(ego[4:])
        poses = session.frame.to_local(Poses(np.array([query_us]), np.array([[*ego[:2], height]]), rotation))
        update = {"object_id": EGO, "trajectory": encode_trajectory(poses)}
        local_us = int(poses.times_us[0])
        request = build_message(
            "TrafficRequest", session_uuid=session.name, time_query_us=local_us, object_trajectory_updates=[update]
        )
        answer = ask(session.connection, "simulate", request)
        try:
            found = read_traffic(answer, local_us, self.scene.agents.ids)
        except TrafficAnswerError as error:
            raise InputError(f"the traffic at {session.connection.url} cannot be driven in: {error}") from error
        origin = session.frame.origin
        return {
            name: np.array([*(position + origin)[:2], float(yaw_of_quaternion(rotation))])
            for name, (position, rotation) in found.items()
        }


def _is_on_track(moved: AgentMotion, agent: int, pose: Floats) -> bool:
    if not np.isfinite(pose).all() or not moved.present[1, agent]:
        return not np.isfinite(pose).all() and not moved.present[1, agent]
    away = np.hypot(*(pose[:2] - moved.boxes[1, agent, :2]))
    turned = abs(float(wrap_angle(pose[2] - moved.boxes[1, agent, 4])))
    return bool(away <= ON_TRACK_M and turned <= ON_TRACK_RAD)


def ask(connection: EgodriverConnection, method: str, message: Any, deadline_s: float | None = None) -> Any:
    """The answer to a call; raises `InputError` where there is none."""
    try:
        return connection.call(method, message, deadline_s)
    except ModelFailedError as error:
        raise InputError(str(error)) from error


@dataclass(frozen=True, slots=True)
class RemoteTrafficMaker:
    """Puts a TrafficService in the place of an adversary (`AdversaryFactory`); ``version`` is what it calls itself."""

    address: Address
    version: str
    others: str = "replay"

    @property
    def facts(self) -> Mapping[str, Any]:
        """Who drove everybody."""
        return {"traffic": self.address.name, "version": self.version, **self.address.settings}

    def possible(self, scene: Scene) -> bool:
        """Whether there is anybody to be driven."""
        return len(scene.agents) > 0

    def policy(
        self, scene: Scene, run: int, start_us: int, others: Callable[[int], AgentPolicy[Any]]
    ) -> AgentPolicy[Any]:
        """The policy of a scene."""
        return RemoteTraffic(scene, run, start_us, others(0), self.connect)

    def connect(self) -> EgodriverConnection:
        """A channel of its own."""
        return EgodriverConnection(self.address.url, "the traffic", DEADLINE_S, TRAFFIC)


def build_remote_traffic(address: str) -> RemoteTrafficMaker:
    """The traffic at ``grpc://HOST:PORT`` or ``NAME=grpc://HOST:PORT``; raises `InputError` where none answers."""
    for package in ("grpc", "google.protobuf"):
        require_extra(package, "asking over gRPC", "alpasim")
    maker = RemoteTrafficMaker(Address.of(address, "--agents", ("grpc",)), "")
    connection = maker.connect()
    try:
        connection.wait(ALIVE_S)
        version = ask(connection, "get_metadata", build_message("Empty"), ALIVE_S).version_id.version_id
    finally:
        connection.close()
    return replace(maker, version=to_one_line(version, 100))
