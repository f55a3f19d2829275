"""Served planner without a socket: requests in, answers out, one scene at a time (``docs/extensions/http.md``).

The protocol names neither client nor scene. A ``/reset`` begins a scene; an ``/infer`` whose time does not increase
belongs to another scene, and is refused rather than put into the planner's memory.
"""

import sys
from collections import deque
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.observation_builder import PAST_TICKS
from benchmark.closed_loop.simulation_state import build_can_row
from benchmark.errors import InputError
from benchmark.extensions.http.answers import ModelAnswer
from benchmark.extensions.http.requests import CAMERAS, InferRequest, encode_json
from benchmark.extensions.http.values import (
    TENSOR_FLAG,
    HttpImageFormat,
    NeuroncapHttpError,
    decode_image_text,
    encode_image,
)
from benchmark.geometry import Floats, quaternion_of, transform_matrix, yaw_of_quaternion
from benchmark.machine.storage import make_token
from benchmark.planning import (
    CameraView,
    Command,
    EgoState,
    Observation,
    Plan,
    Planner,
    SceneInfo,
)
from benchmark.runs.plan_rows import FAILURES, seed_everything
from benchmark.scene import Camera, LidarMount
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.http_images import TensorRefusedError

_POSITION, _ROTATION, _ACCELERATION, _RATE, _VELOCITY = (
    slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13), slice(13, 16),
)  # fmt: skip
"""Of the row ``canbus``."""
_SAME: Final = 1e-12
SCENE: Final = "over-http"
"""Name of every scene received over HTTP, where requests carry no name. It is constant, so that a planner that seeds by
the name of its scene does not depend on earlier requests."""


def build_request(observation: Observation, form: HttpImageFormat) -> InferRequest:
    """Request of an observation with all six cameras, in its own double precision.

    The engine `neuroncap@code` gives single precision, as the published code does.
    """
    views = {name: observation.views[name] for name in CAMERAS if name in observation.views}
    missing = [name for name in CAMERAS if name not in views]
    if missing:
        raise InputError(
            f"scene {observation.scene} has no {missing[0]} image at {observation.timestamp_us}; NeuroNCAP's requests "
            f"carry {', '.join(CAMERAS)}; drive with --sensor schematic, or use a data set with these cameras"
        )
    ego, lidar = observation.ego, observation.lidar
    velocity, acceleration, rate = build_can_row(ego).reshape(3, 3)
    return InferRequest(
        images={name: encode_image(view.load(), form) for name, view in views.items()},
        ego2world=transform_matrix(ego.rotation, ego.position),
        canbus=np.concatenate([ego.position, ego.rotation, acceleration, rate, velocity]),
        timestamp=observation.timestamp_us,
        command=int(observation.command),
        camera2image={name: view.camera.intrinsic for name, view in views.items()},
        camera2ego={name: compute_camera_pose(view.camera) for name, view in views.items()},
        lidar2ego=transform_matrix(lidar.rotation, lidar.translation),
    )


def compute_camera_pose(camera: Camera) -> Floats:
    """(4, 4) camera frame (x right, y down, z forward) to ego frame."""
    return transform_matrix(camera.rotation, camera.translation)


class ObservationHistory:
    """Number, times and places of samples since the reset, which the wire does not carry and a planner wants."""

    def __init__(self) -> None:
        self.last_us: int | None = None
        self._index = 0
        self._poses: deque[Floats] = deque(maxlen=PAST_TICKS)

    def observation(self, request: InferRequest, *, tensors: bool) -> Observation:
        """Observation of a request, remembered as one more sample unless a picture cannot be read."""
        pictures = {
            name: decode_image_text(text, f"images.{name}", tensors=tensors) for name, text in request.images.items()
        }
        ego = read_ego_state(request)
        index, self._index, self.last_us = self._index, self._index + 1, request.timestamp
        self._poses.append(ego.pose)
        unknown = PAST_TICKS - len(self._poses)
        return Observation(
            scene=SCENE,
            sample_token=make_token("wire", SCENE, index),
            index=index,
            timestamp_us=request.timestamp,
            views={name: _build_view(request, name, pixels) for name, pixels in pictures.items()},
            lidar=LidarMount(request.lidar2ego[:3, 3].copy(), quaternion_of(request.lidar2ego[:3, :3])),
            ego=ego,
            past_poses=np.array([*[self._poses[0]] * unknown, *self._poses]),
            past_valid=np.arange(PAST_TICKS) >= unknown,
            command=Command(request.command),
        )


def read_ego_state(request: InferRequest) -> EgoState:
    """The car's motion; the angle of the steering wheel is not on the wire."""
    row, position = request.canbus, request.ego2world[:3, 3].copy()
    rotation = _compute_rotation(request)
    motion = np.concatenate([row[_VELOCITY], row[_ACCELERATION], row[_RATE]])
    return EgoState(
        pose=np.array([position[0], position[1], float(yaw_of_quaternion(rotation))]),
        position=position,
        rotation=rotation,
        velocity=motion[0:2].copy(),
        acceleration=motion[3:5].copy(),
        yaw_rate=float(motion[8]),
        steering_angle=None,
        source="can_bus",
        can_motion=motion,
        # Requests hold no later times.
        can_motion_after=motion.copy(),
    )


def _compute_rotation(request: InferRequest) -> Floats:
    """The pose's rotation; of the two quaternions that mean the same, the one that the CAN row has.

    Networks were trained on the scalar part of the data set's own quaternions; a matrix does not keep its sign.
    """
    computed, reported = quaternion_of(request.ego2world[:3, :3]), request.canbus[_ROTATION]
    alike = float(computed @ reported)
    if abs(float(reported @ reported) - 1.0) < _SAME and abs(abs(alike) - 1.0) < _SAME:
        return reported.copy()
    return -computed if alike < 0.0 else computed


def _build_view(request: InferRequest, name: str, pixels: NDArray[np.uint8]) -> CameraView:
    pose = request.camera2ego[name]
    height, width = pixels.shape[:2]
    return CameraView(
        camera=Camera(
            name, pose[:3, 3].copy(), quaternion_of(pose[:3, :3]), request.camera2image[name].copy(), width, height
        ),
        path=Path(name),
        timestamp_us=request.timestamp,
        global_T_ego=request.ego2world.copy(),
        load=partial(_copy_writable, pixels),
    )


def _copy_writable(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture that its reader may change."""
    return pixels.copy()


UNSUPPORTED, UNREADABLE, CONFLICT, FAILED = 415, 422, 409, 500
"""Statuses of HTTP."""


class PlanRequestError(Exception):
    """A request that is not answered with a plan: an HTTP status, and a sentence for the client.

    ``kind`` tells refusals of one status apart.
    """

    def __init__(self, status: int, sentence: str, kind: str = "") -> None:
        super().__init__(sentence)
        self.status = status
        self.kind = kind


class PlannerSession:
    """One planner and the scene that it is in. Nothing here is safe to call from two threads at once."""

    def __init__(self, planner: Planner, *, tensors: bool = False, seed: int = 0) -> None:
        """Wrap a new planner that wants no more than the wire carries; each reset seeds global generators."""
        self.planner = planner
        self._tensors = tensors
        self._seed = seed
        self._memory = ObservationHistory()
        self._begun = False

    def reset(self) -> bytes:
        """Begin a scene, always, and give the body of the answer; `PlanRequestError` if the planner fails in it."""
        self._memory = ObservationHistory()
        self._begun = False
        try:
            self._begin()
        except FAILURES as error:
            raise self._report_failure("reset", error) from error
        return encode_json(True)

    def infer(self, body: bytes) -> bytes:
        """Answer one posted observation; `PlanRequestError` if unreadable, out of order, or if the planner fails."""
        try:
            request = InferRequest.read(body)
            self._require_later(request.timestamp)
            observation = self._memory.observation(request, tensors=self._tensors)
        except TensorRefusedError as refused:
            raise PlanRequestError(
                UNSUPPORTED,
                f"{refused}; send PNG or JPEG, or start the server with {TENSOR_FLAG} if you trust its clients",
                kind="saved tensors",
            ) from refused
        except NeuroncapHttpError as error:
            raise PlanRequestError(UNREADABLE, str(error)) from error
        try:
            if not self._begun:
                self._begin()
            plan = self.planner.plan(observation)
            if not isinstance(plan, Plan):
                raise TypeError(f"answered {type(plan).__name__}, a planner must return benchmark.planning.Plan")
            return ModelAnswer.of_plan(plan, float(request.lidar2ego[0, 3])).encoded()
        except FAILURES as error:
            raise self._report_failure("plan", error) from error

    def _begin(self) -> None:
        # As in `eval`: global random generators start each scene from the same seed.
        seed_everything(self._seed, self.planner)
        self.planner.reset(SceneInfo(SCENE, "", ()))
        self._begun = True

    def _require_later(self, timestamp: int) -> None:
        last = self._memory.last_us
        if last is not None and timestamp <= last:
            raise PlanRequestError(
                CONFLICT,
                f"timestamp {timestamp} is not after {last}, the last one received: this server handles one scene "
                "at a time; post /reset before another scene, and send no request twice",
            )

    def _report_failure(self, doing: str, error: BaseException) -> PlanRequestError:
        """The planner's failure in a sentence, here and for the client."""
        sentence = f"{self.planner.name} failed to {doing}: {type(error).__name__}: {to_one_line(error) or 'no reason'}"
        print(sentence, file=sys.stderr, flush=True)
        return PlanRequestError(FAILED, sentence)
