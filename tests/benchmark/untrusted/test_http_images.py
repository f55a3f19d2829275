"""The door for pictures from the wire: every kind that is read, and everything else refused before it costs much."""

import io
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from benchmark.untrusted.files import HTTP_PICTURE
from benchmark.untrusted.http_images import TensorRefusedError, decode_image
from tests.benchmark.untrusted.mutations import BYTES

PIXELS = np.random.default_rng(0).integers(0, 255, (6, 8, 3), dtype=np.uint8)


def file_of(form: str) -> bytes:
    file = io.BytesIO()
    Image.fromarray(PIXELS).save(file, format=form)
    return file.getvalue()


def array_of(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def tensor_of(value: Any, *, zipped: bool = True) -> bytes:
    file = io.BytesIO()
    torch.save(value, file, _use_new_zipfile_serialization=zipped)
    return file.getvalue()


SAVED = tensor_of(torch.from_numpy(PIXELS))


class Running:
    """Runs something when it is unpickled."""

    def __reduce__(self) -> Any:
        import os

        return os.system, ("touch /tmp/never-made",)


def repacked(change: Callable[[str, bytes], bytes], kind: int = zipfile.ZIP_STORED) -> bytes:
    """A saved tensor with other members."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(SAVED)) as source, zipfile.ZipFile(file, "w", kind) as target:
        for name in source.namelist():
            target.writestr(name, change(name, source.read(name)))
    return file.getvalue()


def with_pickle(pickled: bytes) -> bytes:
    return repacked(lambda name, data: pickled if name.endswith("data.pkl") else data)


@pytest.mark.parametrize("data", [file_of("PNG"), array_of(PIXELS), SAVED], ids=["png", "npy", "tensor"])
def test_pictures_come_back_to_the_last_bit(data: bytes) -> None:
    found = decode_image(data, tensors=True)
    assert found.dtype == np.uint8 and (found == PIXELS).all()


def test_jpeg_and_grey_pictures_are_read() -> None:
    assert decode_image(file_of("JPEG"), tensors=False).shape == (6, 8, 3)
    file = io.BytesIO()
    Image.fromarray(PIXELS[..., 0]).save(file, format="PNG")
    assert (decode_image(file.getvalue(), tensors=False) == PIXELS[..., :1]).all()


@pytest.mark.parametrize("data", [SAVED, tensor_of(torch.zeros(3), zipped=False), pickle.dumps([1])])
def test_a_saved_tensor_is_refused_unless_it_was_allowed(data: bytes) -> None:
    with pytest.raises(TensorRefusedError, match="pickle"):
        decode_image(data, tensors=False)


HOSTILE: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "not a readable picture"),
    "text": (b"hello", "not a readable picture"),
    "a cut picture": (file_of("PNG")[:60], "not a readable picture"),
    "a gif": (file_of("GIF"), "not a readable picture"),
    "many bytes": (bytes(HTTP_PICTURE.file_bytes + 1), "at most 48 MB"),
    "an array of floats": (array_of(PIXELS.astype(float)), "not of uint8"),
    "an array of objects": (array_of(np.array([[[Running()]]], dtype=object)), "not of uint8"),
    "columns first": (array_of(np.asfortranarray(PIXELS)), "row by row"),
    "a flat array": (array_of(PIXELS.ravel()), "shape"),
    "an empty array": (array_of(PIXELS[:0]), "shape"),
    "a cut array": (array_of(PIXELS)[:-1], "143 bytes"),
    "an array that claims more": (array_of(PIXELS).replace(b"(6, 8, 3), }   ", b"(4000, 4000, 3)"), "header|bytes"),
    "an array without end": (b"\x93NUMPY\x01\x00\xff\xff{", "header"),
    "an old tensor": (tensor_of(torch.from_numpy(PIXELS), zipped=False), "old form"),
    "a bare pickle": (pickle.dumps(Running()), "old form"),
    "a saved list": (tensor_of([torch.from_numpy(PIXELS)]), "is not a dense tensor"),
    "saved floats": (tensor_of(torch.zeros(2, 2, 3)), "uses torch FloatStorage"),
    "a saved module": (tensor_of(torch.nn.Linear(1, 1)), "uses"),
    "a tensor of another shape": (tensor_of(torch.zeros(3, 6, 8, dtype=torch.uint8)), "shape 3 x 6 x 8"),
    "a tensor that repeats itself": (
        tensor_of(torch.zeros(1, 1, 3, dtype=torch.uint8).expand(9, 9, 3)),
        "more numbers",
    ),
    "a pickle that runs": (with_pickle(pickle.dumps(Running(), protocol=2)), "uses"),
    "a pickle that makes up names": (with_pickle(pickle.dumps(Running(), protocol=4)), "uses STACK_GLOBAL"),
    "a pickle that is none": (with_pickle(b"\x80\x02}"), "not a saved picture tensor"),
    "a long pickle": (with_pickle(b"\x80\x02" + b"N0" * 5000 + b"N."), "not a saved picture tensor"),
    "packed members": (repacked(lambda _, data: data, zipfile.ZIP_DEFLATED), "not a saved picture tensor"),
    "large members": (
        repacked(lambda name, data: bytes(HTTP_PICTURE.file_bytes // 2) if "data/0" in name else data, 8),
        "not a saved picture tensor",
    ),
    "a cut archive": (SAVED[:-30], "not a saved picture tensor"),
    "changed numbers": (SAVED.replace(PIXELS.tobytes()[:20], bytes(20)), "not a saved picture tensor"),
    "an archive of something": (
        repacked(lambda _, data: data).replace(b"data.pkl", b"datb.pkl"),
        "not a saved picture tensor",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_everything_else_is_refused(name: str) -> None:
    data, says = HOSTILE[name]
    with pytest.raises(ValueError, match=says):
        decode_image(data, tensors=True)


def test_more_pixels_than_any_camera_has_are_not_decoded() -> None:
    few = replace(HTTP_PICTURE, values=40)
    for data in (file_of("PNG"), array_of(PIXELS), SAVED):
        with pytest.raises(ValueError, match="pixels"):
            decode_image(data, tensors=True, limits=few)


def test_nothing_but_a_refusal_comes_of_damage_by_chance() -> None:
    chance = Random(7)
    for whole in (SAVED, file_of("PNG"), file_of("JPEG"), array_of(PIXELS)):
        for _ in range(25):
            try:
                found = decode_image(chance.choice(BYTES).change(whole, chance), tensors=True)
            except ValueError:
                continue
            assert found.dtype == np.uint8 and found.ndim == 3
