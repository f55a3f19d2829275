"""How VAD-mini learns to see in the front camera where its lane is, before the rest of it learns anything."""

from collections.abc import Sequence
from typing import Final

import torch
from torch import Tensor

from adapters.networks.vad.model import VAD
from adapters.training.dense_targets import LANE_NUMBERS, lane_loss
from adapters.training.frames import TrainingFrame
from adapters.training.image_encoder import miniature_images
from adapters.training.phases import Phase
from adapters.training.trainer import Recipe

COARSE: Final = "img_neck.lateral_convs.1."
"""What the finer map has in common with the coarse one stays as it is."""
FRONT: Final = 0
"""Place of the front camera."""


class FrontObjective:
    """`adapters.training.frames.Objective` for what the plan takes from the front camera: where lines are ahead.

    A whole frame of the network costs fifty times one image, and four frames a step learn this too slowly.

    Args:
        network: One whose plan sees the front camera; its image network stays as it is.
    """

    clip_frames = 32

    def __init__(self, network: VAD) -> None:
        reader = network.pts_bbox_head.front_reader
        assert reader is not None, "a network whose plan sees the front camera"
        self.network, self.reader = network, reader
        for name, parameter in network.img_neck.named_parameters(prefix="img_neck"):
            if name.startswith(COARSE):
                parameter.requires_grad_(False)

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """The loss of frames that need not belong together.

        Args:
            clip: The frames.

        Returns:
            One scalar.
        """
        images = miniature_images(torch.stack([frame.images[FRONT] for frame in clip]))
        with torch.no_grad():
            stages = self.network.img_backbone(images.contiguous(memory_format=torch.channels_last))
        finest = self.network.img_neck(stages)[0]
        found = torch.cat([self.reader(features) for features in finest])
        each = [lane_loss(said[:LANE_NUMBERS], frame) for said, frame in zip(found, clip, strict=True)]
        return {"lane": torch.stack(each).mean()}


def front_phase() -> Phase:
    """The first part of the training of VAD-mini."""
    recipe = Recipe(steps=800, learning_rate=1e-3, warmup=50, average=0.99, scattered=True)
    return Phase("front", FrontObjective, recipe)
