"""A policy behind AlpaSim's egodriver contract: a container, or any server of it, as a planner.

One session a scene. Every pose that is known is sent, with a route along the recorded path, then ``drive`` is asked.
Nothing else of the recording is sent: no name, no future, no boxes.
"""

import contextlib
import random
import sys
import uuid
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.extensions.alpasim.answers import EgodriverAnswerError, read_answer
from benchmark.extensions.alpasim.cameras import encode_camera
from benchmark.extensions.alpasim.connection import CONTRACT, EgodriverConnection
from benchmark.extensions.alpasim.messages import build_message
from benchmark.extensions.alpasim.poses import (
    EXTENSION_M,
    SECOND_US,
    LocalFrame,
    Poses,
    build_route,
    derive_states,
    encode_states,
    encode_trajectory,
    thin_path,
)
from benchmark.geometry import Floats
from benchmark.machine.address import ALIVE_S, DEADLINE_S, RETURN_S, Address, parse_renaming
from benchmark.machine.extension import require_extra
from benchmark.planning import (
    AnswerNote,
    EgoState,
    ModelFailedError,
    Observation,
    Plan,
    PlannerGoneError,
    Ride,
    SceneInfo,
)
from benchmark.untrusted.http_images import PICTURE_FORMATS, encode_picture

CLOSE_S: Final = 5.0
PRIMED_S: Final = 1.7
"""Recorded motion at the beginning of a rollout, in AlpaSim's challenge."""


class EgodriverPlanner:
    """A policy that is asked over gRPC. ``cameras`` are its names of ours, where they differ."""

    def __init__(self, address: Address, image_format: str, deadline_s: float, cameras: Mapping[str, str]) -> None:
        """Nothing is asked yet."""
        self.name = address.name
        self.settings: dict[str, Any] = {**address.settings, "image_format": image_format, "route": "recorded path"}
        if cameras:
            self.settings["cameras"] = dict(cameras)
        self.address = address
        self._format, self._renamed = image_format, cameras
        self._connection = EgodriverConnection(address.url, "the policy", deadline_s)
        self._revision: int | None = None
        self._scene: SceneInfo | None = None
        self._session: Session | None = None
        self._ride: Ride | None = None
        self._note = AnswerNote()

    def reset(self, scene: SceneInfo) -> None:
        """End the session of the scene before; the next begins with the first plan, when its frame is known."""
        self.end_session()
        self._scene = scene

    def take_ride(self, ride: Ride) -> None:
        """Motion and path of the next plan."""
        self._ride = ride

    def take_note(self) -> AnswerNote:
        """What was peculiar in the last answer."""
        note, self._note = self._note, AnswerNote()
        return note

    def plan(self, observation: Observation) -> Plan:
        """Send what is new, then ask.

        Raises:
            InputError: If there are no pictures.
            PlannerGoneError: If there is no answer, or it is not from an egodriver service.
            PlannerLateError: If it takes too long.
            ModelFailedError: If the policy answers an error, or a trajectory that cannot be driven, which it names.
        """
        ride, self._note = self._ride, AnswerNote()
        if ride is None or int(ride.times_us[-1]) != observation.timestamp_us:
            raise ValueError("no ride was given for this sample")
        if not observation.views:
            raise InputError(
                f"scene {observation.scene} has no images at {observation.timestamp_us}; drive with --sensor "
                "schematic, or use a data set with images"
            )
        if self._session is None:
            self._session = self._start(ride, observation)
        session = self._session
        submits = [*self._encode_images(session, observation), *session.observe(ride, observation.ego)]
        self._connection.call_together(submits)
        now = session.now
        answer = self._connection.call("drive", session.encode_drive(ride.step_us))
        begun = session.describe_beginning(ride)
        try:
            plan, note = read_answer(answer, now)
        except EgodriverAnswerError as error:
            # A policy that wants no more may say nothing else.
            self._note = AnswerNote("terminate_session", True) if answer.terminate_session else AnswerNote()
            raise ModelFailedError(f"{self._who} returned a trajectory that cannot be driven: {error}") from error
        self._note = AnswerNote("; ".join(filter(None, (begun, note.text))), note.ends_drive)
        return plan

    def end_session(self) -> None:
        """Close the session, if there is one; a policy that is gone has none."""
        session, self._session = self._session, None
        if session is None:
            return
        with contextlib.suppress(PlannerGoneError, InputError, ModelFailedError):
            self._connection.call("close_session", session.encode_close(), CLOSE_S)

    def come_back(self) -> None:
        """Wait for a policy that went away (`benchmark.planning.RemotePlanner`)."""
        print(f"{self._who} is gone; waiting at most {RETURN_S:g} s for it to return", file=sys.stderr, flush=True)
        self._session = self._revision = None
        self._connection.close()
        self._connection.wait(RETURN_S)

    def require_alive(self) -> None:
        """Refuse an address at which no egodriver service listens."""
        for package in ("grpc", "google.protobuf"):
            require_extra(package, "asking over gRPC", "alpasim")
        try:
            self._connection.wait(ALIVE_S)
            self._negotiate()
        finally:
            self._connection.close()

    def _negotiate(self) -> int:
        """How the policy reads poses of cameras; a service without ``get_version`` is one all the same."""
        try:
            ((_, metadata),) = self._connection.call_together([("get_version", build_message("Empty"))], ALIVE_S)
        except (PlannerGoneError, ModelFailedError) as error:
            if "has no get_version" not in str(error):
                raise
            metadata = {}
        self._revision = 1 if metadata.get(CONTRACT) == "1" else 2
        return self._revision

    def _start(self, ride: Ride, observation: Observation) -> "Session":
        """Begin a session: an opaque name for the scene, and the cameras that there are."""
        assert self._scene is not None
        revision = self._revision or self._negotiate()
        session = Session(ride)
        cameras = [
            encode_camera(view.camera, self._renamed.get(name, name), body=revision == 1)
            for name, view in observation.views.items()
        ]
        request = build_message(
            "DriveSessionRequest",
            session_uuid=session.uuid,
            # The same scene gives the same number, so that a policy that draws repeats itself.
            random_seed=random.Random(observation.scene).getrandbits(32),
            debug_info={"scene_id": session.uuid},
            rollout_spec={"vehicle": {"available_cameras": cameras}},
        )
        self._connection.call("start_session", request, metadata=((CONTRACT, str(revision)),))
        return session

    def _encode_images(self, session: "Session", observation: Observation) -> list[tuple[str, Any]]:
        sent = []
        for name, view in observation.views.items():
            time_us = view.timestamp_us - session.frame.first_us + SECOND_US
            image = {
                "frame_start_us": time_us,
                "frame_end_us": time_us,
                "image_bytes": encode_picture(view.load(), self._format),
                "logical_id": self._renamed.get(name, name),
            }
            message = build_message("RolloutCameraImage", session_uuid=session.uuid, camera_image=image)
            sent.append(("submit_image_observation", message))
        return sent

    @property
    def _who(self) -> str:
        return f"the policy at {self.address.url}"


class Session:
    """What one session sends: poses in its frame, the route, and times."""

    def __init__(self, ride: Ride, frame: LocalFrame | None = None, extension_m: float = EXTENSION_M) -> None:
        """The frame begins at the first pose that is known; the path goes on straight for so many metres."""
        self.uuid = str(uuid.uuid4())
        self.frame = frame or LocalFrame(ride.position[0].copy(), int(ride.times_us[0]))
        self.path = thin_path(ride.path - self.frame.origin, extension_m)
        self.now = self.frame.to_local(Poses(ride.times_us[-1:], ride.position[-1:], ride.rotation[-1:]))
        self._last_us = 0
        self._drives = False

    def observe(self, ride: Ride, ego: EgoState) -> list[tuple[str, Any]]:
        """Egomotion that is new, all of it at first, and the route."""
        poses = self.frame.to_local(Poses(ride.times_us, ride.position, ride.rotation))
        velocity, rate = derive_states(poses)
        acceleration = np.zeros_like(velocity)
        velocity[-1], rate[-1] = [*ego.velocity, 0.0], [0.0, 0.0, ego.yaw_rate]
        acceleration[-1, :2] = ego.acceleration
        new = slice(int(np.searchsorted(poses.times_us, self._last_us, side="right")), None)
        self.now, self._last_us = poses.at(slice(-1, None)), int(poses.times_us[-1])
        states = encode_states(velocity[new], rate[new], acceleration[new])
        egomotion = build_message(
            "RolloutEgoTrajectory",
            session_uuid=self.uuid,
            trajectory=encode_trajectory(poses.at(new)),
            dynamic_states=states,
        )
        waypoints: Floats = build_route(self.path, self.now.position[-1], self.now.rotation[-1])
        route = {"waypoints": [dict(zip("xyz", row)) for row in waypoints.tolist()], "timestamp_us": self._last_us}
        return [
            ("submit_egomotion_observation", egomotion),
            ("submit_route", build_message("RouteRequest", session_uuid=self.uuid, route=route)),
        ]

    def describe_beginning(self, ride: Ride) -> str:
        """Once, where the car leaves its recording: how much of that there was, if less than in the challenge."""
        if self._drives or int(ride.times_us[-1]) <= ride.recorded_us:
            return ""
        self._drives = True
        primed_s = (ride.recorded_us - int(ride.times_us[0])) / SECOND_US
        return f"began with {primed_s:.1f} s of recorded motion, not {PRIMED_S} s" if primed_s < PRIMED_S else ""

    def encode_drive(self, step_us: int) -> Any:
        """The question for a plan now."""
        return build_message(
            "DriveRequest",
            session_uuid=self.uuid,
            time_now_us=self._last_us,
            time_query_us=self._last_us + step_us,
        )

    def encode_close(self) -> Any:
        """The end."""
        return build_message("DriveSessionCloseRequest", session_uuid=self.uuid)


def egodriver_planner(
    address: str, *, image_format: str = "jpeg", deadline_s: float = DEADLINE_S, remote_cameras: str = ""
) -> EgodriverPlanner:
    """The policy at ``grpc://HOST:PORT`` or ``NAME=grpc://HOST:PORT``; nothing is asked yet.

    ``image_format`` is ``jpeg`` or ``png``; ``remote_cameras`` are the policy's names of our cameras,
    ``CAM_FRONT=camera_front_wide_120fov,...``.
    """
    if image_format not in PICTURE_FORMATS:
        raise InputError(f"a policy at grpc:// is sent jpeg or png; --image-format {image_format} is for http://")
    cameras = parse_renaming(remote_cameras, "--remote-cameras")
    return EgodriverPlanner(Address.of(address, "--model", ("grpc",)), image_format, deadline_s, cameras)
