"""Foreign checkpoints and pickles, read without trust: one allow-list says what they may ask for, nothing in them runs.

Pickles of recordings and anchors hold arrays, numbers and plain containers. Checkpoints are read by PyTorch's own
weights-only unpickler, which knows tensors and plain values by itself; it takes from the list what training logs leave
beside them, numbers of numpy.
"""

import codecs
import io
import pickle
import re
import warnings
import zipfile
from collections import OrderedDict, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from benchmark.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

_REFUSED: Final = re.compile(r"(?:GLOBAL|class|type) '?([\w.]+(?:\[[\w.]+\])?)'?")


def _encode(text: str, encoding: str = "utf-8") -> bytes:
    """What pickle protocol 2 calls to rebuild bytes; other codecs than these two have no business there."""
    if encoding not in ("latin1", "utf-8"):
        raise pickle.UnpicklingError(f"encoding {encoding!r} is not allowed")
    return codecs.encode(text, encoding)


class _NumberType:
    """Stands for ``numpy.dtype``: plain numbers and texts only, whose state is nothing but a byte order.

    A number type of numpy itself, with a made-up state, reads memory that is not its own.
    """

    kinds: ClassVar = "biufcSU"
    refusal: ClassVar = "an array of {} is not allowed"

    def __init__(self, name: Any, *_: Any) -> None:
        self.dtype = np.dtype(name)
        if self.dtype.kind not in self.kinds:
            raise pickle.UnpicklingError(self.refusal.format(self.dtype))

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        self.dtype = self.dtype.newbyteorder(state[1])


class _LoggedNumberType(_NumberType):
    """The same in a checkpoint, where there is no need of texts; the refusal is worded as PyTorch words its own."""

    kinds: ClassVar = "biuf"
    refusal: ClassVar = "Unsupported class numpy.{}"


class _Array(np.ndarray[Any, Any]):
    """An array being read; `_plain` makes it an ordinary one."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        version, shape, kind, is_fortran, data = state
        if not isinstance(kind, _NumberType):
            raise pickle.UnpicklingError("an array without a type is not allowed")
        super().__setstate__((version, shape, kind.dtype, is_fortran, data))


class _ArrayType:
    """Stands for ``numpy.ndarray``, which pickles only name: calling it could claim any amount of memory."""


def _empty_array(subtype: Any, shape: tuple[int, ...], _: Any) -> Any:
    """What pickle calls to begin an array; numpy itself always asks for a flat one without elements."""
    if subtype is not _ArrayType or shape != (0,):
        raise pickle.UnpicklingError(f"an array of shape {shape} without content is not allowed")
    return _Array((0,), np.uint8)


def _array_from_buffer(buffer: bytes, kind: _NumberType, shape: tuple[int, ...], order: Any) -> Any:
    """What pickle protocol 5 calls to rebuild an array."""
    return np.frombuffer(buffer, dtype=kind.dtype).reshape(shape, order=order)


def _scalar(kind: _NumberType, data: bytes) -> Any:
    """What pickle calls to rebuild a number."""
    return np.frombuffer(data, kind.dtype, count=1)[0]


def _plain(value: Any) -> Any:
    """``value`` with ordinary arrays in its dictionaries and lists, which are changed in place."""
    if isinstance(value, _Array):
        return value.view(np.ndarray)
    seen, waiting = set(), [value]
    while waiting:
        inner = waiting.pop()
        if id(inner) in seen or not isinstance(inner, dict | list | tuple):
            continue
        seen.add(id(inner))
        places = list(inner.items() if isinstance(inner, dict) else enumerate(inner))
        waiting += [item for _, item in places]
        if not isinstance(inner, tuple):
            for place, item in places:
                if isinstance(item, _Array):
                    inner[place] = item.view(np.ndarray)
    return value


def _bytearray(*arguments: Any) -> bytearray:
    if any(isinstance(argument, int) for argument in arguments):
        raise pickle.UnpicklingError("a bytearray without content is not allowed")
    return bytearray(*arguments)


def _bytes(*arguments: Any) -> bytes:
    return bytes(_bytearray(*arguments))


_CORES: Final = ("core", "_core")
_BUILTINS: Final = ("builtins", "__builtin__")
_NUMBERS: Final[dict[tuple[str, str], Any]] = {
    ("numpy", "dtype"): _NumberType,
    **{(f"numpy.{core}.multiarray", "scalar"): _scalar for core in _CORES},
}
_ALLOWED: Final[dict[tuple[str, str], Any]] = {
    **_NUMBERS,
    ("numpy", "ndarray"): _ArrayType,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): _empty_array for core in _CORES},
    **{(f"numpy.{core}.numeric", "_frombuffer"): _array_from_buffer for core in _CORES},
    **{
        (module, kind.__name__): kind
        for module in _BUILTINS
        for kind in (dict, list, set, frozenset, tuple, int, float, bool, complex, str)
    },
    **{(module, "bytearray"): _bytearray for module in _BUILTINS},
    **{(module, "bytes"): _bytes for module in _BUILTINS},
    ("__builtin__", "long"): int,
    ("__builtin__", "unicode"): str,
    ("collections", "OrderedDict"): OrderedDict,
    ("collections", "defaultdict"): defaultdict,
    ("_codecs", "encode"): _encode,
}
"""What foreign files may ask for, by module and name, and what they get in its place."""
_ALLOWED_IN_CHECKPOINTS: Final[list[Any]] = [
    (made, ".".join(asked)) for asked, made in {**_NUMBERS, ("numpy", "dtype"): _LoggedNumberType}.items()
]
"""What of it checkpoints get beside what PyTorch itself allows: tensors, parameters, ordered dictionaries."""


class _AllowListUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED:
            raise _Refused(f"{module}.{name}")
        return _ALLOWED[module, name]


class _Refused(Exception):
    """A pickle asked for something that is not on the list; carries its name."""


def read_pickle(path: Path) -> Any:
    """Read a pickle of arrays and plain containers without trusting it.

    Args:
        path: The file.

    Returns:
        Its value.

    Raises:
        InputError: If the file is absent or broken, or asks for anything that is not on the allow-list; the message
            names what it asked for.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    try:
        return _plain(_AllowListUnpickler(io.BytesIO(data)).load())
    except _Refused as refused:
        raise InputError(
            f"{path} is refused: its pickle asks for {refused}, which is not among the arrays and containers that a "
            "recording needs and could run code; do not open this file, get the recording from a source you trust"
        ) from None
    # A malformed stream may raise anything, from EOFError to what numpy thinks of a damaged array.
    except Exception as error:
        raise InputError(
            f"{path} is not a readable pickle ({type(error).__name__}: {error}); it may be truncated, fetch it again"
        ) from error


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a file holds.

    Attributes:
        tensors: By name, in the file's order, as stored.
        configuration: The training configuration that mmcv puts into its checkpoints, or an empty text.
    """

    tensors: "dict[str, Tensor]"
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
    # Pickles of recordings are read without it.
    import torch

    in_zip = _is_sound_archive(path)
    try:
        # A foreign pickle protocol is worth a warning to PyTorch; here it either yields tensors or is refused.
        with warnings.catch_warnings(), torch.serialization.safe_globals(_ALLOWED_IN_CHECKPOINTS):
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


def _state_dict(path: Path, loaded: Any) -> "dict[str, Tensor]":
    import torch

    held = loaded.get("state_dict", loaded) if isinstance(loaded, Mapping) else None
    if not isinstance(held, Mapping) or not held:
        raise InputError(f"{path} holds a {type(loaded).__name__} without tensors by name; weights are a state dict")
    for name, tensor in held.items():
        if not isinstance(name, str) or not isinstance(tensor, torch.Tensor):
            raise InputError(
                f"{path} holds {str(name)[:80]!r}, which is no tensor with a name; weights are a state dict, or an "
                "mmcv checkpoint with one under state_dict"
            )
        if tensor.layout is not torch.strided or tensor.is_quantized or tensor.is_meta or tensor.is_complex():
            raise InputError(f"{path}: {name} is not a dense tensor of real numbers; save the weights as such")
    wrapped = all(name.startswith("module.") for name in held)
    return {name.removeprefix("module.") if wrapped else name: tensor.detach() for name, tensor in held.items()}
