"""Front-camera reader and image network for the plan of a small network."""

import math
from typing import Final

import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.resnet import EXPANSION, ResNet

FRONT = 0
"""Place of the front camera."""
FRONT_CELLS = 4, 7
"""Rows and columns of what the plan looks at there; those of images of 224 x 128."""
NEW_SHARE = 0.5
"""Share of a key frame's numbers in what is left for the next one."""
NARROW = 32
"""Channels of what the plan makes of the front camera's map."""


class FrontReader(nn.Module):
    """Reader of the front camera's finest feature map for the plan of a small network.

    A cell of a small bird's-eye view is larger than a lane is off its middle; in the image it is some pixels. The map
    is halved twice, and resized to `FRONT_CELLS`. With `compares` the plan is also told how the `numbers` have changed:
    one image does not say how fast anything moves.
    """

    def __init__(self, channels: int, numbers: int, told: int, *, compares: bool = False) -> None:
        super().__init__()
        self.convs = nn.ModuleList([nn.Conv2d(channels, NARROW, 3, 2, 1), nn.Conv2d(NARROW, NARROW, 3, 2, 1)])
        self.read = nn.Sequential(
            nn.Linear(math.prod(FRONT_CELLS) * NARROW, 2 * NARROW), nn.ReLU(), nn.Linear(2 * NARROW, numbers)
        )
        self.tell = nn.Linear(numbers, told)
        self.tell_change = nn.Linear(numbers, told, bias=False) if compares else None

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, h, w) to (B, numbers)."""
        hidden = features
        for convolution in self.convs:
            hidden = F.relu(convolution(hidden))
        result: Tensor = self.read(F.adaptive_avg_pool2d(hidden, FRONT_CELLS).flatten(1))
        return result

    def told(self, numbers: Tensor, before: Tensor | None) -> Tensor:
        """Message to the plan, (B, told), of the (B, numbers) of these key frames and those before (`left`), if any."""
        message: Tensor = self.tell(numbers)
        if self.tell_change is not None and before is not None:
            message = message + self.tell_change(numbers - before)
        return message

    @staticmethod
    def left(numbers: Tensor, before: Tensor | None) -> Tensor:
        """Numbers left for the next key frames: a mean that forgets, since each image errs by itself."""
        return numbers if before is None else before + NEW_SHARE * (numbers - before)

    def freeze_reading(self) -> None:
        """Let nothing learn but what the plan is told: what is read stays as it is."""
        self.requires_grad_(False).tell.requires_grad_(True)
        if self.tell_change is not None:
            self.tell_change.requires_grad_(True)

    def zero_message(self) -> None:
        """Begin with nothing to tell, as in weights that never looked there."""
        nn.init.zeros_(self.tell.weight)
        nn.init.zeros_(self.tell.bias)
        if self.tell_change is not None:
            nn.init.zeros_(self.tell_change.weight)


BACKBONE_STAGES: Final = 3
"""Of the residual network, up to cells of 16 pixels: the last one would have most of its parameters."""


class FrontBackbone(nn.Module):
    """A residual network without its last stage; features of its coarse cells are added to the finer ones.

    The maps of boxes and lines are shared by all cameras and cannot change for the plan's sake. These can.
    """

    def __init__(self, width: int, channels: int) -> None:
        super().__init__()
        self.backbone = ResNet((1,) * BACKBONE_STAGES, (1, 2), width)
        self.fine = nn.Conv2d(width * EXPANSION * 2, channels, 1)
        self.coarse = nn.Conv2d(width * EXPANSION * 4, channels, 1)
        self.joined = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, images: Tensor) -> Tensor:
        """(B, 3, H, W) to (B, channels, H / 8, W / 8)."""
        fine, coarse = self.backbone(images)
        far = F.interpolate(self.coarse(coarse), size=fine.shape[-2:], mode="nearest")
        features: Tensor = self.joined(self.fine(fine) + far)
        return features


def compute_front_maps(eyes: FrontBackbone | None, finest: Tensor, images: Tensor, cameras: int) -> Tensor:
    """Front maps for plans, (B, C, h, w), of (B * cameras, C, h, w) finest maps and (B * cameras, 3, H, W) images."""
    every = slice(FRONT, None, cameras)
    return finest[every] if eyes is None else eyes(images[every])
