"""ResNet (He et al., CVPR 2016), DCNv2 (Zhu et al., CVPR 2019) and feature pyramid (Lin et al., CVPR 2017)."""

from collections.abc import Sequence
from typing import Literal, Self, TypeVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval


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

    Of `levels`, those past the incoming maps are strided convolutions of the one before them. With `relu_before_extra`
    these see positive values only, but for the first. (It sees all in the published code too, despite its option;
    golden numbers of VAD-base confirm it.)
    """

    def __init__(self, inputs: Sequence[int], channels: int, levels: int, relu_before_extra: bool = True) -> None:
        super().__init__()
        if levels < len(inputs):
            raise ValueError(f"a pyramid of {len(inputs)} maps needs at least as many levels, got {levels}")
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
        outputs: list[Tensor] = []
        for level, convolution in enumerate(self.fpn_convs):
            if level < len(laterals):
                outputs.append(convolution(laterals[level]))
            else:
                rectified = self.relu_before_extra and level > len(laterals)
                outputs.append(convolution(F.relu(outputs[-1]) if rectified else outputs[-1]))
        return outputs


class DeformableConvolution(nn.Module):
    """A 3 x 3 convolution without bias whose nine taps are moved and weighted, place by place, as its input asks."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.stride = stride
        self.weight = nn.Parameter(torch.empty(outputs, inputs, 3, 3))
        self.conv_offset = nn.Conv2d(inputs, 27, 3, stride, padding=1)
        nn.init.kaiming_uniform_(self.weight, nonlinearity="relu")
        with torch.no_grad():
            for parameter in self.conv_offset.parameters():
                parameter.zero_()

    def forward(self, images: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, ceil(H / stride), ceil(W / stride))."""
        predicted: Tensor = self.conv_offset(images)
        return modulated_convolution(
            images, self.weight, predicted[:, :18].float(), predicted[:, 18:].sigmoid(), self.stride
        )


def modulated_convolution(images: Tensor, weight: Tensor, offsets: Tensor, mask: Tensor, stride: int) -> Tensor:
    """Convolution, (B, O, h, w), of (B, C, H, W) images with moved taps; bilinear between pixels, zero outside.

    `weight` is (O, C, 3, 3), `offsets` (B, 18, h, w) y, x of the taps in pixels, tap after tap, row by row, `mask` (B,
    9, h, w).
    """
    batch, channels, height, width = images.shape
    rows, columns = offsets.shape[-2:]
    offsets = offsets.view(batch, 9, 2, rows, columns)
    taps = torch.arange(9, device=images.device)
    top = torch.arange(rows, device=images.device) * stride - 1
    left = torch.arange(columns, device=images.device) * stride - 1
    y = offsets[:, :, 0] + (top[None, :, None] + (taps // 3)[:, None, None])
    x = offsets[:, :, 1] + (left[None, None, :] + (taps % 3)[:, None, None])
    grid = torch.stack([(2 * x + 1) / width - 1, (2 * y + 1) / height - 1], -1).view(batch, 9 * rows, columns, 2)
    sampled = F.grid_sample(images.float(), grid, mode="bilinear", padding_mode="zeros", align_corners=False)
    weighted = sampled.view(batch, channels, 9, rows, columns) * mask[:, None]
    # The product with all taps is one matrix multiplication, in the precision of the features.
    columns_of_input = weighted.view(batch, channels * 9, rows * columns).to(images.dtype)
    return torch.matmul(weight.flatten(1), columns_of_input).view(batch, -1, rows, columns)


EXPANSION = 4
"""Output channels of a block for each of its inner ones."""


class Bottleneck(nn.Module):
    """1 x 1, 3 x 3 and 1 x 1 convolutions beside a shortcut, to four times `inner` channels.

    `style` says which convolution strides: ``pytorch`` the 3 x 3, ``caffe`` the first 1 x 1.
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
    """Bottlenecks in four stages with frozen normalisation; (3, 4, 6, 3) are ResNet-50, (3, 4, 23, 3) ResNet-101."""

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
        maps = []
        for stage in range(max(self.outputs) + 1):
            features = self.get_submodule(self.stages[stage])(features)
            if stage in self.outputs:
                maps.append(features)
        return maps


Module = TypeVar("Module", bound=nn.Module)


def fold_normalisation(network: Module) -> Module:
    """Fold the stored normalisation of residual networks in evaluation mode into the convolutions before it, in place.

    Results differ in the last bits; names of parameters change, so that weights are loaded before. Deformable
    convolutions keep theirs. The network cannot be trained any more. A second call changes nothing.
    """
    for module in network.modules():
        if isinstance(module, ResNet):
            _fold(module, "conv1", "bn1")
        elif isinstance(module, Bottleneck):
            for number in (1, 2, 3):
                _fold(module, f"conv{number}", f"bn{number}")
            if module.downsample is not None:
                _fold(module.downsample, "0", "1")
    return network


def use_channels_last(network: Module) -> Module:
    """Lay the weights of residual networks out as the processor's convolutions read them, in place.

    Features follow that layout. Where some are deformable, whose products want channels first, everything stays.
    """
    for module in network.modules():
        if isinstance(module, ResNet) and not module.deformable:
            for parameter in module.parameters():
                if parameter.ndim == 4:
                    parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    return network


def _fold(owner: nn.Module, convolution: str, normalisation: str) -> None:
    convolution_layer, normalisation_layer = owner.get_submodule(convolution), owner.get_submodule(normalisation)
    if isinstance(convolution_layer, nn.Conv2d) and isinstance(normalisation_layer, nn.BatchNorm2d):
        setattr(owner, convolution, fuse_conv_bn_eval(convolution_layer, normalisation_layer))
        setattr(owner, normalisation, nn.Identity())
