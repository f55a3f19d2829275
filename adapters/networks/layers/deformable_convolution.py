"""Modulated deformable convolution (DCNv2, Zhu et al., CVPR 2019) without a compiled extension."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn


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
    9, h, w) how much each tap counts.
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
