"""A UniAD network of a few thousand numbers, and frames for it."""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import nn

from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD, UniADInputs
from tests.adapters.networks.vad.small_vad import rig

SMALL = UniADConfig(
    bev_rows=16,
    bev_columns=24,
    perception_range_m=(-12.0, -8.0, -5.0, 12.0, 8.0, 3.0),
    channels=16,
    feedforward_channels=24,
    occupancy_feedforward_channels=24,
    heads=2,
    encoder_layers=2,
    decoder_layers=2,
    queries=14,
    map_queries=9,
    map_layers=2,
    thing_mask_layers=1,
    stuff_mask_layers=2,
    motion_layers=2,
    plan_layers=1,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=4,
    max_boxes=10,
    max_lines=5,
    occupancy_half_m=8.0,
    rotation_centre=(12.0, 8.0),
)


def anchors(config: UniADConfig = SMALL) -> torch.Tensor:
    shape = (config.motion_groups, config.modes, config.forecast_steps, 2)
    return torch.randn(shape, generator=torch.Generator().manual_seed(3)).cumsum(2) * 0.3


def class_layer(network: UniAD) -> nn.Linear:
    """What decides how many queries become tracks."""
    branch = network.pts_bbox_head.cls_branches[-1]
    assert isinstance(branch, nn.Sequential) and isinstance(branch[-1], nn.Linear)
    return branch[-1]


def small_network(seed: int = 0, config: UniADConfig = SMALL) -> UniAD:
    torch.manual_seed(seed)
    network = UniAD(config, anchors(config))
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator))
        # About half of the queries become tracks, of several classes.
        class_layer(network).weight.normal_(0.0, 0.35, generator=generator)
        class_layer(network).bias.fill_(-1.2)
    return network.eval()


def frame(number: int, scene: str = "a") -> UniADInputs:
    """Half a second after the frame before, two metres on and three degrees to the left."""
    generator = torch.Generator().manual_seed(number)
    yaw = 0.4 + math.radians(3) * number
    can_bus = np.zeros(18)
    can_bus[:2] = 300.0 + 2 * number * math.cos(yaw), 700.0 + 2 * number * math.sin(yaw)
    can_bus[16], can_bus[17] = yaw, math.degrees(yaw)
    cosine, sine = math.cos(yaw - math.pi / 2), math.sin(yaw - math.pi / 2)
    return UniADInputs(
        images=torch.randn(6, 3, 64, 96, generator=generator),
        lidar2img=rig(),
        can_bus=torch.from_numpy(can_bus),
        l2g_r_mat=torch.tensor([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]),
        l2g_t=torch.tensor([can_bus[0], can_bus[1], 1.8]),
        timestamp=1e9 + 0.5 * number,
        command=number % 3,
        scene_token=scene,
    )


def in_scene(number: int, scene: str) -> UniADInputs:
    return replace(frame(number), scene_token=scene)
