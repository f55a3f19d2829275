"""A served planner without a socket: calls of the egodriver service in, answers out, sessions side by side.

Answers to calls out of order are those of ``carla-driver-interface``: an unknown session is NOT_FOUND but for its end,
one that was begun already ALREADY_EXISTS. A planner plans every half second; between two plans the standing one is told
again from where the car is. ``renderer_data`` and the recorded future, where a client sends it, are never looked at.
"""

import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.observation_builder import PAST_TICKS
from benchmark.constants import CAMERA_NAMES, LIDAR_FROM_REAR_AXLE_M, PLAN_STEP_S, VERSION
from benchmark.extensions.alpasim.cameras import RemoteCamera
from benchmark.extensions.alpasim.connection import CONTRACT
from benchmark.extensions.alpasim.messages import EGODRIVER, METHODS, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import (
    SECOND_US,
    Poses,
    decode_trajectory,
    derive_command,
    derive_states,
    encode_trajectory,
)
from benchmark.extensions.alpasim.sessions import CallRefusedError, SessionTable
from benchmark.geometry import Floats, quaternion_from_yaw, rotation_matrix, transform_matrix, yaw_of_quaternion
from benchmark.machine.storage import content_seed, make_token
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import CameraView, EgoState, Observation, Plan, Planner, SceneInfo
from benchmark.runs.plan_rows import FAILURES, seed_everything
from benchmark.scene import LidarMount
from benchmark.untrusted.files import GRPC_MESSAGE, GRPC_PICTURE, to_one_line
from benchmark.untrusted.http_images import decode_image

API_VERSION: Final = {"major": 0, "minor": 54, "patch": 0}
_MOST_CAMERAS: Final = 32
_MOST_POSES: Final = 1024
_PLAN_US: Final = 500_000
_JITTER_US: Final = 1000
_MOVES_M_S: Final = 0.1
_WRONG_M_S: Final = 1.0
_WRONG_SHARE: Final = 0.3
SCENE: Final = "over-grpc"
"""Name of every scene: a planner that draws by its name must not depend on which it is."""
_LIDAR: Final = LidarMount(np.array([LIDAR_FROM_REAR_AXLE_M, 0.0, 1.84]), quaternion_from_yaw(np.array(-np.pi / 2)))
"""nuScenes' place of a sensor that is not on the wire; some networks reckon from there."""


@dataclass(frozen=True, slots=True)
class _StandingPlan:
    """When it was made, and (K,) times, (K, 3) positions and (K,) headings in the local frame."""

    made_us: int
    times_us: NDArray[np.int64]
    position: Floats
    yaw: Floats


@dataclass(slots=True)
class _Session:
    """What one client has told: the newest picture of each camera, motion, route; and the planner that it has."""

    planner: Planner
    seed: int
    cameras: dict[str, tuple[str, RemoteCamera] | None]
    lock: threading.Lock = field(default_factory=threading.Lock)
    pictures: dict[str, tuple[int, bytes]] = field(default_factory=dict)
    poses: Poses = field(default_factory=lambda: Poses(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4))))
    motion: Floats = field(default_factory=lambda: np.zeros((0, 7)))
    waypoints: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    plan: _StandingPlan | None = None
    count: int = 0


class EgodriverService:
    """Answers calls with a planner's plans; safe to call from several threads.

    ``build`` makes a planner, one for each session at the same time; ``cameras`` are our names of theirs. A planner
    that ``wants_images`` gives an empty trajectory until there is a picture of each of nuScenes' cameras.
    """

    prefix: Final = EGODRIVER

    def __init__(
        self, build: Callable[[], Planner], *, cameras: Mapping[str, str], wants_images: bool = False, seed: int = 0
    ) -> None:
        """One planner is built here, so that mistakes show at once."""
        self._build, self._renamed, self._wants_images, self._seed = build, dict(cameras), wants_images, seed
        self._free = [build()]
        self.name = self._free[0].name
        self._sessions: SessionTable[_Session] = SessionTable(self._take_back)
        self._planning = threading.Lock()
        self._calls: dict[str, Callable[[Any, Mapping[str, str]], Any]] = {
            "start_session": self._start,
            "close_session": self._close,
            "submit_image_observation": self._take_image,
            "submit_egomotion_observation": self._take_egomotion,
            "submit_route": self._take_route,
            "submit_recording_ground_truth": self._pass_over,
            "drive": self._drive,
            "get_version": self._tell_version,
        }

    def call(self, path: str, data: bytes, metadata: Mapping[str, str]) -> bytes:
        """The answer to a call, in bytes; `CallRefusedError` where there is none, `LookupError` for an unknown path."""
        name = path.removeprefix(EGODRIVER)
        call = self._calls[name]
        limits = GRPC_PICTURE if name == "submit_image_observation" else GRPC_MESSAGE
        try:
            request = decode_message(METHODS[path][0], data, limits)
        except ValueError as error:
            raise CallRefusedError("INVALID_ARGUMENT", f"{name} cannot be read: {error}") from error
        return encode_message(call(request, metadata))

    def _tell_version(self, request: Any, metadata: Mapping[str, str]) -> Any:
        return build_message(
            "VersionId", version_id=f"{self.name}-challenger-bench-{VERSION}", grpc_api_version=API_VERSION
        )

    def _start(self, request: Any, metadata: Mapping[str, str]) -> Any:
        cameras = self._read_cameras(request, body=metadata.get(CONTRACT) == "1")

        def begin() -> _Session:
            return _Session(self._free.pop() if self._free else self._build(), request.random_seed, cameras)

        session = self._sessions.add(request.session_uuid, begin)
        try:
            with self._planning:
                seed_everything(content_seed(self._seed, session.seed), session.planner)
                session.planner.reset(SceneInfo(SCENE, "", ()))
        except FAILURES as error:
            self._sessions.close(request.session_uuid)
            raise self._report("reset", error) from error
        return build_message("SessionRequestStatus")

    def _read_cameras(self, request: Any, *, body: bool) -> dict[str, tuple[str, RemoteCamera] | None]:
        """Cameras by their names, with ours, where they have one of ours."""
        declared = request.rollout_spec.vehicle.available_cameras
        if len(declared) > _MOST_CAMERAS:
            raise CallRefusedError("INVALID_ARGUMENT", f"there are more than {_MOST_CAMERAS} cameras")
        cameras: dict[str, tuple[str, RemoteCamera] | None] = {}
        for message in declared:
            theirs = message.logical_id
            ours = self._renamed.get(theirs, theirs)
            if ours not in CAMERA_NAMES or not self._wants_images:
                cameras[theirs] = None
                continue
            try:
                cameras[theirs] = ours, RemoteCamera.of(message, body=body)
            except ValueError as error:
                raise CallRefusedError("INVALID_ARGUMENT", f"camera {to_one_line(theirs, 60)!r} {error}") from error
        missing = set(CAMERA_NAMES) - {camera[0] for camera in cameras.values() if camera is not None}
        if self._wants_images and missing:
            raise CallRefusedError(
                "FAILED_PRECONDITION",
                f"{self.name} needs {', '.join(CAMERA_NAMES)}, and {min(missing)} was not declared; start the server "
                "with --cameras CAM_FRONT=NAME,... for cameras of other names",
            )
        return cameras

    def _close(self, request: Any, metadata: Mapping[str, str]) -> Any:
        self._sessions.close(request.session_uuid)
        return build_message("Empty")

    def _take_back(self, session: _Session) -> None:
        # A session that a call is in keeps its planner.
        if not session.lock.locked():
            self._free.append(session.planner)

    def _pass_over(self, request: Any, metadata: Mapping[str, str]) -> Any:
        """The recorded future is nothing that a planner may see."""
        self._sessions.find(request.session_uuid)
        return build_message("Empty")

    def _take_image(self, request: Any, metadata: Mapping[str, str]) -> Any:
        session, image = self._sessions.find(request.session_uuid), request.camera_image
        if image.logical_id not in session.cameras:
            raise CallRefusedError(
                "INVALID_ARGUMENT", f"camera {to_one_line(image.logical_id, 60)!r} was not declared in start_session"
            )
        known = session.cameras[image.logical_id]
        if known is not None:
            with session.lock:
                session.pictures[image.logical_id] = min(image.frame_end_us, 1 << 62), image.image_bytes
        return build_message("Empty")

    def _take_egomotion(self, request: Any, metadata: Mapping[str, str]) -> Any:
        session = self._sessions.find(request.session_uuid)
        poses, states = decode_trajectory(request.trajectory), request.dynamic_states
        if len(states) not in (0, len(poses)):
            raise CallRefusedError("INVALID_ARGUMENT", f"there are {len(states)} dynamic states of {len(poses)} poses")
        if not (np.isfinite(poses.position).all() and poses.are_unit):
            raise CallRefusedError("INVALID_ARGUMENT", "a pose has NaN, or a rotation that is not a unit quaternion")
        motion = np.array([_read_state(state) for state in states]).reshape(-1, 7)
        if not len(states):
            motion = np.zeros((len(poses), 7))
        with session.lock:
            held = session.poses
            for row in range(len(poses)):
                if len(held) and poses.times_us[row] <= held.times_us[-1]:
                    continue
                now = poses.at(slice(row, row + 1))
                held = Poses(*(np.concatenate(pair) for pair in zip(_columns(held), _columns(now), strict=True)))
                session.motion = np.concatenate([session.motion, motion[row : row + 1]])[-_MOST_POSES:]
            session.poses = held.at(slice(-_MOST_POSES, None))
        return build_message("Empty")

    def _take_route(self, request: Any, metadata: Mapping[str, str]) -> Any:
        session = self._sessions.find(request.session_uuid)
        points = [[point.x, point.y, point.z] for point in request.route.waypoints]
        with session.lock:
            session.waypoints = np.array(points, np.float64).reshape(-1, 3)
        return build_message("Empty")

    def _drive(self, request: Any, metadata: Mapping[str, str]) -> Any:
        session = self._sessions.find(request.session_uuid)
        with session.lock:
            place = int(np.searchsorted(session.poses.times_us, min(request.time_now_us, 1 << 62) + _JITTER_US)) - 1
            if place < 0:
                return build_message("DriveResponse")
            now_us = min(request.time_now_us, 1 << 62)
            if session.plan is None or not 0 <= now_us - session.plan.made_us < _PLAN_US - _JITTER_US:
                views = self._read_views(session)
                if views is None:
                    return build_message("DriveResponse")
                observation = _observe(session, place, now_us, views)
                session.plan = _stand(
                    self._plan(session, observation), session.poses.at(slice(place, place + 1)), now_us
                )
            trajectory = _tell_from(session.plan, session.poses.at(slice(place, place + 1)), now_us)
            return build_message("DriveResponse", trajectory=encode_trajectory(trajectory))

    def _plan(self, session: _Session, observation: Observation) -> Plan:
        try:
            with self._planning:
                # Sessions side by side draw nothing from each other.
                seed_everything(content_seed(self._seed, session.seed, session.count), session.planner)
                plan = session.planner.plan(observation)
            if not isinstance(plan, Plan):
                raise TypeError(f"answered {type(plan).__name__}, a planner must return benchmark.planning.Plan")
        except FAILURES as error:
            raise self._report("plan", error) from error
        session.count += 1
        return plan

    def _read_views(self, session: _Session) -> dict[str, CameraView] | None:
        """The newest picture of each of our cameras, drawn as a pinhole; ``None`` where one is missing that must be."""
        views: dict[str, CameraView] = {}
        for theirs, (time_us, data) in session.pictures.items():
            known = session.cameras[theirs]
            if known is None:
                continue
            name, remote = known
            try:
                camera, pixels = remote.seen(decode_image(data, tensors=False), name)
            except ValueError:
                continue
            pose = _pose_at(session.poses, time_us)
            views[name] = CameraView(camera, Path(name), time_us, pose, partial(pixels.copy))
        return None if self._wants_images and len(views) < len(CAMERA_NAMES) else views

    def _report(self, doing: str, error: BaseException) -> CallRefusedError:
        sentence = f"{self.name} failed to {doing}: {type(error).__name__}: {to_one_line(error) or 'no reason'}"
        print(sentence, file=sys.stderr, flush=True)
        return CallRefusedError("INTERNAL", sentence)


def _columns(poses: Poses) -> tuple[Any, ...]:
    return poses.times_us, poses.position, poses.rotation


def _read_state(state: Any) -> list[float]:
    """Velocity (3), acceleration (2), yaw rate, and 1 where any of it is not zero."""
    velocity, acceleration, rate = state.linear_velocity, state.linear_acceleration, state.angular_velocity.z
    row = [velocity.x, velocity.y, velocity.z, acceleration.x, acceleration.y, rate]
    row = row if np.isfinite(row).all() else [0.0] * 6
    return [*row, float(any(row))]


def _pose_at(poses: Poses, time_us: int) -> Floats:
    """(4, 4) pose of the rig at a time: the last one not later, or else the first."""
    place = max(int(np.searchsorted(poses.times_us, time_us, side="right")) - 1, 0)
    return transform_matrix(poses.rotation[place], poses.position[place])


def _observe(session: _Session, place: int, now_us: int, views: dict[str, CameraView]) -> Observation:
    """What the planner sees at a pose: the same as in `eval`, but for what the wire does not carry."""
    poses = session.poses.at(slice(place + 1))
    rotation = poses.rotation[-1] / np.linalg.norm(poses.rotation[-1])
    velocity, acceleration, rate = _derive_motion(poses, session.motion[: place + 1])
    yaw = yaw_of_quaternion(poses.rotation)
    wanted = int(poses.times_us[-1]) - _PLAN_US * np.arange(PAST_TICKS)[::-1]
    planar = [*poses.position[:, :2].T, np.unwrap(yaw)]
    past = np.column_stack([np.interp(wanted, poses.times_us, column) for column in planar])
    ego = EgoState(
        pose=np.array([*poses.position[-1, :2], float(yaw[-1])]),
        position=poses.position[-1].copy(),
        rotation=rotation,
        velocity=velocity,
        acceleration=acceleration,
        yaw_rate=rate,
        steering_angle=None,
        source="derived",
    )
    return Observation(
        scene=SCENE,
        sample_token=make_token("wire", SCENE, session.count),
        index=session.count,
        timestamp_us=now_us,
        views=views,
        lidar=_LIDAR,
        ego=ego,
        past_poses=past,
        past_valid=wanted >= int(poses.times_us[0]) - _JITTER_US,
        command=derive_command(session.waypoints, float(velocity[0])),
    )


def _derive_motion(poses: Poses, motion: Floats) -> tuple[Floats, Floats, float]:
    """Velocity (2,), acceleration (2,) and yaw rate in the rig.

    As they were sent, unless that is nothing while the car moves, or another velocity than that of the poses: AlpaSim's
    runtime sent the first ones in the local frame, and zeros in forced steps.
    """
    sent, derived = motion[-1], derive_states(poses.at(slice(-2, None)))
    velocity, speed = derived[0][-1], float(np.linalg.norm(derived[0][-1]))
    off = float(np.linalg.norm(sent[:3] - velocity))
    is_wrong = off > max(_WRONG_M_S, _WRONG_SHARE * speed) if sent[6] else speed > _MOVES_M_S
    if len(poses) < 2 or not is_wrong:
        return sent[:2].copy(), sent[3:5].copy(), float(sent[5])
    return velocity[:2].copy(), np.zeros(2), float(derived[1][-1, 2])


def _stand(plan: Plan, now: Poses, now_us: int) -> _StandingPlan:
    """A plan in the local frame, from the pose that it was made at."""
    rig = plan_to_poses(plan, LIDAR_FROM_REAR_AXLE_M)
    flat = quaternion_from_yaw(yaw_of_quaternion(now.rotation[0]))
    points = np.column_stack([rig[:, :2], np.zeros(len(rig))]) @ rotation_matrix(flat).T + now.position[0]
    times = now_us + np.round(SECOND_US * PLAN_STEP_S * np.arange(1, len(rig) + 1)).astype(np.int64)
    return _StandingPlan(now_us, times, points, float(yaw_of_quaternion(now.rotation[0])) + rig[:, 2])


def _tell_from(plan: _StandingPlan, now: Poses, now_us: int) -> Poses:
    """The part of a standing plan that is ahead, from the car's own pose now."""
    ahead = plan.times_us > now_us + _JITTER_US
    first = replace(now, times_us=np.array([now_us], np.int64))
    later = Poses(plan.times_us[ahead], plan.position[ahead], quaternion_from_yaw(plan.yaw[ahead]))
    return Poses(*(np.concatenate(pair) for pair in zip(_columns(first), _columns(later), strict=True)))
