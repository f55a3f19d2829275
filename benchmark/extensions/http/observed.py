"""From observations to requests and back. What the wire loses on the way is listed in ``docs/extensions/http.md``."""

from collections import deque
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.observing import PAST_TICKS
from benchmark.closed_loop.riding import can_row
from benchmark.errors import InputError
from benchmark.extensions.http.images import ImageFormat, image_from, image_text
from benchmark.extensions.http.requests import CAMERAS, InferRequest
from benchmark.geometry import Floats, quaternion_of, transform_matrix, yaw_of_quaternion
from benchmark.machine.storage import token
from benchmark.planning import CameraView, Command, EgoState, Observation
from benchmark.scene import Camera, LidarMount

_POSITION, _ROTATION, _ACCELERATION, _RATE, _VELOCITY = (
    slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13), slice(13, 16),
)  # fmt: skip
"""Of the row ``canbus``."""
_SAME: Final = 1e-12
SCENE: Final = "over-http"
"""What a scene from the wire is called, since the wire does not say: always the same, so that what a planner draws by
the name of its scene does not depend on how often somebody has asked before."""


def request_of(observation: Observation, form: ImageFormat) -> InferRequest:
    """An observation with all six cameras as a request.

    Its numbers are those of the observation in double precision. The engine `neuroncap@code` gives single ones, as the
    published code does.
    """
    views = {name: observation.views[name] for name in CAMERAS if name in observation.views}
    missing = [name for name in CAMERAS if name not in views]
    if missing:
        raise InputError(
            f"scene {observation.scene} shows no {missing[0]} at {observation.timestamp_us}, and NeuroNCAP's requests "
            f"carry {', '.join(CAMERAS)}; drive with --sensor schematic, or take a data set with these cameras"
        )
    ego, lidar = observation.ego, observation.lidar
    velocity, acceleration, rate = can_row(ego).reshape(3, 3)
    return InferRequest(
        images={name: image_text(view.load(), form) for name, view in views.items()},
        ego2world=transform_matrix(ego.rotation, ego.position),
        canbus=np.concatenate([ego.position, ego.rotation, acceleration, rate, velocity]),
        timestamp=observation.timestamp_us,
        command=int(observation.command),
        camera2image={name: view.camera.intrinsic for name, view in views.items()},
        camera2ego={name: camera_pose(view.camera) for name, view in views.items()},
        lidar2ego=transform_matrix(lidar.rotation, lidar.translation),
    )


def camera_pose(camera: Camera) -> Floats:
    """(4, 4) camera frame (x right, y down, z forward) to ego frame."""
    return transform_matrix(camera.rotation, camera.translation)


class Memory:
    """Number, times and places of samples since the reset, which the wire does not carry and a planner wants."""

    def __init__(self) -> None:
        self.last_us: int | None = None
        self._index = 0
        self._poses: deque[Floats] = deque(maxlen=PAST_TICKS)

    def observation(self, request: InferRequest, *, tensors: bool) -> Observation:
        """Observation of a request, remembered as one more sample; its pictures are decoded, without files behind them.

        Raises:
            WireError: If a picture cannot be read; then nothing is remembered.
        """
        pictures = {name: image_from(text, f"images.{name}", tensors=tensors) for name, text in request.images.items()}
        ego = ego_of(request)
        index, self._index, self.last_us = self._index, self._index + 1, request.timestamp
        self._poses.append(ego.pose)
        unknown = PAST_TICKS - len(self._poses)
        return Observation(
            scene=SCENE,
            sample_token=token("wire", SCENE, index),
            index=index,
            timestamp_us=request.timestamp,
            views={name: _view(request, name, pixels) for name, pixels in pictures.items()},
            lidar=LidarMount(request.lidar2ego[:3, 3].copy(), quaternion_of(request.lidar2ego[:3, :3])),
            ego=ego,
            past_poses=np.array([*[self._poses[0]] * unknown, *self._poses]),
            past_valid=np.arange(PAST_TICKS) >= unknown,
            command=Command(request.command),
        )


def ego_of(request: InferRequest) -> EgoState:
    """The car's motion; the angle of the steering wheel is not on the wire."""
    row, position = request.canbus, request.ego2world[:3, 3].copy()
    rotation = _rotation(request)
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
        # Nothing later is on the wire.
        can_motion_after=motion.copy(),
    )


def _rotation(request: InferRequest) -> Floats:
    """The pose's rotation; of the two quaternions that mean the same, the one that the CAN row has.

    Networks were trained on the scalar part of the data set's own quaternions, whose sign a matrix does not keep.
    """
    found, said = quaternion_of(request.ego2world[:3, :3]), request.canbus[_ROTATION]
    alike = float(found @ said)
    if abs(float(said @ said) - 1.0) < _SAME and abs(abs(alike) - 1.0) < _SAME:
        return said.copy()
    return -found if alike < 0.0 else found


def _view(request: InferRequest, name: str, pixels: NDArray[np.uint8]) -> CameraView:
    pose = request.camera2ego[name]
    height, width = pixels.shape[:2]
    return CameraView(
        camera=Camera(
            name, pose[:3, 3].copy(), quaternion_of(pose[:3, :3]), request.camera2image[name].copy(), width, height
        ),
        path=Path(name),
        timestamp_us=request.timestamp,
        global_T_ego=request.ego2world.copy(),
        load=partial(_copy, pixels),
    )


def _copy(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A picture that its reader may change."""
    return pixels.copy()
