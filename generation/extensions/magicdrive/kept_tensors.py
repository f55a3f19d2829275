"""Tensors between stages of a long computation, kept so that it can go on where it was killed."""

import hashlib
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.weights.tensors import read_tensors, write_tensors

_NAME: Final = "tensor"


def keep_tensor(path: Path, key: str, tensor: Tensor, facts: dict[str, Any] | None = None) -> None:
    """Write a tensor, whole or not at all, as .safetensors.

    ``key`` is the content key of everything that the tensor depends on; ``facts`` are its plain values.
    """
    found = tensor.detach().cpu().contiguous()
    write_tensors(path, {_NAME: found}, {"facts": facts or {}, "key": key, "sha256": _sha256(found)})


def kept_tensor(path: Path, key: str) -> tuple[Tensor, dict[str, Any]] | None:
    """Read a tensor that was kept, on the processor, and its plain values.

    ``None`` if it is absent, damaged or of something else than ``key``, to be made again.
    """
    try:
        tensors, said = read_tensors(path)
    except InputError:
        return None
    tensor = tensors.get(_NAME)
    if tensor is None or said.get("key") != key or said.get("sha256") != _sha256(tensor):
        return None
    return tensor, said["facts"]


def _sha256(tensor: Tensor) -> str:
    plain = tensor.view(torch.uint8) if tensor.dtype is torch.bfloat16 else tensor
    return hashlib.sha256(plain.numpy().tobytes()).hexdigest()
