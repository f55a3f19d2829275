"""Sensor over HTTP: closed-loop states drawn by a renderer for NeuroNCAP (NeuRAD's server or a compatible one).

A renderer shows one recorded scene with the actors it knows, at positions sent at every planning instant, because other
road users may react; no future positions are sent.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.extensions.http.connection import HttpConnection, HttpReply
from benchmark.extensions.http.requests import CAMERAS, encode_json, parse_body
from benchmark.extensions.http.session import compute_camera_pose
from benchmark.extensions.http.values import (
    FARTHEST_M,
    TENSOR_FLAG,
    HttpImageFormat,
    NeuroncapHttpError,
    decode_image_file,
    decode_image_text,
    parse_matrix,
    parse_numbers,
    read_member,
)
from benchmark.geometry import Floats, quaternion_from_yaw, transform_matrix
from benchmark.machine.address import ALIVE_S, Address
from benchmark.planning import CameraView, PlannerGoneError, PlannerLateError
from benchmark.scene import Camera, Scene
from benchmark.untrusted.files import HTTP_ANSWER
from benchmark.untrusted.http_images import TensorRefusedError

_BODY: Final = "the answer of /get_actors"
_LONGEST_ID: Final = 200
_MOST_ACTORS: Final = 5000


@dataclass(frozen=True, slots=True)
class RendererActor:
    """Actor that a renderer can show elsewhere than recorded: (T,) microseconds, (T, 4, 4) box centre to global.

    `dims` are (3,) width, length, height.
    """

    uuid: str
    timestamps: NDArray[np.int64]
    poses: Floats
    dims: Floats

    @classmethod
    def read(cls, value: Any, where: str) -> Self:
        """Read one."""
        uuid = read_member(value, "uuid", where)
        if not isinstance(uuid, str) or not 0 < len(uuid) <= _LONGEST_ID:
            raise NeuroncapHttpError(f"{where}.uuid is not a string of 1 to {_LONGEST_ID} characters")
        times = read_member(value, "timestamps", where)
        if (
            not isinstance(times, list)
            or not times
            or not all(type(timestamp) is int and abs(timestamp) < 1 << 53 for timestamp in times)
        ):
            raise NeuroncapHttpError(f"{where}.timestamps is not a list of whole microseconds")
        poses = parse_numbers(read_member(value, "poses", where), f"{where}.poses")
        if poses.shape != (len(times), 4, 4) or not np.isfinite(poses).all() or np.abs(poses).max() > FARTHEST_M:
            raise NeuroncapHttpError(f"{where}.poses does not hold a 4 x 4 pose for each of {len(times)} timestamps")
        return cls(
            uuid,
            np.array(times, np.int64),
            poses,
            parse_matrix(read_member(value, "dims", where), (3,), f"{where}.dims"),
        )


@dataclass(frozen=True, slots=True)
class MovedActor:
    """Actor and where it is to be shown, as in `RendererActor`; the target threatens the ego."""

    timestamps: NDArray[np.int64]
    poses: Floats
    dims: Floats
    uuid: str
    is_target: bool


def parse_actors(body: bytes) -> tuple[RendererActor, ...]:
    """Actors of an answer to ``/get_actors``."""
    value = parse_body(body, HTTP_ANSWER, _BODY)
    if not isinstance(value, list) or len(value) > _MOST_ACTORS:
        raise NeuroncapHttpError(f"{_BODY} is not a list of at most {_MOST_ACTORS} actors")
    return tuple(RendererActor.read(actor, f"actor {number}") for number, actor in enumerate(value))


def encode_moved_actors(actors: Iterable[MovedActor]) -> bytes:
    """The body of ``/update_actors``."""
    return encode_json(
        [
            {
                "timestamps": actor.timestamps.tolist(),
                "poses": actor.poses.tolist(),
                "dims": actor.dims.tolist(),
                "uuid": actor.uuid,
                "is_target_actor": actor.is_target,
            }
            for actor in actors
        ]
    )


def encode_image_request(pose: Floats, timestamp: int, camera: str, image_format: str | None = None) -> bytes:
    """Body of ``/render_image``: (4, 4) global camera pose, microseconds; only NeuRAD's server knows ``png``."""
    more = {} if image_format is None else {"image_format": image_format}
    return encode_json({"pose": pose.tolist(), "timestamp": timestamp, "camera_name": camera, **more})


DEADLINE_S: Final = 120.0
"""Of one request."""
_AHEAD_US: Final = 500_000
"""Extrapolation of tracks past now: renderers need a further step, and the true future is not sent."""
_OTHER_SCENE_US: Final = 1_000_000
_BASE64: Final = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/")
_LEAST_ERROR: Final = 400


@dataclass(frozen=True, slots=True)
class HttpSensor:
    """A renderer's server; with saved ``tensors`` it is asked exactly as NeuroNCAP asks, else for PNG."""

    address: Address
    tensors: bool = False
    deadline_s: float = DEADLINE_S

    @property
    def name(self) -> str:
        """Part of the name of what was measured."""
        return self.address.name

    @property
    def facts(self) -> Mapping[str, Any]:
        """Known facts about its pictures: the protocol has neither a name nor a version of the renderer."""
        form = HttpImageFormat.TORCH if self.tensors else HttpImageFormat.PNG
        return {"protocol": "neuroncap", "image_format": form.value, **self.address.settings}

    def require_alive(self) -> None:
        """Refuse an address where no server answers; raises `InputError`."""
        _ask_renderer(lambda: self._connection.get("/alive", ALIVE_S))

    def look(self, scene: Scene) -> "HttpCameraViews":
        """Make ready for a scene, which has to be the one that the renderer shows."""
        cameras = {camera.name: camera for camera in scene.cameras}
        missing = [name for name in CAMERAS if name not in cameras]
        if missing:
            raise InputError(
                f"scene {scene.name} has no {missing[0]}, and a renderer for NeuroNCAP needs "
                f"{', '.join(CAMERAS)}; use a data set with these cameras, calibrated"
            )
        answer = self.asked("/get_actors")
        try:
            known = {actor.uuid: actor for actor in parse_actors(answer)}
        except NeuroncapHttpError as error:
            raise _build_error(self.address, f"{error}") from error
        self._require_same(scene, known)
        return HttpCameraViews(self, tuple(cameras[name] for name in CAMERAS), scene.adversaries, frozenset(known))

    def asked(self, path: str, body: bytes | None = None) -> bytes:
        """Bytes that the renderer answers; JSON is posted if given. Errors and web pages are refused.

        Unlike with plans, an error cannot hold what was asked for.
        """
        reply = _ask_renderer(lambda: self._connection.get(path) if body is None else self._connection.post(path, body))
        if reply.status >= _LEAST_ERROR or reply.is_page:
            page = ", a web page" if reply.is_page else f": {reply.said}"
            raise _build_error(self.address, f"it answers {path} with status {reply.status}{page}")
        return reply.body

    @property
    def _connection(self) -> HttpConnection:
        return HttpConnection(self.address.url, "the renderer", self.deadline_s)

    def _require_same(self, scene: Scene, known: Mapping[str, RendererActor]) -> None:
        """Refuse a renderer that shows another scene, or cannot show who threatens the ego in this one."""
        strange = sorted(set(known) - set(scene.agents.ids))
        if strange:
            raise _build_error(
                self.address,
                f"it shows actor {strange[0]}, which scene {scene.name} lacks; select the scene that it shows with "
                "--scenes",
            )
        first, last = int(scene.timestamps_us[0]) - _OTHER_SCENE_US, int(scene.timestamps_us[-1]) + _OTHER_SCENE_US
        for actor in known.values():
            if actor.timestamps[-1] < first or actor.timestamps[0] > last:
                raise _build_error(
                    self.address,
                    f"its actor {actor.uuid} exists from {actor.timestamps[0]} to {actor.timestamps[-1]} us, outside "
                    f"scene {scene.name}; select the scene that it shows with --scenes",
                )
        unknown = [name for name in scene.adversaries if name not in known]
        if unknown:
            raise _build_error(
                self.address,
                f"it does not know {unknown[0]}, the adversary of scene {scene.name}, and would leave it out; "
                "drive scenes whose adversaries it knows",
            )


@dataclass(frozen=True, slots=True)
class HttpCameraViews:
    """A scene that a renderer shows: its rig in the order of the wire, and the actors that the renderer can move."""

    sensor: HttpSensor
    cameras: tuple[Camera, ...]
    adversaries: tuple[str, ...]
    known: frozenset[str]

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """Pictures of the last frame, which is now: all known actors are placed, then six cameras look."""
        now = len(driven.timestamps_us) - 1
        time_us = int(driven.timestamps_us[now])
        self.sensor.asked(
            "/update_actors", encode_moved_actors(build_moved_actors(driven, self.known, self.adversaries))
        )
        pose = transform_matrix(driven.ego.rotation[now], driven.ego.position[now])
        return {camera.name: self._view(camera, pose, time_us) for camera in self.cameras}

    def _view(self, camera: Camera, pose: Floats, time_us: int) -> CameraView:
        form = None if self.sensor.tensors else HttpImageFormat.PNG.value
        body = encode_image_request(pose @ compute_camera_pose(camera), time_us, camera.name, form)
        pixels = self._picture(self.sensor.asked("/render_image", body), camera.name)
        if pixels.shape[:2] != (camera.height, camera.width):
            raise _build_error(
                self.sensor.address,
                f"its picture of {camera.name} has {pixels.shape[1]} x {pixels.shape[0]} pixels, but the calibration "
                f"is for {camera.width} x {camera.height}; set it to that size",
            )
        return CameraView(camera, Path(camera.name), time_us, pose.copy(), partial(_copy_writable, pixels))

    def _picture(self, body: bytes, camera: str) -> NDArray[np.uint8]:
        """A picture: bare base64 of a file, as NeuroNCAP has it, or the file itself."""
        tensors, address = self.sensor.tensors, self.sensor.address
        try:
            if body[:16] and set(body[:16]) <= _BASE64:
                return decode_image_text(body, f"the picture of {camera}", tensors=tensors)
            return decode_image_file(body, f"the picture of {camera}", tensors=tensors)
        except TensorRefusedError as refused:
            raise _build_error(address, f"{refused}; add {TENSOR_FLAG} if you trust it") from refused
        except NeuroncapHttpError as error:
            raise _build_error(address, str(error)) from error


def build_moved_actors(driven: Scene, known: frozenset[str], adversaries: tuple[str, ...]) -> list[MovedActor]:
    """Known actors where they are, up to now (the last frame), and half a second on as they went last; in scene order.

    An absent actor is left out, and so vanishes from the renderer's pictures.
    """
    agents, placed_actors = driven.agents, []
    for row, uuid in enumerate(agents.ids):
        if uuid not in known or not agents.valid[row, -1]:
            continue
        # The last stretch without a gap; earlier frames are not sent.
        gaps = np.flatnonzero(~agents.valid[row])
        frames = slice(int(gaps[-1]) + 1 if len(gaps) else 0, None)
        times, places, yaws = driven.timestamps_us[frames], agents.position[row, frames], agents.yaw[row, frames]
        step = places[-1] - places[-2] if len(times) > 1 else np.zeros(3)
        share = _AHEAD_US / int(times[-1] - times[-2]) if len(times) > 1 else 0.0
        poses = [
            transform_matrix(quaternion_from_yaw(yaw), place)
            for yaw, place in zip([*yaws, yaws[-1]], [*places, places[-1] + share * step], strict=True)
        ]
        length, width, height = agents.size[row].tolist()
        placed_actors.append(
            MovedActor(
                timestamps=np.append(times, times[-1] + _AHEAD_US),
                poses=np.array(poses),
                dims=np.array([width, length, height]),
                uuid=uuid,
                is_target=uuid in adversaries,
            )
        )
    return placed_actors


def _ask_renderer(ask: Callable[[], HttpReply]) -> HttpReply:
    """An answer; a renderer that is away is no planner that went away."""
    try:
        return ask()
    except (PlannerGoneError, PlannerLateError) as error:
        raise InputError(str(error)) from error


def _build_error(address: Address, mismatch: str) -> InputError:
    return InputError(f"the renderer at {address.url} does not fit: {mismatch}")


def _copy_writable(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture that its reader may change."""
    return pixels.copy()
