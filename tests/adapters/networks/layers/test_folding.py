"""Folded networks compute what they computed before, in fewer steps and another layout."""

import copy
from collections.abc import Sequence

import pytest
import torch
from torch import nn

from adapters.networks.layers.resnet import (
    DeformableConvolution,
    FeaturePyramid,
    ResNet,
    fold_normalisation,
    use_channels_last,
)


def network(deformable: Sequence[int] = ()) -> nn.ModuleDict:
    torch.manual_seed(0)
    backbone = ResNet((1, 2, 1, 1), (1, 3), 8, deformable_stages=deformable)
    made = nn.ModuleDict({"backbone": backbone, "neck": FeaturePyramid((64, 256), 16, 3)}).eval()
    for module in made.modules():
        if isinstance(module, DeformableConvolution):
            nn.init.normal_(module.conv_offset.weight, 0.0, 0.02)
        if isinstance(module, nn.BatchNorm2d):
            nn.init.uniform_(module.weight, 0.5, 1.5)
            nn.init.normal_(module.bias)
            assert module.running_mean is not None and module.running_var is not None
            module.running_mean.normal_(0.0, 0.5)
            module.running_var.uniform_(0.5, 2.0)
    return made


def seen(made: nn.ModuleDict, images: torch.Tensor) -> list[torch.Tensor]:
    with torch.inference_mode():
        found: list[torch.Tensor] = made["neck"](made["backbone"](images))
        return found


@pytest.mark.parametrize("deformable", [(), (2, 3)], ids=["plain", "deformable"])
def test_a_folded_network_sees_the_same_up_to_rounding(deformable: tuple[int, ...]) -> None:
    before, images = network(deformable), torch.randn(2, 3, 70, 96)
    after = use_channels_last(fold_normalisation(copy.deepcopy(before)))
    left = [name for name, module in after.named_modules() if isinstance(module, nn.BatchNorm2d)]
    # A deformable convolution has no place for a shift.
    assert all(name.endswith("bn2") for name in left) and len(left) == len(deformable)
    found, twice = seen(after, images), seen(fold_normalisation(copy.deepcopy(after)), images)
    for one, other, again in zip(seen(before, images), found, twice, strict=True):
        assert one.shape == other.shape and torch.equal(other, again)
        assert float((one - other).abs().max()) < 2e-5 * float(one.abs().max())
        # Features leave a plain network as its convolutions read them.
        assert other.is_contiguous(memory_format=torch.contiguous_format if deformable else torch.channels_last)
