"""Residual networks (He et al., CVPR 2016) with frozen normalisation, as feature extractors."""

from collections.abc import Sequence
from typing import Literal, Self

import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.deformable_convolution import DeformableConvolution

EXPANSION = 4
"""Output channels of a block for each of its inner ones."""


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 and 1 x 1 convolutions beside a shortcut.

    `style` says which convolution strides: ``pytorch`` the 3 x 3, ``caffe`` the first 1 x 1. The output has four times
    `inner` channels.
    """

    def __init__(
        self, inputs: int, inner: int, stride: int, style: Literal["pytorch", "caffe"], deformable: bool
    ) -> None:
        super().__init__()
        first, second = (1, stride) if style == "pytorch" else (stride, 1)
        outputs = inner * EXPANSION
        self.conv1 = nn.Conv2d(inputs, inner, 1, first, bias=False)
        self.bn1 = nn.BatchNorm2d(inner)
        self.conv2: nn.Module = (
            DeformableConvolution(inner, inner, second)
            if deformable
            else nn.Conv2d(inner, inner, 3, second, padding=1, bias=False)
        )
        self.bn2 = nn.BatchNorm2d(inner)
        self.conv3 = nn.Conv2d(inner, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample = (
            nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))
            if stride != 1 or inputs != outputs
            else None
        )

    def forward(self, features: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, 4 * inner, H / stride, W / stride)."""
        shortcut = features if self.downsample is None else self.downsample(features)
        hidden = F.relu(self.bn1(self.conv1(features)), inplace=True)
        hidden = F.relu(self.bn2(self.conv2(hidden)), inplace=True)
        return F.relu(self.bn3(self.conv3(hidden)) + shortcut, inplace=True)


class ResNet(nn.Module):
    """A network of bottlenecks in four stages; its normalisation always uses the stored statistics.

    (3, 4, 6, 3) blocks are ResNet-50, (3, 4, 23, 3) ResNet-101; `width` are the channels after the first convolution.
    """

    def __init__(
        self,
        blocks: Sequence[int] = (3, 4, 6, 3),
        outputs: Sequence[int] = (0, 1, 2, 3),
        width: int = 64,
        style: Literal["pytorch", "caffe"] = "pytorch",
        deformable_stages: Sequence[int] = (),
    ) -> None:
        super().__init__()
        self.outputs = tuple(outputs)
        self.deformable = bool(deformable_stages)
        self.conv1 = nn.Conv2d(3, width, 7, 2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.stages: list[str] = []
        inputs = width
        for stage, count in enumerate(blocks):
            inner = width * 2**stage
            layers: list[nn.Module] = []
            for block in range(count):
                stride = 2 if stage > 0 and block == 0 else 1
                layers.append(Bottleneck(inputs, inner, stride, style, stage in deformable_stages))
                inputs = inner * EXPANSION
            self.stages.append(f"layer{stage + 1}")
            self.add_module(self.stages[-1], nn.Sequential(*layers))
        self.train(False)

    def train(self, mode: bool = True) -> Self:
        """As for any module, but the normalisation stays as it is stored."""
        super().train(mode)
        for module in self.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.training = False
        return self

    def forward(self, images: Tensor) -> list[Tensor]:
        """Features of (B, 3, H, W) images; (B, 4 * width * 2^s, H / 2^(s + 2), W / 2^(s + 2)) of output stage s."""
        features = F.relu(self.bn1(self.conv1(images)), inplace=True)
        features = F.max_pool2d(features, 3, 2, padding=1)
        found = []
        for stage in range(max(self.outputs) + 1):
            features = self.get_submodule(self.stages[stage])(features)
            if stage in self.outputs:
                found.append(features)
        return found
