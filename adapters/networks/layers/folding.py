"""Networks made ready to be run on a processor: the same function, in fewer passes over memory."""

from typing import TypeVar

import torch
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from adapters.networks.layers.resnet import Bottleneck, ResNet

Module = TypeVar("Module", bound=nn.Module)


def folded(network: Module) -> Module:
    """Fold the normalisation of residual networks, in evaluation mode, into the convolutions before it, in place.

    It multiplies and shifts each channel by stored numbers, which the weights of a convolution can do at once. Results
    differ in the last bits; names of parameters change, so that weights are loaded before. Deformable convolutions keep
    theirs. The network cannot be trained any more. Once is enough: what is folded stays as it is.
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


def channels_last(network: Module) -> Module:
    """Lay the weights of residual networks out as the processor's convolutions read them, in place.

    Features follow the layout of the weights, so that no convolution has to turn them. Where some are deformable, whose
    products want channels first, everything stays.
    """
    for module in network.modules():
        if isinstance(module, ResNet) and not module.deformable:
            for parameter in module.parameters():
                if parameter.ndim == 4:
                    parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    return network


def _fold(owner: nn.Module, convolution: str, normalisation: str) -> None:
    before, after = owner.get_submodule(convolution), owner.get_submodule(normalisation)
    if isinstance(before, nn.Conv2d) and isinstance(after, nn.BatchNorm2d):
        setattr(owner, convolution, fuse_conv_bn_eval(before, after))
        setattr(owner, normalisation, nn.Identity())
