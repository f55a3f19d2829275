"""Weights of the published network, from the file as it is published."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.weights.foreign import read_checkpoint
from benchmark.weights.tensors import read_tensors
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.model import MagicDriveDiT

NULL_PROMPT: Final = "y_embedder.y_embedding"
_NOT_NEEDED: Final = re.compile(r"^pos_embed")
"""Positions are computed for the size of the video."""


def load_official(
    path: Path,
    config: MagicDriveConfig | None = None,
    *,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.bfloat16,
) -> MagicDriveDiT:
    """Build the network with published weights, ready to be asked.

    Args:
        path: ``ema.pt`` or any other file of PyTorch that holds the state dict, or the same tensors as .safetensors.
        config: Sizes of the network; the published ones by default.

    Returns:
        The network, ready to be asked. Where it rounds its inputs, the weights have been rounded to bfloat16 too,
        in any precision that they are stored in.

    Raises:
        InputError: If the file is absent, damaged, would run code, holds NaN or infinity, or other tensors than the
            network has.
    """
    config = config or MagicDriveConfig.full()
    with torch.device("meta"):
        network = MagicDriveDiT(config)
    expected = network.state_dict()
    tensors = {name: tensor for name, tensor in _read(path).items() if not _NOT_NEEDED.match(name)}
    if NULL_PROMPT in tensors:
        tensors[NULL_PROMPT] = _lengthened(tensors[NULL_PROMPT], config.text_tokens)
    _require_same(path, tensors, expected)
    state = {}
    for name in expected:
        rounded = tensors[name].to(torch.bfloat16) if config.rounded else tensors[name]
        # One at a time, so that the file's own precision is never in memory as a whole.
        state[name] = rounded.to(device, dtype, copy=True)
        if not bool(torch.isfinite(state[name]).all()):
            raise InputError(
                f"{path} holds NaN or infinity in {name}; the file is damaged or the training diverged, get another"
            )
    network.load_state_dict(state, strict=True, assign=True)
    return network.eval().requires_grad_(False)


def _read(path: Path) -> Mapping[str, Tensor]:
    if path.suffix != ".safetensors":
        return read_checkpoint(path).tensors
    return read_tensors(path, instead="fetch them again")[0]


def _lengthened(prompt: Tensor, tokens: int) -> Tensor:
    """A shorter null prompt goes on with its last token, as the published loader has it."""
    if prompt.ndim != 2 or not 0 < len(prompt) < tokens:
        return prompt
    return torch.cat([prompt, prompt[-1:].expand(tokens - len(prompt), -1)])


def _require_same(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    shared = [name for name in expected if name in tensors]
    kinds = (
        ([name for name in expected if name not in tensors], "missing"),
        ([name for name in tensors if name not in expected], "too many"),
        ([name for name in shared if tensors[name].shape != expected[name].shape], "of another shape"),
        ([name for name in shared if not tensors[name].is_floating_point()], "without fractions"),
    )
    differences = "; ".join(f"{len(names)} {what} (first: {names[0]})" for names, what in kinds if names)
    if differences:
        raise InputError(
            f"{path} does not hold the weights of MagicDriveDiT: of its tensors, {differences}; get ema.pt of "
            "flymin/MagicDriveDiT-stage3-40k-ft"
        )
