"""Residual network and feature pyramid: published names, strides, frozen statistics, sums."""

import json
from pathlib import Path
from typing import Any, Literal

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from adapters.networks.layers.resnet import Bottleneck, FeaturePyramid, ResNet
from tests.adapters.networks.layers.test_attention import perturb

PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity"


def published(model: str, prefix: str) -> dict[str, tuple[int, ...]]:
    keys = json.loads((PARITY / model / "keys.json").read_text())
    rows = [(name, keys[name]["shape"]) for name in keys] if isinstance(keys, dict) else [row[:2] for row in keys]
    return {name.removeprefix(prefix): tuple(shape) for name, shape in rows if name.startswith(prefix)}


def shapes(module: nn.Module) -> dict[str, tuple[int, ...]]:
    return {name: tuple(tensor.shape) for name, tensor in module.state_dict().items()}


@pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")
def test_names_and_shapes_are_the_published_ones() -> None:
    uniad = ResNet((3, 4, 23, 3), (1, 2, 3), style="caffe", deformable_stages=(2, 3))
    assert shapes(uniad) == published("uniad", "img_backbone.")
    assert shapes(FeaturePyramid((512, 1024, 2048), 256, 4)) == published("uniad", "img_neck.")
    assert shapes(ResNet()) == published("sparsedrive", "img_backbone.")
    assert shapes(FeaturePyramid((256, 512, 1024, 2048), 256, 4)) == published("sparsedrive", "img_neck.")


@pytest.mark.parametrize("style", ["pytorch", "caffe"])
def test_a_block_is_three_convolutions_beside_a_shortcut(style: Literal["pytorch", "caffe"]) -> None:
    torch.manual_seed(0)
    block: Any = Bottleneck(6, 4, 2, style, deformable=False).eval()
    perturb(block)
    for module in block.modules():
        if isinstance(module, nn.BatchNorm2d):
            assert module.running_mean is not None and module.running_var is not None
            module.running_mean.normal_()
            module.running_var.uniform_(0.5, 2)
    images = torch.randn(2, 6, 8, 10)

    def normalised(features: torch.Tensor, norm: nn.BatchNorm2d) -> torch.Tensor:
        assert norm.running_mean is not None and norm.running_var is not None
        mean, variance, scale, bias = (
            tensor[:, None, None] for tensor in (norm.running_mean, norm.running_var, norm.weight, norm.bias)
        )
        return (features - mean) / torch.sqrt(variance + 1e-5) * scale + bias

    first, second = (1, 2) if style == "pytorch" else (2, 1)
    with torch.no_grad():
        hidden = normalised(F.conv2d(images, block.conv1.weight, stride=first), block.bn1).relu()
        hidden = normalised(F.conv2d(hidden, block.conv2.weight, stride=second, padding=1), block.bn2).relu()
        hidden = normalised(F.conv2d(hidden, block.conv3.weight), block.bn3)
        shortcut = block.downsample[1](F.conv2d(images, block.downsample[0].weight, stride=2))
        torch.testing.assert_close(block(images), (hidden + shortcut).relu(), rtol=1e-4, atol=1e-5)


def test_stages_and_frozen_statistics() -> None:
    torch.manual_seed(0)
    network = ResNet((1, 2, 1, 1), (1, 3), width=4, style="caffe", deformable_stages=(3,))
    network.train()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    maps = network(torch.randn(2, 3, 64, 96))
    assert [tuple(features.shape) for features in maps] == [(2, 32, 8, 12), (2, 128, 2, 3)]
    assert all(torch.equal(tensor, before[name]) for name, tensor in network.state_dict().items())


def test_a_pyramid_adds_coarse_to_fine() -> None:
    torch.manual_seed(0)
    pyramid: Any = FeaturePyramid((3, 5), 4, 4)
    perturb(pyramid)
    fine, coarse = torch.randn(1, 3, 5, 7), torch.randn(1, 5, 3, 4)
    with torch.no_grad():
        levels = pyramid([fine, coarse])
        top = F.conv2d(coarse, pyramid.lateral_convs[1].conv.weight, pyramid.lateral_convs[1].conv.bias)
        bottom = F.conv2d(fine, pyramid.lateral_convs[0].conv.weight, pyramid.lateral_convs[0].conv.bias)
        for row in range(5):
            for column in range(7):
                bottom[:, :, row, column] += top[:, :, row * 3 // 5, column * 4 // 7]
        torch.testing.assert_close(levels[0], pyramid.fpn_convs[0].conv(bottom), rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(levels[1], pyramid.fpn_convs[1].conv(top), rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(levels[2], pyramid.fpn_convs[2].conv(levels[1]))
        torch.testing.assert_close(levels[3], pyramid.fpn_convs[3].conv(levels[2].relu()))
    assert tuple(levels[2].shape[-2:]) == (2, 2) and tuple(levels[3].shape[-2:]) == (1, 1)
    with pytest.raises(ValueError, match="at least as many levels"):
        FeaturePyramid((3, 5), 4, 1)
