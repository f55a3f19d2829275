"""Foreign ``.pth`` files by PyTorch's weights-only unpickler and an allow-list: tensors and plain values, no code."""

import pickle
import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from benchmark.errors import InputError

_REFUSED: Final = re.compile(r"(?:GLOBAL|class|type) '?([\w.]+(?:\[[\w.]+\])?)'?")
_PLAIN_NUMBERS: Final = "biuf"


class _NumberType:
    """Stands for ``numpy.dtype`` in the numbers that training logs leave in ``meta``; its state is a byte order.

    A number type of numpy itself, with a made-up state, reads memory that is not its own.
    """

    def __init__(self, name: Any, *_: Any) -> None:
        self.dtype = np.dtype(name)
        if self.dtype.kind not in _PLAIN_NUMBERS:
            raise pickle.UnpicklingError(f"Unsupported class numpy.{self.dtype}")

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.dtype = self.dtype.newbyteorder(state[1])


def _number(kind: _NumberType, data: bytes) -> Any:
    """What numpy's pickles call to rebuild a number."""
    return np.frombuffer(data, kind.dtype, count=1)[0].item()


_ALLOWED: Final[list[Any]] = [
    (_NumberType, "numpy.dtype"),
    (_number, "numpy.core.multiarray.scalar"),
    (_number, "numpy._core.multiarray.scalar"),
]
"""Beside what PyTorch itself allows: tensors, parameters, ordered dictionaries, plain values."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a file holds.

    Attributes:
        tensors: By name, in the file's order, as stored.
        configuration: The training configuration that mmcv puts into its checkpoints, or an empty text.
    """

    tensors: dict[str, Tensor]
    configuration: str


def read_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint without trusting it.

    Args:
        path: An mmcv checkpoint (``{meta, state_dict, optimizer}``) or a bare state dict, of any PyTorch version.

    Returns:
        Its tensors; a ``module.`` that data-parallel training puts before all names is taken off.

    Raises:
        InputError: If the file is absent, truncated, no checkpoint, would run code, or holds something other than
            dense tensors of numbers.
    """
    in_zip = _is_sound_archive(path)
    try:
        # A foreign pickle protocol is worth a warning to PyTorch; here it either yields tensors or is refused.
        with warnings.catch_warnings(), torch.serialization.safe_globals(_ALLOWED):
            warnings.simplefilter("ignore", UserWarning)
            # Mapped, the optimizer's two thirds of the file are never read.
            loaded = torch.load(path, map_location="cpu", weights_only=True, mmap=in_zip)
    except pickle.UnpicklingError as error:
        raise _refusal(path, error) from error
    # A damaged stream may raise anything, from EOFError to MemoryError for a size that it makes up.
    except Exception as error:
        raise InputError(
            f"{path} cannot be read as a PyTorch checkpoint ({type(error).__name__}); it is damaged or something else, "
            "fetch it again"
        ) from error
    meta = loaded.get("meta") if isinstance(loaded, Mapping) else None
    configuration = meta.get("config") if isinstance(meta, Mapping) else None
    return Checkpoint(_state_dict(path, loaded), configuration if isinstance(configuration, str) else "")


def _is_sound_archive(path: Path) -> bool:
    """Whether the file is a zip archive as PyTorch writes them; refuses what is obviously no checkpoint at all."""
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            start = stream.read(512)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    if not size:
        raise InputError(f"{path} is empty; fetch it again")
    if start.lstrip()[:1] == b"<":
        raise InputError(
            f"{path} is a web page, not a checkpoint: the server answered with something to click on; open the address "
            "in a browser and save the file itself"
        )
    if not start.startswith(b"PK"):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _require_stored(path, entries, size)
            broken = archive.testzip()
    # A damaged directory may make any number up, encryption included.
    except (zipfile.BadZipFile, OSError, EOFError, ValueError, RuntimeError, NotImplementedError) as error:
        raise InputError(f"{path} is truncated or damaged ({error}); fetch it again") from error
    if broken is not None:
        raise InputError(f"{path} is damaged ({broken} fails its checksum); fetch it again")
    return True


def _require_stored(path: Path, entries: list[zipfile.ZipInfo], size: int) -> None:
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries) or sum(e.file_size for e in entries) > size:
        raise InputError(
            f"{path} claims to hold more bytes than it has, which no file written by PyTorch does; get it from a "
            "source that you trust"
        )


def _refusal(path: Path, error: Exception) -> InputError:
    # What PyTorch says goes on with advice to load the file unsafely, so only the name is passed on.
    found = _REFUSED.search(str(error))
    if found is None:
        return InputError(
            f"{path} is not a checkpoint that can be read without running code in it; it is damaged or something else, "
            "fetch it again"
        )
    return InputError(
        f"{path} is refused: it asks for {found[1]}, which is not among the tensors and plain values that weights need "
        "and could run code; get it from a source that you trust, or save its state_dict alone in the environment "
        "that made it"
    )


def _state_dict(path: Path, loaded: Any) -> dict[str, Tensor]:
    held = loaded.get("state_dict", loaded) if isinstance(loaded, Mapping) else None
    if not isinstance(held, Mapping) or not held:
        raise InputError(f"{path} holds a {type(loaded).__name__} without tensors by name; weights are a state dict")
    for name, tensor in held.items():
        if not isinstance(name, str) or not isinstance(tensor, Tensor):
            raise InputError(
                f"{path} holds {str(name)[:80]!r}, which is no tensor with a name; weights are a state dict, or an "
                "mmcv checkpoint with one under state_dict"
            )
        if tensor.layout is not torch.strided or tensor.is_quantized or tensor.is_meta or tensor.is_complex():
            raise InputError(f"{path}: {name} is not a dense tensor of real numbers; save the weights as such")
    wrapped = all(name.startswith("module.") for name in held)
    return {name.removeprefix("module.") if wrapped else name: tensor.detach() for name, tensor in held.items()}
