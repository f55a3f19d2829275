"""Foreign pictures: the size that a header declares is looked at before anything is decoded."""

from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.untrusted.files import one_line, open_file
from benchmark.untrusted.limits import PICTURE, Limits

_FORMATS = ("JPEG", "PNG", "WEBP")


def read_picture(path: Path, limits: Limits = PICTURE) -> NDArray[np.uint8]:
    """Read an image file.

    Args:
        path: JPEG, PNG or WebP file.
        limits: Its bytes, and as values its pixels.

    Returns:
        (height, width, 3) RGB.

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
        (height, width, 3) RGB.

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
            return np.asarray(image.convert("RGB"), dtype=np.uint8)
    except Exception as error:
        raise ValueError(one_line(error)) from error
