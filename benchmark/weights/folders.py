"""Weights that are kept as they come: folders of published files, and foreign checkpoints as mapped tensors.

Models that other libraries load (transformers, diffusers) want a folder with a configuration beside the tensors. It
lies in the cache under ``weights/hub/NAME``, or wherever the user says. Nothing in such a folder is a pickle unless
its entry names one, and who reads that reads it without running anything in it.
"""

import hashlib
import math
import shutil
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, lock_folder, writing_to
from benchmark.machine.workspace import weights_root
from benchmark.untrusted.checkpoint_structure import ITEM_BYTES
from benchmark.untrusted.checkpoints import TensorLocation, read_stored
from benchmark.weights.catalogue import FOLDERS, PublishedWeights
from benchmark.weights.fetch import fetch_files, require_published
from benchmark.weights.tensor_names import choose_tensors

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, slots=True)
class UntrustedCheckpoint:
    """Content of a checkpoint: tensors in the file's order, and mmcv's training configuration, or an empty text.

    `note` says which copy of the weights the tensors are, where the file has averaged ones.
    """

    tensors: "dict[str, Tensor]"
    configuration: str
    note: str = ""


def read_checkpoint(path: Path) -> UntrustedCheckpoint:
    """Read, untrusted, a checkpoint with a state dict among its entries, or a bare one, of any PyTorch.

    Tensors are mapped from the file, so that an optimizer's two thirds of it are never in memory; what data-parallel
    training, Lightning and `torch.compile` put before all names is taken off, and averaged weights are taken where
    there are some (`benchmark.weights.tensor_names`). Refused is what is truncated, would run code, or holds something
    other than dense tensors of numbers.
    """
    stored = read_stored(path)
    chosen = choose_tensors(stored.tensors)
    shared: dict[tuple[int, str], Tensor] = {}
    tensors = {}
    for name, place in chosen.names.items():
        location = stored.tensors[place]
        key = location.storage, location.number_type
        if key not in shared:
            data = stored.storages[location.storage] if location.storage >= 0 else np.zeros(0, np.uint8)
            shared[key] = _numbers(data, location.number_type, swapped=stored.big_endian)
        tensors[name] = _view(shared[key], location)
    return UntrustedCheckpoint(tensors, stored.configuration, chosen.note or stored.note)


def _numbers(data: NDArray[np.uint8], number_type: str, *, swapped: bool) -> "Tensor":
    # Reading untrusted files needs no PyTorch.
    import torch

    item = ITEM_BYTES[number_type]
    data = data[: len(data) // item * item]
    if swapped:
        data = data.view(f"u{item}").byteswap().view(np.uint8)
    elif data.ctypes.data % item:
        data = data.copy()
    return torch.from_numpy(data).view(getattr(torch, number_type))


def _view(numbers: "Tensor", tensor: TensorLocation) -> "Tensor":
    if math.prod(tensor.shape) == 0:
        return numbers.new_empty(tensor.shape)
    return numbers.as_strided(tensor.shape, tensor.strides, tensor.offset)


_READ_WHOLE_BYTES: Final = 1 << 22
_BLOCK_BYTES: Final = 1 << 18
_BLOCKS: Final = 16


def find_hub_folder(cache: Path | None = None) -> Path:
    """Folder of all folders of weights, by default in the user's cache; it need not exist."""
    return (cache or weights_root()) / "hub"


def list_missing_files(folder: Path, weights: PublishedWeights) -> tuple[str, ...]:
    """Names of the files of published weights that a folder lacks."""
    return tuple(file.name for file in weights.files if not (folder / file.name).is_file())


def find_cached_folder(weights: PublishedWeights, cache: Path | None = None) -> Path | None:
    """Where weights lie in the cache; ``None`` if they are not there, or not all of them."""
    place = find_hub_folder(cache) / weights.name
    return None if list_missing_files(place, weights) else place


def require_folder_of(weights: PublishedWeights, given: Path | None, cache: Path | None = None) -> Path:
    """Folder in which weights lie, with every file that is needed; else a sentence on what to get, where and how.

    ``given`` may hold it under its name here or in the hub; ``None`` for the cache.
    """
    places = [find_hub_folder(cache) / weights.name]
    if given is not None:
        places = [given / weights.name, given / PurePosixPath(weights.repository).name, given]
    for place in places:
        if not list_missing_files(place, weights):
            return place
    started = next((place for place in places if any((place / file.name).is_file() for file in weights.files)), None)
    lacks = "" if started is None else f" ({started} lacks {', '.join(list_missing_files(started, weights))})"
    where = "" if given is None else f" in {given}"
    raise InputError(
        f"no weights {weights.name} found{where}{lacks}, which {weights.used_by} needs; get {weights.names} "
        f"({weights.size_text}) from {weights.address} and run: challenger-bench weights import FOLDER --model "
        f"{weights.name}, or on a machine with internet: challenger-bench weights fetch {weights.name}"
    )


def fetch_folder(weights: PublishedWeights, cache: Path | None = None) -> Path:
    """Fetch weights into the cache, their folder whole or not at all; the same command goes on where it broke off."""
    target = find_hub_folder(cache) / weights.name
    if not list_missing_files(target, weights):
        return target
    folder = find_hub_folder(cache) / f".fetching-{weights.name}"
    with lock_folder(folder):
        fetch_files(weights, folder)
        _put_in_place(folder, target)
    return target


def import_folder(weights: PublishedWeights, path: Path, cache: Path | None = None) -> Path:
    """Copy weights that the user has into the cache, checked as far as anything is known of them.

    The path is their folder; where they are one file, that file is enough.
    """
    source = path.parent if path.is_file() and [path.name] == [file.name for file in weights.files] else path
    if not source.is_dir():
        raise InputError(f"{path} does not exist; give the folder that holds {weights.names}")
    missing = list_missing_files(source, weights)
    if missing:
        raise InputError(f"{source} lacks {', '.join(missing)} of {weights.name}; get them from {weights.address}")
    target, folder = find_hub_folder(cache) / weights.name, find_hub_folder(cache) / f".importing-{weights.name}"
    if target.is_dir() and target.resolve() == source.resolve():
        raise InputError(f"{source} is already the stored copy of {weights.name}; nothing to import")
    for file in weights.files:
        require_published(weights, file, source / file.name)
    with lock_folder(folder):
        for file in weights.files:
            with writing_to(folder / file.name):
                (folder / file.name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(source / file.name, folder / file.name)
        _put_in_place(folder, target)
    return target


def recognise_weights(
    path: Path, name: str | None, entries: tuple[PublishedWeights, ...] = FOLDERS
) -> PublishedWeights | None:
    """Weights that a user means, or ``None`` if these are others than folders of published files.

    The path is a folder, or the one file of some weights; without a name, names of folder and files tell. A folder that
    does not tell which weights it holds is refused.
    """
    if name is not None:
        return next((entry for entry in entries if entry.name == name), None)
    if path.is_file():
        return next((entry for entry in entries if [file.name for file in entry.files] == [path.name]), None)
    if not path.is_dir():
        return None
    named = [entry for entry in entries if path.name in (entry.name, PurePosixPath(entry.repository).name)]
    if len(named) != 1:
        known = ", ".join(entry.name for entry in entries)
        raise InputError(f"cannot tell which weights {path} holds; give --model, one of {known}")
    return named[0]


def compute_content_hash(weights: PublishedWeights, folder: Path) -> str:
    """A hash for records that tells weights apart without reading gigabytes, 64 hexadecimal digits.

    It is of names, sizes, small files whole, and of large ones sixteen blocks of 256 KiB spread evenly from the first
    byte to the last.
    """
    digest = hashlib.sha256()
    for file in sorted(weights.files, key=lambda file: file.name):
        path = folder / file.name
        try:
            size = path.stat().st_size
            digest.update(canonical_json([file.name, size]).encode())
            with path.open("rb") as stream:
                if size <= _READ_WHOLE_BYTES:
                    digest.update(stream.read())
                    continue
                for block in range(_BLOCKS):
                    stream.seek((size - _BLOCK_BYTES) * block // (_BLOCKS - 1))
                    digest.update(stream.read(_BLOCK_BYTES))
        except OSError as error:
            raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    return digest.hexdigest()


def _put_in_place(folder: Path, target: Path) -> None:
    """A folder becomes the kept one; the old one goes only when the new one is complete."""
    old = target.with_name(f".old-{target.name}")
    with writing_to(target):
        shutil.rmtree(old, ignore_errors=True)
        if target.exists():
            target.replace(old)
        folder.replace(target)
        shutil.rmtree(old, ignore_errors=True)
