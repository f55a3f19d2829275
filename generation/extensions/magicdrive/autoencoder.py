"""Latents to pictures: the video decoder of CogVideoX, one view at a time (section 10)."""

from pathlib import Path
from typing import Any, Final, Self

import torch
from torch import Tensor

from benchmark.errors import InputError
from benchmark.weights.pretrained import Library

DIFFUSERS: Final = Library("diffusers", extra="render", needed_by="the renderer magicdrive")


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
        """Decode one view, (16, t, h, w) as the transformer gives it, of unit spread.

        (T, 8h, 8w, 3) uint8 on the processor; T is 4t, or 4t - 3 where t is odd. Pictures that are not finite are
        refused.
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
