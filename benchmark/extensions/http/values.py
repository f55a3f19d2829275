"""Numbers and pictures from the wire: shape and finiteness checked, no truth values; base64 of tensors or PNG."""

import base64
import binascii
import io
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.untrusted.files import to_one_line
from benchmark.untrusted.http_images import TensorRefusedError, decode_image, encode_picture

FARTHEST_M: Final = 1e8
"""Of a position; maps end long before."""
_ROTATION_TOLERANCE: Final = 1e-3
"""Calibrations are single precision at times."""


class NeuroncapHttpError(Exception):
    """A message over the wire breaks the protocol; the sentence says how, and where."""


def parse_numbers(value: Any, where: str) -> Floats:
    """Array of any rectangular nesting of lists of numbers from JSON; NaN and infinity stay."""
    _require_numbers(value, where)
    try:
        return np.array(value, np.float64)
    except (ValueError, OverflowError, TypeError) as error:
        raise NeuroncapHttpError(f"{where} is not a rectangular list of numbers ({to_one_line(error, 80)})") from error


def parse_matrix(value: Any, shape: tuple[int, ...], where: str) -> Floats:
    """Finite numbers of one shape."""
    matrix = parse_numbers(value, where)
    if matrix.shape != shape:
        raise NeuroncapHttpError(f"{where} has the shape {_format_shape(matrix.shape)}, not {_format_shape(shape)}")
    if not np.isfinite(matrix).all():
        raise NeuroncapHttpError(f"{where} contains NaN or infinity")
    return matrix


def parse_pose(value: Any, where: str) -> Floats:
    """(4, 4) rigid motion; refused with another last row, no rotation, or farther away than any map."""
    pose = parse_matrix(value, (4, 4), where)
    turn = pose[:3, :3]
    # Only numbers that cannot overflow are multiplied.
    sound = np.abs(turn).max() < 2.0 and np.abs(turn @ turn.T - np.eye(3)).max() < _ROTATION_TOLERANCE
    if not sound or np.linalg.det(turn) < 0.0 or np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > _ROTATION_TOLERANCE:
        raise NeuroncapHttpError(f"{where} is not a pose (rotation and translation in three rows, then 0 0 0 1)")
    if np.abs(pose[:3, 3]).max() > FARTHEST_M:
        raise NeuroncapHttpError(f"{where} is {np.abs(pose[:3, 3]).max():.3g} m away")
    return pose


def parse_whole_number(value: Any, most: int, where: str) -> int:
    """A whole number from 0 on; raises `NeuroncapHttpError` for anything else."""
    if type(value) is not int or not 0 <= value <= most:
        raise NeuroncapHttpError(f"{where} must be a whole number from 0 to {most}, not {to_one_line(repr(value), 40)}")
    return value


def read_member(value: Any, name: str, where: str) -> Any:
    """A member of an object; raises `NeuroncapHttpError` if there is none."""
    if not isinstance(value, dict):
        raise NeuroncapHttpError(f"{where} is not a JSON object")
    if name not in value:
        raise NeuroncapHttpError(f"{where} has no {name}")
    return value[name]


def _require_numbers(value: Any, where: str) -> None:
    """Only lists and numbers: what numpy would make numbers of texts and truth values for is refused."""
    waiting = [value]
    while waiting:
        item = waiting.pop()
        if type(item) is list:
            waiting += item
        elif type(item) not in (int, float):
            raise NeuroncapHttpError(f"{where} holds {to_one_line(repr(item), 40)}, which is not a number")


def _format_shape(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape)) or "a single number"


TENSOR_FLAG: Final = "--accept-torch-tensors"
"""Option that allows pickles; every refusal of one names it."""


class HttpImageFormat(StrEnum):
    """How pictures are sent."""

    TORCH = "torch"
    PNG = "png"


AUTO: Final = "auto"
"""Instead of a form: each in its order, until a model answers with a plan."""


def encode_image(pixels: NDArray[np.uint8], form: HttpImageFormat) -> str:
    """(height, width, 3) RGB as base64 in one line; ``torch`` is NeuroNCAP's form, a ``torch.save`` of the tensor."""
    if form is HttpImageFormat.PNG:
        return base64.b64encode(encode_picture(pixels, form)).decode("ascii")
    import torch

    file = io.BytesIO()
    # A copy: arrays from files are read-only, and torch warns of that.
    torch.save(torch.from_numpy(np.array(pixels, order="C")), file)
    return base64.b64encode(file.getvalue()).decode("ascii")


def decode_image_text(text: str | bytes, where: str, *, tensors: bool) -> NDArray[np.uint8]:
    """(height, width, 3) RGB from base64: PNG, JPEG, a numpy array, or, if ``tensors`` (pickles) are read, one."""
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise NeuroncapHttpError(f"{where} is not base64 ({to_one_line(error, 80)})") from error
    return decode_image_file(data, where, tensors=tensors)


def decode_image_file(data: bytes, where: str, *, tensors: bool) -> NDArray[np.uint8]:
    """A picture from the bytes of a file; arguments and errors as of `decode_image_text`."""
    try:
        picture: NDArray[Any] = decode_image(data, tensors=tensors)
    except TensorRefusedError as refused:
        raise TensorRefusedError(f"{where} {refused}") from refused
    except ValueError as error:
        raise NeuroncapHttpError(f"{where} {to_one_line(error)}") from error
    return picture
