"""A VAD network of a few thousand numbers, and frames for it."""

import math

import numpy as np
import torch

from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs

SMALL = VADConfig(
    bev_rows=10,
    bev_columns=8,
    encoder_layers=2,
    decoder_layers=2,
    backbone_outputs=(2, 3),
    pyramid_levels=3,
    image_scale=0.05,
    channels=16,
    feedforward_channels=24,
    heads=2,
    agents=12,
    map_instances=5,
    points_per_line=4,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=4,
    rotation_centre=(4.0, 5.0),
    max_boxes=20,
    max_lines=6,
)


def small_network(seed: int = 0, config: VADConfig = SMALL) -> VAD:
    torch.manual_seed(seed)
    network = VAD(config)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator))
    return network.eval()


def rig(width: int = 96, height: int = 64) -> torch.Tensor:
    """(6, 4, 4) cameras every 60 degrees; lidar metres to pixels."""
    matrices = []
    for degrees in (90, 30, 150, 270, 210, 330):
        heading = math.radians(degrees)
        right, ahead = [math.sin(heading), -math.cos(heading), 0.0], [math.cos(heading), math.sin(heading), 0.0]
        focal = width / 1.4
        intrinsic = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        matrix = np.eye(4)
        matrix[:3, :3] = intrinsic @ np.array([right, [0.0, 0.0, -1.0], ahead])
        matrices.append(matrix)
    return torch.from_numpy(np.stack(matrices))


def small_frame(number: int, scene: str = "a", command: int = 2) -> VADInputs:
    """Frames of a car that drives ahead and turns left, with images of noise."""
    generator = torch.Generator().manual_seed(number)
    can_bus = torch.zeros(18, dtype=torch.float64)
    yaw = 0.3 + 0.05 * number
    can_bus[:2] = torch.tensor([1000.0 + 3.0 * number, 500.0 + 1.0 * number])
    can_bus[3:7] = math.cos(yaw / 2)
    can_bus[16], can_bus[17] = yaw, math.degrees(yaw)
    images = torch.randn(6, 3, 64, 96, generator=generator)
    return VADInputs(images, rig(), can_bus, command, scene)
