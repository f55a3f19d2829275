"""The image encoder that all miniatures start from, and how it is trained before them.

The published networks start from weights that were trained on images alone (ImageNet, FCOS3D). Here a small residual
network learns to say, for each image by itself, where the centres of boxes are, how far, how large and how turned, and
where the ground is drivable or painted (after CenterNet, FCOS3D and inverse perspective mapping).
"""

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.image_targets import BOX_NUMBERS, GROUND_KINDS, ImageTargets, image_targets
from adapters.networks.layers.feature_pyramid import FeaturePyramid
from adapters.networks.layers.resnet import ResNet
from benchmark.constants import DETECTION_CLASSES

BLOCKS = (1, 1, 1, 1)
WIDTH = 16
"""Residual blocks of each stage and channels after the first convolution, of all miniatures."""
_STAGES = (1, 2, 3)
_CHANNELS = 64
_LINE_WEIGHT = 4.0
RARE = -4.0
"""Bias of outputs that are nearly always 0: their sigmoid begins at 0.018."""


def miniature_images(images: Tensor) -> Tensor:
    """Images of training frames, (..., 3, H, W) uint8, red green blue, as the miniatures read them.

    float32, normalised (`RGB_MEAN_STD`).
    """
    mean = torch.tensor(RGB_MEAN_STD.mean, device=images.device)[:, None, None]
    std = torch.tensor(RGB_MEAN_STD.std, device=images.device)[:, None, None]
    return (images.float() - mean) / std


class ImageEncoder(nn.Module):
    """A residual network with a head that is thrown away after training."""

    def __init__(self) -> None:
        super().__init__()
        self.img_backbone = ResNet(BLOCKS, _STAGES, WIDTH)
        inputs = [4 * WIDTH * 2**stage for stage in _STAGES]
        self.pyramid = FeaturePyramid(inputs, _CHANNELS, len(inputs))
        self.shared = nn.Conv2d(_CHANNELS, _CHANNELS, 3, padding=1)
        self.heat = nn.Conv2d(_CHANNELS, len(DETECTION_CLASSES), 1)
        self.boxes = nn.Conv2d(_CHANNELS, BOX_NUMBERS, 1)
        self.ground = nn.Conv2d(_CHANNELS, 4 * len(GROUND_KINDS), 1)
        with torch.no_grad():
            for rare in (self.heat, self.ground):
                # Much ground is drivable, little is a line.
                bias = next(value for name, value in rare.named_parameters() if name == "bias")
                bias[4 if rare is self.ground else 0 :] = RARE

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Contents of normalised images, (N, 3, H, W).

        Logits of centres (N, classes, H / 8, W / 8), box numbers (N, 8, H / 8, W / 8), logits of kinds of ground (N,
        kinds, H / 4, W / 4).
        """
        features = F.relu(self.shared(self.pyramid(self.img_backbone(images))[0]))
        return self.heat(features), self.boxes(features), F.pixel_shuffle(self.ground(features), 2)


class ImageEncoderObjective:
    """Objective of the image encoder.

    Normalisation uses the statistics of the `clip_frames` of one forward pass, so they are any frames.
    """

    clip_frames = 4

    def __init__(self, network: ImageEncoder) -> None:
        self.network = network

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of frames that need not belong together; about half of them are mirrored."""
        # The networks keep their statistics still; these are the weights that the statistics come from.
        for module in self.network.img_backbone.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.training = True
        device = next(self.network.parameters()).device
        images = torch.cat([frame.images for frame in clip])
        targets = [image_targets(frame) for frame in clip]
        wanted = {
            name: torch.from_numpy(_joined(targets, name)).to(device) for name in ImageTargets.__dataclass_fields__
        }
        mirrored = torch.rand(len(images)) < 0.5
        images, wanted = _mirrored(images, wanted, mirrored.to(device))
        brightness = torch.empty(len(images), 1, 1, 1).uniform_(-0.3, 0.3).to(device)
        contrast = torch.empty(len(images), 1, 1, 1).uniform_(0.8, 1.2).to(device)
        heat, boxes, ground = self.network(miniature_images(images) * contrast + brightness)
        return _losses(heat, boxes, ground, wanted)


def _joined(targets: Sequence[ImageTargets], name: str) -> NDArray[np.generic]:
    return np.concatenate([getattr(each, name) for each in targets])


def _losses(heat: Tensor, boxes: Tensor, ground: Tensor, wanted: dict[str, Tensor]) -> dict[str, Tensor]:
    has_box = wanted["has_box"][:, None]
    count = float(has_box.sum().clamp(min=1))
    error = (boxes - wanted["boxes"]).abs() * has_box
    entropy = F.binary_cross_entropy_with_logits(ground, wanted["ground"], reduction="none")
    weight = torch.where(wanted["ground"] > 0, _LINE_WEIGHT, 1.0)
    weight[:, 0] = 1.0
    counted = wanted["sees_ground"] * weight
    return {
        "heat": centre_loss(heat, wanted["heat"]),
        "place": 0.5 * error[:, :2].sum() / count,
        "depth": error[:, 2].sum() / count,
        "size": 0.5 * error[:, 3:6].sum() / count,
        "turn": 0.5 * error[:, 6:].sum() / count,
        "ground": 2.0 * (entropy * counted).sum() / counted.sum().clamp(min=1),
    }


def centre_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """Focal loss, per centre, that forgives what is near a centre (CornerNet, ECCV 2018); `heat` is 1 at centres."""
    shares = logits.sigmoid()
    centres = heat >= 1
    found = -F.logsigmoid(logits) * (1 - shares) ** 2 * centres
    wrong = -F.logsigmoid(-logits) * shares**2 * (1 - heat) ** 4 * ~centres
    return (found + wrong).sum() / centres.sum().clamp(min=1)


def _mirrored(images: Tensor, wanted: dict[str, Tensor], chosen: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
    """Left and right exchanged in the chosen images and in what is asked of them."""
    flipped = {name: value.flip(-1) for name, value in wanted.items()}
    # The offset to the right and the angle of view turn round.
    sign = torch.ones(BOX_NUMBERS, device=images.device)
    sign[[0, 6]] = -1
    flipped["boxes"] = flipped["boxes"] * sign[:, None, None]
    mixed = {}
    for name, value in wanted.items():
        mixed[name] = torch.where(chosen.view(-1, *[1] * (value.dim() - 1)), flipped[name], value)
    return torch.where(chosen[:, None, None, None], images.flip(-1), images), mixed
