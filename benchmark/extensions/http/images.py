"""Pictures on the wire: base64 of a file, as NeuroNCAP saves them (a tensor) or as everybody can read them (PNG)."""

import base64
import binascii
import io
from enum import StrEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.http.values import WireError
from benchmark.untrusted.files import one_line
from benchmark.untrusted.wire_images import TensorRefused, image_of

TENSOR_FLAG: Final = "--accept-torch-tensors"
"""What allows pickles, named by every refusal of one."""


class ImageFormat(StrEnum):
    """How pictures are sent."""

    TORCH = "torch"
    PNG = "png"


def image_text(pixels: NDArray[np.uint8], form: ImageFormat) -> str:
    """A (height, width, 3) RGB picture as standard base64 without line breaks.

    In the form ``torch`` it is what ``torch.save`` writes of the tensor, which is NeuroNCAP's only form.
    """
    file = io.BytesIO()
    if form is ImageFormat.TORCH:
        import torch

        # A copy: pictures from files may not be written to, of which torch warns.
        torch.save(torch.from_numpy(np.array(pixels, order="C")), file)
    else:
        from PIL import Image

        Image.fromarray(pixels).save(file, format="PNG", compress_level=1)
    return base64.b64encode(file.getvalue()).decode("ascii")


def image_from(text: str | bytes, where: str, *, tensors: bool) -> NDArray[np.uint8]:
    """(height, width, 3) RGB picture from base64 text: PNG, JPEG, an array of numpy, or a saved tensor.

    Args:
        tensors: Whether saved tensors are read, which are pickles.

    Raises:
        TensorRefused: If it is a saved tensor and those are not read.
        WireError: If it is anything else, or larger than any camera's picture.
    """
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise WireError(f"{where} is no base64 ({one_line(error, 80)})") from error
    return picture_from(data, where, tensors=tensors)


def picture_from(data: bytes, where: str, *, tensors: bool) -> NDArray[np.uint8]:
    """A picture from the bytes of a file; arguments and errors as of `image_from`."""
    try:
        found: NDArray[Any] = image_of(data, tensors=tensors)
    except TensorRefused as refused:
        raise TensorRefused(f"{where} {refused}") from refused
    except ValueError as error:
        raise WireError(f"{where} {one_line(error)}") from error
    return found
