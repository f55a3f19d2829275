"""Request of ``/infer``: one observation over HTTP. Keys, their order and their shapes are NeuroNCAP's."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Self

from benchmark.extensions.http.values import (
    NeuroncapHttpError,
    parse_matrix,
    parse_pose,
    parse_whole_number,
    read_member,
)
from benchmark.geometry import Floats
from benchmark.untrusted.files import HTTP_REQUEST, Limits, to_one_line
from benchmark.untrusted.text_files import parse_json

CAMERAS: Final = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
"""In the order of the wire, which is not that of our tables."""
CANBUS: Final = 16
"""Position 3, rotation w x y z, acceleration 3, rotation rate 3, velocity 3."""
_LATEST_US: Final = 1 << 53
_COMMANDS: Final = 2
"""0 right, 1 left, 2 straight."""
_BODY: Final = "the request"


@dataclass(frozen=True, slots=True)
class InferRequest:
    """One observation as the wire has it.

    Attributes:
        images: Text of each of the six cameras: base64 of a file (`benchmark.extensions.http.values`).
        ego2world: (4, 4) pose of the rear axle; `camera2ego` and `lidar2ego` are alike.
        canbus: (16,) see `CANBUS`.
        timestamp: Microseconds.
        command: 0 right, 1 left, 2 straight.
        camera2image: (3, 3) pinhole matrix of each camera, pixels.
    """

    images: Mapping[str, str]
    ego2world: Floats
    canbus: Floats
    timestamp: int
    command: int
    camera2image: Mapping[str, Floats]
    camera2ego: Mapping[str, Floats]
    lidar2ego: Floats

    def encoded(self) -> bytes:
        """The body, as Python's ``json`` writes it."""
        return encode_json(
            {
                "images": dict(self.images),
                "ego2world": self.ego2world.tolist(),
                "canbus": self.canbus.tolist(),
                "timestamp": self.timestamp,
                "command": self.command,
                "calibration": {
                    "camera2image": {name: matrix.tolist() for name, matrix in self.camera2image.items()},
                    "camera2ego": {name: matrix.tolist() for name, matrix in self.camera2ego.items()},
                    "lidar2ego": self.lidar2ego.tolist(),
                },
            }
        )

    @classmethod
    def read(cls, body: bytes) -> Self:
        """Read a posted body; its images stay texts, and members that the protocol does not have are passed over."""
        value = parse_body(body, HTTP_REQUEST, _BODY)
        images, calibration = read_member(value, "images", _BODY), read_member(value, "calibration", _BODY)
        inside, outside = (read_member(calibration, name, "calibration") for name in ("camera2image", "camera2ego"))
        texts = {name: read_member(images, name, "images") for name in CAMERAS}
        for name, text in texts.items():
            if not isinstance(text, str):
                raise NeuroncapHttpError(f"images.{name} is {type(text).__name__}, not base64 text")
        return cls(
            images=texts,
            ego2world=parse_pose(read_member(value, "ego2world", _BODY), "ego2world"),
            canbus=parse_matrix(read_member(value, "canbus", _BODY), (CANBUS,), "canbus"),
            timestamp=parse_whole_number(read_member(value, "timestamp", _BODY), _LATEST_US, "timestamp"),
            command=parse_whole_number(read_member(value, "command", _BODY), _COMMANDS, "command"),
            camera2image={name: _parse_pinhole(inside, name) for name in CAMERAS},
            camera2ego={
                name: parse_pose(read_member(outside, name, "camera2ego"), f"calibration.camera2ego.{name}")
                for name in CAMERAS
            },
            lidar2ego=parse_pose(read_member(calibration, "lidar2ego", "calibration"), "calibration.lidar2ego"),
        )


def encode_json(value: Any) -> bytes:
    """JSON as Python's ``json`` writes it, with spaces; raises `ValueError` for NaN and infinity."""
    return json.dumps(value, allow_nan=False).encode()


def parse_body(body: bytes, limits: Limits, what: str) -> Any:
    """The JSON value of a body within limits."""
    try:
        return parse_json(body, limits)
    except ValueError as error:
        raise NeuroncapHttpError(f"{what} is not valid JSON ({to_one_line(error, 120)})") from error


def _parse_pinhole(matrices: Any, name: str) -> Floats:
    where = f"calibration.camera2image.{name}"
    matrix = parse_matrix(read_member(matrices, name, "camera2image"), (3, 3), where)
    if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0 or matrix[2].tolist() != [0.0, 0.0, 1.0]:
        raise NeuroncapHttpError(f"{where} is not a pinhole matrix (focal lengths above zero, last row 0 0 1)")
    return matrix
