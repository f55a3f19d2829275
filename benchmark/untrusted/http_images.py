"""Foreign pictures, also those that came over a wire: told by their first bytes, bounded before they are decoded.

PNG and JPEG are decoded as everywhere; an array of numpy (``.npy``, ``uint8``) is nothing but numbers behind a short
header. A saved tensor of PyTorch is a zip archive with a pickle in it. It is read only where that was allowed, after
the archive and every name in the pickle were looked at, and then with ``weights_only=True``.
"""

import io
import pickletools
import zipfile
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.untrusted.files import HTTP_PICTURE, PICTURE, Limits, format_bytes, open_file, to_one_line

_FORMATS = ("JPEG", "PNG", "WEBP")
PICTURE_FORMATS: Final = ("jpeg", "png")
"""In which pictures are sent as files."""
_JPEG_QUALITY: Final = 95


def encode_picture(pixels: NDArray[np.uint8], form: str) -> bytes:
    """(height, width, 3) RGB as a file, ``png`` or ``jpeg``."""
    from PIL import Image

    stream = io.BytesIO()
    options = {"compress_level": 1} if form == "png" else {"quality": _JPEG_QUALITY}
    Image.fromarray(pixels).save(stream, format=form, **options)
    return stream.getvalue()


def read_picture(path: Path, limits: Limits = PICTURE) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of a JPEG, PNG or WebP file; limits are its bytes, and as values its pixels."""
    if not path.exists():
        raise InputError(f"image {path} is missing; complete the data set or leave its scene out")
    with open_file(path, limits) as stream:
        try:
            return decode_picture(stream, limits)
        except ValueError as error:
            raise InputError(f"image {path} cannot be read ({error}); fetch or make it again") from error


def decode_picture(stream: BinaryIO, limits: Limits) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of JPEG, PNG or WebP bytes; a `ValueError` if they are none, truncated, or too large."""
    from PIL import Image

    # Decoders raise many kinds of exceptions, from SyntaxError to IndexError on a damaged table.
    try:
        with Image.open(stream, formats=_FORMATS) as image:
            if image.width * image.height > limits.values:
                size = f"{image.width} x {image.height} pixels are more than any camera has"
                raise ValueError(size)
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except Exception as error:
        raise ValueError(to_one_line(error)) from error


_ARRAY: Final = b"\x93NUMPY"
_ARCHIVE: Final = b"PK\x03\x04"
_OLD_TENSOR: Final = b"\x80"
_HEADER_BYTES: Final = 4096
_PICKLE_BYTES: Final = 4096
_MOST_MEMBERS: Final = 16
_COLOURS: Final = 3
_NAMES: Final = frozenset({"torch._utils _rebuild_tensor_v2", "torch ByteStorage", "collections OrderedDict"})
"""All that a saved tensor of bytes asks for."""


class TensorRefusedError(ValueError):
    """It is a saved tensor, and those are not read here."""


def decode_image(data: bytes, *, tensors: bool, limits: Limits = HTTP_PICTURE) -> NDArray[np.uint8]:
    """(height, width, 3) RGB of a PNG, JPEG or WebP file, an array of numpy, or a saved tensor.

    Raises `TensorRefusedError` for a saved tensor unless `tensors` is set, `ValueError` for anything else that is no
    such picture, in words that fit behind "the picture".
    """
    if len(data) > limits.file_bytes:
        raise ValueError(f"has {format_bytes(len(data))}, but a picture has at most {format_bytes(limits.file_bytes)}")
    if data.startswith((_ARCHIVE, _OLD_TENSOR)):
        if not tensors:
            raise TensorRefusedError("is a saved tensor of PyTorch, which is a pickle")
        return _tensor(data, limits)
    if data.startswith(_ARRAY):
        return _array(data, limits)
    try:
        return decode_picture(io.BytesIO(data), limits)
    except ValueError as error:
        raise ValueError(f"is not a readable picture ({error})") from error


def _array(data: bytes, limits: Limits) -> NDArray[np.uint8]:
    stream = io.BytesIO(data[:_HEADER_BYTES])
    try:
        version = npy.read_magic(stream)  # type: ignore[no-untyped-call]
        if version != (1, 0):
            raise ValueError(f"format {version}")
        header = npy.read_array_header_1_0(stream)  # type: ignore[no-untyped-call]
    # The header is a Python literal, which may be anything.
    except Exception as error:
        raise ValueError("is an array of numpy whose header cannot be read") from error
    shape, columns_first, dtype = header
    if dtype != np.uint8 or columns_first:
        raise ValueError(f"is an array of {dtype}, not of uint8 row by row")
    _require_size(shape, limits)
    pixels = np.frombuffer(data, np.uint8, offset=stream.tell())
    if pixels.size != shape[0] * shape[1] * _COLOURS:
        raise ValueError(f"is an array of {shape[0]} x {shape[1]} x {_COLOURS} with {pixels.size} bytes")
    return pixels.reshape(shape)


def _tensor(data: bytes, limits: Limits) -> NDArray[np.uint8]:
    import torch

    _require_sound_archive(data, limits)
    # Damage that these checks miss raises an error of the library.
    try:
        tensor: Any = torch.load(io.BytesIO(data), weights_only=True, map_location="cpu")
    except Exception as error:
        raise ValueError("is a saved tensor that cannot be read") from error
    if not isinstance(tensor, torch.Tensor) or tensor.dtype != torch.uint8 or tensor.layout is not torch.strided:
        raise ValueError("is saved by PyTorch, but is not a dense tensor of bytes")
    _require_size(tuple(tensor.shape), limits)
    if tensor.device.type != "cpu" or tensor.untyped_storage().nbytes() < tensor.numel():
        raise ValueError("is a saved tensor that claims more numbers than it has")
    return np.asarray(tensor.contiguous().numpy(), np.uint8)


def _require_sound_archive(data: bytes, limits: Limits) -> None:
    """Nothing packed, nothing large, and a pickle that asks for nothing but a tensor of bytes."""
    if not data.startswith(_ARCHIVE):
        raise ValueError("is a tensor in PyTorch's old form; save it with PyTorch 1.6 or later")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = archive.infolist()
            if len(members) > _MOST_MEMBERS or any(member.compress_type != zipfile.ZIP_STORED for member in members):
                raise ValueError("packed or many members")
            if sum(member.file_size for member in members) > limits.file_bytes:
                raise ValueError("large members")
            pickles = [member for member in members if member.filename.endswith("data.pkl")]
            if len(pickles) != 1 or pickles[0].file_size > _PICKLE_BYTES:
                raise ValueError("no short pickle")
            requested = _names(archive.read(pickles[0]))
            if damaged := archive.testzip():
                raise ValueError(f"{damaged} fails its checksum")
    # The archive and the pickle are untrusted, and the library raises many kinds of exceptions.
    except Exception as error:
        raise ValueError("is an archive, but not a saved picture tensor") from error
    if not requested <= _NAMES:
        raise ValueError(f"is a saved tensor that uses {min(requested - _NAMES)}, which no picture needs")


def _names(pickled: bytes) -> set[str]:
    """Names in a pickle, without running it; tensors need no names that are assembled at run time."""
    names = set()
    for operation, argument, _ in pickletools.genops(pickled):
        if operation.name == "GLOBAL":
            names.add(str(argument))
        elif operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            names.add(operation.name)
    return names


def _require_size(shape: tuple[int, ...], limits: Limits) -> None:
    if len(shape) != 3 or shape[2] != _COLOURS or min(shape) < 1:
        raise ValueError(f"has the shape {' x '.join(map(str, shape))}, not height x width x {_COLOURS}")
    if shape[0] * shape[1] > limits.values:
        raise ValueError(f"has {shape[0]} x {shape[1]} pixels, more than any camera")
