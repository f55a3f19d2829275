"""Foreign checkpoints as tensors of PyTorch: found by the door (`untrusted.checkpoints`), mapped from the file."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmark.untrusted.checkpoint_structure import ITEM_BYTES
from benchmark.untrusted.checkpoints import StoredTensor, read_stored

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """Content of a checkpoint file.

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
        Its tensors, mapped from the file, so that an optimizer's two thirds of it are never in memory; a ``module.``
        that data-parallel training puts before all names is taken off.

    Raises:
        InputError: If the file is absent, truncated, no checkpoint, would run code, or holds something other than
            dense tensors of numbers.
    """
    stored = read_stored(path)
    wrapped = all(name.startswith("module.") for name in stored.tensors)
    shared: dict[tuple[int, str], Tensor] = {}
    tensors = {}
    for name, each in stored.tensors.items():
        key = each.storage, each.number_type
        if key not in shared:
            held = stored.storages[each.storage] if each.storage >= 0 else np.zeros(0, np.uint8)
            shared[key] = _numbers(held, each.number_type, swapped=stored.big_endian)
        tensors[name.removeprefix("module.") if wrapped else name] = _view(shared[key], each)
    return Checkpoint(tensors, stored.configuration)


def _numbers(data: NDArray[np.uint8], number_type: str, *, swapped: bool) -> "Tensor":
    """The whole of a storage as numbers of one type."""
    # The door itself needs no PyTorch.
    import torch

    item = ITEM_BYTES[number_type]
    data = data[: len(data) // item * item]
    if swapped:
        data = data.view(f"u{item}").byteswap().view(np.uint8)
    elif data.ctypes.data % item:
        data = data.copy()
    return torch.from_numpy(data).view(getattr(torch, number_type))


def _view(numbers: "Tensor", tensor: StoredTensor) -> "Tensor":
    if math.prod(tensor.shape) == 0:
        return numbers.new_empty(tensor.shape)
    return numbers.as_strided(tensor.shape, tensor.strides, tensor.offset)
