"""Feature pyramid (Lin et al., CVPR 2017): coarse features are added to fine ones."""

from collections.abc import Sequence

import torch.nn.functional as F
from torch import Tensor, nn


class NamedConvolution(nn.Module):
    """A convolution under the name that published checkpoints have for it; arguments as `torch.nn.Conv2d`."""

    def __init__(self, inputs: int, outputs: int, size: int, stride: int = 1) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, size, stride, padding=size // 2)

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, ...)."""
        result: Tensor = self.conv(features)
        return result


class FeaturePyramid(nn.Module):
    """Lateral 1 x 1 convolutions, a sum from coarse to fine, 3 x 3 convolutions, and coarser levels from the last.

    Args:
        levels: Outgoing maps; those past the incoming ones are strided convolutions of the one before them.
        relu_before_extra: Whether those convolutions, but for the first of them, see what is positive only. (The first
            sees all in the published code too, whatever its option says; golden numbers of VAD-base confirm it.)
    """

    def __init__(self, inputs: Sequence[int], channels: int, levels: int, relu_before_extra: bool = True) -> None:
        super().__init__()
        if levels < len(inputs):
            raise ValueError(f"a pyramid of {len(inputs)} maps has at least as many levels, not {levels}")
        self.relu_before_extra = relu_before_extra
        self.lateral_convs = nn.ModuleList([NamedConvolution(width, channels, 1) for width in inputs])
        strides = [1] * len(inputs) + [2] * (levels - len(inputs))
        self.fpn_convs = nn.ModuleList([NamedConvolution(channels, channels, 3, stride) for stride in strides])

    def forward(self, maps: Sequence[Tensor]) -> list[Tensor]:
        """(B, inputs[i], h_i, w_i) for each incoming map to (B, channels, h_j, w_j) for each level."""
        laterals = [convolution(features) for convolution, features in zip(self.lateral_convs, maps, strict=True)]
        for fine in range(len(laterals) - 2, -1, -1):
            size = laterals[fine].shape[-2:]
            laterals[fine] = laterals[fine] + F.interpolate(laterals[fine + 1], size=size, mode="nearest")
        found: list[Tensor] = []
        for level, convolution in enumerate(self.fpn_convs):
            if level < len(laterals):
                found.append(convolution(laterals[level]))
            else:
                rectified = self.relu_before_extra and level > len(laterals)
                found.append(convolution(F.relu(found[-1]) if rectified else found[-1]))
        return found
