"""What the plan of a small network reads in the front camera's finest feature map."""

import math

import torch.nn.functional as F
from torch import Tensor, nn

FRONT = 0
"""Place of the front camera."""
FRONT_CELLS = 4, 7
"""Rows and columns of what the plan looks at there; those of images of 224 x 128."""
KEPT_OF_NOW = 0.5
"""Share of a key frame's numbers in what is left for the next one."""
NARROW = 32
"""Channels of what the plan makes of the front camera's map."""


class FrontReader(nn.Module):
    """Reader of the front camera's finest feature map for the plan of a small network.

    A cell of a small bird's-eye view is larger than a lane is off its middle; in the image it is some pixels. The map
    is halved twice, and brought to `FRONT_CELLS` where it is not as large by then; `numbers` are taken from it, and
    `told` is the width of their message to the plan. With `compares` the plan is also told how they have changed: one
    image does not say how fast anything moves.
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
        found = features
        for convolution in self.convs:
            found = F.relu(convolution(found))
        result: Tensor = self.read(F.adaptive_avg_pool2d(found, FRONT_CELLS).flatten(1))
        return result

    def told(self, numbers: Tensor, before: Tensor | None) -> Tensor:
        """Message to the plan, (B, told), of the (B, numbers) of these key frames.

        `before` is what the key frames before have left (`left`); ``None`` at the start of a scene.
        """
        told: Tensor = self.tell(numbers)
        if self.tell_change is not None and before is not None:
            told = told + self.tell_change(numbers - before)
        return told

    @staticmethod
    def left(numbers: Tensor, before: Tensor | None) -> Tensor:
        """Numbers left for the next key frames: a mean that forgets, since each image errs by itself."""
        return numbers if before is None else before + KEPT_OF_NOW * (numbers - before)

    def only_tell(self) -> None:
        """Let nothing learn but what the plan is told: what is read stays as it is."""
        self.requires_grad_(False).tell.requires_grad_(True)
        if self.tell_change is not None:
            self.tell_change.requires_grad_(True)

    def say_nothing(self) -> None:
        """Begin with nothing to tell, as in weights that never looked there."""
        nn.init.zeros_(self.tell.weight)
        nn.init.zeros_(self.tell.bias)
        if self.tell_change is not None:
            nn.init.zeros_(self.tell_change.weight)
