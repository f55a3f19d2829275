"""Tensors between stages of a long computation, kept so that it can go on where it was killed."""

import hashlib
import json
from pathlib import Path
from typing import Any, Final

import safetensors
import safetensors.torch
import torch
from torch import Tensor

from benchmark.machine.storage import canonical_json, write_bytes

_METADATA_KEY: Final = "challenger-bench"
_NAME: Final = "tensor"


def keep_tensor(path: Path, key: str, tensor: Tensor, facts: dict[str, Any] | None = None) -> None:
    """Write a tensor, whole or not at all.

    Args:
        path: A .safetensors file.
        key: Content key of everything that the tensor depends on.
        tensor: On any device.
        facts: Plain values that belong to it.

    Raises:
        InputError: If it cannot be written.
    """
    found = tensor.detach().cpu().contiguous()
    said = canonical_json({"facts": facts or {}, "key": key, "sha256": _sha256(found)})
    # One entry, because the order of several is not fixed.
    write_bytes(path, safetensors.torch.save({_NAME: found}, {_METADATA_KEY: said}))


def kept_tensor(path: Path, key: str) -> tuple[Tensor, dict[str, Any]] | None:
    """Read a tensor that was kept.

    Args:
        path: A file of `keep_tensor`.
        key: Content key of what is being computed.

    Returns:
        The tensor, on the processor, and its plain values; ``None`` if it is absent, damaged or of something else, to
        be made again.
    """
    try:
        with safetensors.safe_open(path, framework="pt") as stream:
            said = json.loads((stream.metadata() or {}).get(_METADATA_KEY, "{}"))
            tensor = stream.get_tensor(_NAME)
    except (OSError, ValueError, safetensors.SafetensorError):
        return None
    if said.get("key") != key or said.get("sha256") != _sha256(tensor):
        return None
    return tensor, said["facts"]


def _sha256(tensor: Tensor) -> str:
    plain = tensor.view(torch.uint8) if tensor.dtype is torch.bfloat16 else tensor
    return hashlib.sha256(plain.numpy().tobytes()).hexdigest()
