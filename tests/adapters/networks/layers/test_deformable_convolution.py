"""Modulated deformable convolution against loops over places, taps and channels."""

import pytest
import torch
import torch.nn.functional as F

from adapters.networks.layers.resnet import DeformableConvolution, modulated_convolution
from tests.adapters.networks.layers.slow_sampling import bilinear


@pytest.mark.parametrize("stride", [1, 2])
def test_convolution_is_the_sum_over_taps(stride: int) -> None:
    torch.manual_seed(stride)
    images, weight = torch.randn(2, 3, 5, 7), torch.randn(4, 3, 3, 3)
    rows, columns = -(-5 // stride), -(-7 // stride)
    offsets, mask = 1.5 * torch.randn(2, 18, rows, columns), torch.rand(2, 9, rows, columns)
    found = modulated_convolution(images, weight, offsets, mask, stride)
    for batch in range(2):
        image = images[batch].permute(1, 2, 0)
        for row in range(rows):
            for column in range(columns):
                total = torch.zeros(4, dtype=torch.float64)
                for tap in range(9):
                    y = row * stride - 1 + tap // 3 + float(offsets[batch, 2 * tap, row, column])
                    x = column * stride - 1 + tap % 3 + float(offsets[batch, 2 * tap + 1, row, column])
                    value = float(mask[batch, tap, row, column]) * bilinear(image, x, y)
                    total += weight[:, :, tap // 3, tap % 3].double() @ value
                torch.testing.assert_close(found[batch, :, row, column].double(), total, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("stride", [1, 2])
def test_without_movement_it_is_a_convolution(stride: int) -> None:
    torch.manual_seed(0)
    module, images = DeformableConvolution(3, 4, stride), torch.randn(1, 3, 6, 9)
    with torch.no_grad():
        # Untrained, each tap counts half.
        expected = F.conv2d(images, module.weight, stride=stride, padding=1) / 2
        torch.testing.assert_close(module(images), expected, rtol=1e-4, atol=1e-5)
        half = module.bfloat16()(images.bfloat16())
    torch.testing.assert_close(half.float(), expected, rtol=0, atol=0.1)
