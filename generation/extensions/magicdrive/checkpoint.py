"""Weights of the published network, and the video decoder of CogVideoX, one view at a time (section 10)."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, Self

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.weights.folders import read_checkpoint
from benchmark.weights.pretrained import OptionalLibrary
from benchmark.weights.tensors import read_tensors
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.model import MagicDriveDiT

DIFFUSERS: Final = OptionalLibrary("diffusers", extra="render", needed_by="the renderer magicdrive")


class VideoDecoder:
    """Decodes two latent frames at a time and remembers what the next ones need, so that a video of any length fits."""

    def __init__(self, network: Any, device: torch.device) -> None:
        """Take a network that is there, ``AutoencoderKLCogVideoX`` of diffusers."""
        self._network, self._device = network.to(device).eval(), device

    @classmethod
    def load(cls, folder: Path, device: torch.device, dtype: torch.dtype) -> Self:
        """Load a decoder from a folder with configuration and weights; needs diffusers."""
        # Without the package accelerate, weights can only be loaded the plain way.
        network = DIFFUSERS.load("AutoencoderKLCogVideoX", folder, dtype=dtype, low_cpu_mem_usage=False)
        return cls(network, device)

    @torch.no_grad()
    def frames(self, latent: Tensor) -> Tensor:
        """(T, 8h, 8w, 3) uint8 on the processor, from one (16, t, h, w) view of unit spread; refused unless finite.

        T is 4t, or 4t - 3 where t is odd.
        """
        scaled = latent[None].to(self._device, self._network.dtype) / self._network.config.scaling_factor
        pictures = self._network.decode(scaled).sample[0]
        if not bool(torch.isfinite(pictures).all()):
            raise InputError(
                "the video decoder gives NaN or infinity; its weights may be damaged, get cogvideox-vae again "
                "(challenger-bench weights list)"
            )
        levels = ((pictures.float() + 1) * 127.5).round().clamp(0, 255).to(torch.uint8)
        video: Tensor = levels.permute(1, 2, 3, 0).contiguous().cpu()
        return video


NULL_PROMPT: Final = "y_embedder.y_embedding"
_NOT_NEEDED: Final = re.compile(r"^pos_embed")
"""Positions are computed for the size of the video."""


def load_published_network(
    path: Path,
    config: MagicDriveConfig | None = None,
    *,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.bfloat16,
) -> MagicDriveDiT:
    """Build the network with published weights, ready to be asked.

    The file is ``ema.pt`` or any other of PyTorch that holds the state dict, or .safetensors; one that would run code,
    or with NaN, infinity or other tensors, is refused. Where the network rounds its inputs, weights of any precision
    are rounded to bfloat16, too.
    """
    config = config or MagicDriveConfig.full()
    with torch.device("meta"):
        network = MagicDriveDiT(config)
    expected = network.state_dict()
    tensors = {name: tensor for name, tensor in _read_tensors(path).items() if not _NOT_NEEDED.match(name)}
    if NULL_PROMPT in tensors:
        tensors[NULL_PROMPT] = _lengthen_prompt(tensors[NULL_PROMPT], config.text_tokens)
    _require_same_shapes(path, tensors, expected)
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


def _read_tensors(path: Path) -> Mapping[str, Tensor]:
    if path.suffix != ".safetensors":
        return read_checkpoint(path).tensors
    return read_tensors(path, instead="fetch them again")[0]


def _lengthen_prompt(prompt: Tensor, tokens: int) -> Tensor:
    """A shorter null prompt goes on with its last token, as the published loader has it."""
    if prompt.ndim != 2 or not 0 < len(prompt) < tokens:
        return prompt
    return torch.cat([prompt, prompt[-1:].expand(tokens - len(prompt), -1)])


def _require_same_shapes(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    shared = [name for name in expected if name in tensors]
    kinds = (
        ([name for name in expected if name not in tensors], "missing"),
        ([name for name in tensors if name not in expected], "too many"),
        ([name for name in shared if tensors[name].shape != expected[name].shape], "of another shape"),
        ([name for name in shared if not tensors[name].is_floating_point()], "without fractions"),
    )
    differences = "; ".join(f"{len(names)} {problem} (first: {names[0]})" for names, problem in kinds if names)
    if differences:
        raise InputError(
            f"{path} does not hold the weights of MagicDriveDiT: of its tensors, {differences}; get ema.pt of "
            "flymin/MagicDriveDiT-stage3-40k-ft"
        )
