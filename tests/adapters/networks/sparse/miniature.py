"""A network that runs in a moment, and its inputs."""

from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseInputs, SparseNetwork
from benchmark.verification.synthetic_weights import WeightsRecipe, draw_seeded_normal

MINIATURE = SparseConfig(
    image_height_px=64,
    image_width_px=128,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=4,
    channels=32,
    heads=4,
    hidden_channels=32,
    planner_hidden_channels=32,
    stages=3,
    anchors=24,
    remembered_anchors=14,
    lines=9,
    remembered_lines=4,
    points_per_line=4,
    samples_per_height=2,
    interaction_blocks=1,
    watched_agents=5,
    watched_lines=3,
    reported_boxes=8,
    reported_lines=6,
)
TIMES_S = (0.0, 0.5, 1.0, 30.0)
"""The last frame comes when memory is stale."""


def recipe() -> WeightsRecipe:
    anchors = draw_seeded_normal("boxes", (MINIATURE.anchors, 11), "mini") * ([8.0] * 2 + [1.0] * 9)
    return WeightsRecipe(
        salt="mini",
        std_rules={r"\.scale$": 0.2, r"instance_feature$": 0.5, r"learnable_fc\.weight$": 0.03, r"cls_branch": 0.2},
        kept_buffers={
            "head.det_head.instance_bank.anchor": anchors.astype(np.float32).tolist(),
            "head.map_head.instance_bank.anchor": (
                8 * draw_seeded_normal("lines", (MINIATURE.lines, 8), "mini")
            ).tolist(),
        },
    )


def filled(name: str, config: SparseConfig = MINIATURE, **settings: Any) -> SparseNetwork:
    """One of its own for each caller."""
    return deepcopy(_filled(name, config, tuple(settings.items())))


@cache
def _filled(name: str, config: SparseConfig, settings: tuple[tuple[str, Any], ...]) -> SparseNetwork:
    kinds: dict[str, type[SparseDrive] | type[DiffusionDrive]] = {
        "sparsedrive": SparseDrive,
        "diffusiondrive": DiffusionDrive,
    }
    network = kinds[name](config, **dict(settings))
    shapes = {key: tuple(value.shape) for key, value in network.state_dict().items()}
    state = recipe().state(shapes)
    network.load_state_dict({key: torch.from_numpy(np.asarray(value)) for key, value in state.items()}, strict=True)
    return network


def projections() -> NDArray[np.float32]:
    """Six cameras at the lidar origin that look round in a circle."""
    found = []
    for angle in np.deg2rad([90, 30, 150, 270, 210, 330]):
        forward = np.array([np.cos(angle), np.sin(angle), 0])
        right = np.array([np.sin(angle), -np.cos(angle), 0])
        rows = np.stack([64 * forward + 50 * right, 32 * forward + [0, 0, -40], forward])
        matrix = np.eye(4)
        matrix[:3, :3] = rows
        found.append(matrix)
    return np.array(found, np.float32)


def frame(number: int, scene_token: str = "scene") -> SparseInputs:
    height, width = MINIATURE.image_height_px, MINIATURE.image_width_px
    coarse = draw_seeded_normal(f"input:image:coarse:frame{number}", (6, 3, height // 16, width // 16), "mini")
    fine = draw_seeded_normal(f"input:image:fine:frame{number}", (6, 3, height, width), "mini")
    images = (np.kron(coarse, np.ones((16, 16))) + 0.5 * fine).astype(np.float32)
    turn, cosine, sine = 0.1 * number, np.cos(0.1 * number), np.sin(0.1 * number)
    pose = np.eye(4)
    pose[:2, :2], pose[:2, 3] = [[cosine, -sine], [sine, cosine]], (600 + 3 * turn, 1600 - 5 * number)
    return SparseInputs(
        images=torch.from_numpy(images),
        projections=torch.from_numpy(projections()),
        timestamp_s=1.5e9 + TIMES_S[number],
        global_T_lidar=torch.from_numpy(pose),
        command=number % 3,
        scene_token=scene_token,
    )


def noise(number: int) -> torch.Tensor:
    return torch.from_numpy(draw_seeded_normal(f"noise{number}", (6, 6, 2), "mini")).float()


def without_memory_across_scenes() -> SparseConfig:
    return replace(MINIATURE, memory_crosses_scenes=False)
