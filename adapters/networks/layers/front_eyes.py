"""An image network for the front camera alone, whose map a plan looks at."""

from typing import Final

import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.front_reader import FRONT
from adapters.networks.layers.resnet import EXPANSION, ResNet

EYES_STAGES: Final = 3
"""Of the residual network, up to cells of 16 pixels: the last one would have most of its parameters."""


class FrontEyes(nn.Module):
    """A residual network without its last stage; what it makes of coarse cells is added to the finer ones.

    The maps that boxes and lines of all cameras are found in cannot change for the plan's sake. These can.
    """

    def __init__(self, width: int, channels: int) -> None:
        super().__init__()
        self.backbone = ResNet((1,) * EYES_STAGES, (1, 2), width)
        self.fine = nn.Conv2d(width * EXPANSION * 2, channels, 1)
        self.coarse = nn.Conv2d(width * EXPANSION * 4, channels, 1)
        self.joined = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) to (B, channels, H / 8, W / 8)."""
        fine, coarse = self.backbone(images)
        far = F.interpolate(self.coarse(coarse), size=fine.shape[-2:], mode="nearest")
        found: Tensor = self.joined(self.fine(fine) + far)
        return found


def seen_ahead(eyes: FrontEyes | None, finest: Tensor, images: Tensor, cameras: int) -> Tensor:
    """Maps of the front cameras that plans look at, (B, C, h, w).

    From (B * cameras, C, h, w) finest feature maps of all cameras, and normalised (B * cameras, 3, H, W) images.
    """
    every = slice(FRONT, None, cameras)
    return finest[every] if eyes is None else eyes(images[every])
