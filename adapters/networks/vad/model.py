"""VAD: six images, camera matrices and motion in; a plan, boxes, forecasts and a vector map out."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.ego_motion import EgoMotion
from adapters.networks.layers.feature_pyramid import FeaturePyramid
from adapters.networks.layers.front_eyes import FrontEyes, seen_ahead
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.layers.resnet import EXPANSION, ResNet
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.head import VADHead
from adapters.networks.vad.predictions import VADPredictions
from adapters.networks.vad.selection import VADOutputs, select
from benchmark.errors import InputError


@dataclass(frozen=True, slots=True)
class VADInputs:
    """One key frame.

    Attributes:
        images: (6, 3, H, W), normalised and padded; front, front right, front left, back, back left, back right.
        lidar2img: (6, 4, 4), lidar frame in metres to pixels of the padded images.
        can_bus: (18,) float64, absolute, as the data set gives it.
        command: 0 right, 1 left, 2 straight.
        scene_token: A change forgets the past.
    """

    images: Tensor
    lidar2img: Tensor
    can_bus: Tensor
    command: int
    scene_token: str


@dataclass(frozen=True, slots=True)
class _Memory:
    """Memory of a frame for the next one.

    `can_bus` is its vector (float64, absolute), `front` what `FrontReader.left` leaves.
    """

    scene_token: str
    can_bus: Tensor
    bev: Tensor
    front: Tensor | None


class VAD(nn.Module):
    """The network and what it remembers; call it under ``torch.inference_mode()``, frame after frame."""

    def __init__(self, config: VADConfig) -> None:
        super().__init__()
        self.config = config
        self.pts_bbox_head = VADHead(config)
        self.img_backbone = ResNet(config.backbone_blocks, config.backbone_outputs, config.backbone_width)
        widths = [config.backbone_width * EXPANSION * 2**stage for stage in config.backbone_outputs]
        self.img_neck = FeaturePyramid(widths, config.channels, config.pyramid_levels)
        self.front_eyes = FrontEyes(config.backbone_width, config.channels) if config.front_eyes else None
        self._memory: _Memory | None = None
        self.eval()

    def reset(self) -> None:
        """Forget the past; the next frame is the first of a scene."""
        self._memory = None

    def forward(self, inputs: VADInputs) -> VADOutputs:
        """Outputs for one key frame; frames of a scene come in the order of time."""
        return select(self.config, self.predict(inputs), inputs.command)

    def predict(self, inputs: VADInputs) -> VADPredictions:
        """Predictions for one key frame before selection; it is remembered.

        Camera matrices or motion with NaN or infinity are an `InputError`: a camera with such a matrix would see
        nothing, unnoticed.
        """
        if not (inputs.lidar2img.isfinite().all() and inputs.can_bus.isfinite().all()):
            raise InputError(
                f"camera matrices or CAN bus of a frame of scene {inputs.scene_token} have NaN or infinity in them; "
                "check the data set's calibration and poses"
            )
        memory = self._memory if self._memory and self._memory.scene_token == inputs.scene_token else None
        images = inputs.images
        motion = self.ego_motion(inputs).to(images.device)
        projections = inputs.lidar2img.to(images.device, torch.float32)
        maps = self.img_neck(self.img_backbone(images))
        predictions: VADPredictions = self.pts_bbox_head(
            maps,
            images,
            projections,
            motion,
            memory.bev if memory else None,
            self.finest_front(maps[0], images),
            memory.front if memory else None,
        )
        front = predictions.front
        absolute = inputs.can_bus.detach().to("cpu", torch.float64, copy=True)
        left = None if front is None else FrontReader.left(front, memory.front if memory else None)
        self._memory = _Memory(inputs.scene_token, absolute, predictions.bev, left)
        return predictions

    def finest_front(self, finest: Tensor, images: Tensor) -> Tensor:
        """Map of the front camera that the plan looks at, (1, C, h, w).

        From (cameras, C, h, w) finest feature maps of all cameras, and normalised (cameras, 3, H, W) images.
        """
        return seen_ahead(self.front_eyes, finest, images, self.config.cameras)

    def ego_motion(self, inputs: VADInputs) -> EgoMotion:
        """Motion of the ego since the frame that is remembered: zero if it is of another scene, or there is none."""
        memory = self._memory if self._memory and self._memory.scene_token == inputs.scene_token else None
        previous = memory.can_bus if memory else None
        return EgoMotion.between(previous, inputs.can_bus, self.config.grid, self.config.rotation_centre)
