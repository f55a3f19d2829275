"""Foreign pictures: the size that a header declares is looked at before anything is decoded."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.foreign.files import one_line, open_file
from benchmark.foreign.limits import PICTURE, Limits

_FORMATS = ("JPEG", "PNG", "WEBP")

Room = Callable[[tuple[int, int, int]], NDArray[np.uint8] | None]
"""Gives an array of a shape, rows one behind the other, to decode a picture into; ``None`` where there is none."""
_ROOM: ContextVar[Room | None] = ContextVar("room for pictures", default=None)


@contextmanager
def decoded_into(room: Room) -> Iterator[None]:
    """Decode pictures into memory that somebody else has, where it has some, as long as this lasts.

    Args:
        room: Is asked for every picture; where decoding fails, what it gave holds anything.
    """
    token = _ROOM.set(room)
    try:
        yield
    finally:
        _ROOM.reset(token)


def read_picture(path: Path, limits: Limits = PICTURE) -> NDArray[np.uint8]:
    """Read an image file.

    Args:
        path: JPEG, PNG or WebP file.
        limits: Its bytes, and as values its pixels.

    Returns:
        (height, width, 3) RGB, read-only.

    Raises:
        InputError: If it is missing, truncated, no image, or has more pixels than any camera gives.
    """
    if not path.exists():
        raise InputError(f"image {path} is missing; complete the data set or leave its scene out")
    with open_file(path, limits) as stream:
        try:
            return decoded_picture(stream, limits)
        except ValueError as error:
            raise InputError(f"image {path} cannot be read ({error}); fetch or make it again") from error


def decoded_picture(stream: BinaryIO, limits: Limits) -> NDArray[np.uint8]:
    """Decode a picture.

    Args:
        stream: Bytes of a JPEG, PNG or WebP file.
        limits: As values its pixels.

    Returns:
        (height, width, 3) RGB, read-only.

    Raises:
        ValueError: If it is none, truncated, or has more pixels.
    """
    from PIL import Image

    # Decoders raise whatever they come upon, from SyntaxError to what a damaged table makes of an index.
    try:
        with Image.open(stream, formats=_FORMATS) as image:
            if image.width * image.height > limits.values:
                size = f"{image.width} x {image.height} pixels are more than any camera has"
                raise ValueError(size)
            shape, room = (image.height, image.width, 3), _ROOM.get()
            given = None if room is None else room(shape)
            picture = np.empty(shape, np.uint8) if given is None else given
            with image if image.mode == "RGB" else image.convert("RGB") as coloured:
                # A file of this kind is the pixels behind a header, so that nothing is copied on the way.
                written = _Pixels(picture)
                coloured.save(cast("BinaryIO", written), "PPM")
                written.check()
    except Exception as error:
        raise ValueError(one_line(error)) from error
    picture.flags.writeable = False
    return picture


class _Pixels:
    """A file of the kind PPM whose header nobody keeps, and whose pixels are written into an array."""

    def __init__(self, picture: NDArray[np.uint8]) -> None:
        height, width, _ = picture.shape
        self._place = -len(b"P6\n%d %d\n255\n" % (width, height))
        self._pixels = picture.reshape(-1).data

    def write(self, data: bytes) -> int:
        """Go on where the last piece ended."""
        begun, self._place = self._place, self._place + len(data)
        if self._place > 0:
            self._pixels[max(begun, 0) : self._place] = memoryview(data)[max(-begun, 0) :]
        return len(data)

    def check(self) -> None:
        """Raise `ValueError` if not every pixel was written."""
        if self._place != len(self._pixels):
            raise ValueError("not all of its pixels can be decoded")
