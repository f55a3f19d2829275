"""A small network with random weights, all of whose parts matter, and random conditions for it."""

from dataclasses import replace

import torch
from torch import Tensor

from benchmark.verification.synthetic_weights import WeightsRecipe
from generation.extensions.magicdrive.conditions import ClipConditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.model import MagicDriveDiT

TINY = MagicDriveConfig(
    hidden=32,
    heads=2,
    encoder_heads=2,
    depth=2,
    control_depth=1,
    caption_channels=24,
    text_tokens=12,
    box_hidden=16,
    map_channels=(4, 4, 8, 8),
)
"""A network for tests of everything around it; its parts are all there."""
CONFIG = replace(TINY, rounded=False, rows_multiple=1)


RECIPE = WeightsRecipe(
    salt="small",
    std_rules={
        r"^controlnet_cond_embedder\..*weight$": 0.3,
        r"rope\.freqs$": 0.5,
        r"(null|mask)_(class|pos)_feature$": 0.5,
        r"uncond_cam$": 1.0,
        r"\.bias$": 0.1,
    },
)
"""As in the golden set: signals neither vanish nor explode on their way."""


def small_network(config: MagicDriveConfig = CONFIG) -> MagicDriveDiT:
    network = MagicDriveDiT(config)
    state = RECIPE.state({name: tuple(tensor.shape) for name, tensor in network.state_dict().items()})
    network.load_state_dict({name: torch.from_numpy(value) for name, value in state.items()})
    return network.eval().requires_grad_(False)


def random_conditions(
    config: MagicDriveConfig = CONFIG,
    *,
    frames: int = 5,
    boxes: int = 3,
    rows: int = 4,
    columns: int = 6,
    words: int = 4,
    seed: int = 1,
) -> ClipConditions:
    """Of a clip whose latent has these rows and columns."""
    random = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=random)

    views = config.views
    return ClipConditions(
        bboxes=3 * normal(1, frames, boxes, 8, 3),
        classes=torch.randint(-1, 10, (1, frames, boxes), generator=random),
        masks=torch.randint(-1, 2, (views, frames, boxes), generator=random),
        box_latent=normal(boxes, config.hidden),
        cams=normal(views, frames, 1, 3, 7),
        rel_pos=normal(frames, 4, 4),
        maps=torch.rand((frames, config.map_layers, 8 * rows, 8 * columns), generator=random) > 0.5,
        text=TextStates(normal(config.text_tokens, config.caption_channels), torch.arange(config.text_tokens) < words),
        fps=12.0,
        height=8 * rows,
        width=8 * columns,
    )


def noise(network: MagicDriveDiT, conditions: ClipConditions, seed: int = 2) -> Tensor:
    size = network.compute_latent_size(conditions)
    shape = (1, network.config.packed_channels, size.frames, size.rows, size.columns)
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def velocity(network: MagicDriveDiT, conditions: ClipConditions, latent: Tensor, time: float = 500.0) -> Tensor:
    out: Tensor = network(latent, torch.tensor([time]), network.encode(conditions))
    return out


def assert_same(found: Tensor, expected: Tensor) -> None:
    """But for the order of sums."""
    torch.testing.assert_close(found, expected, atol=5e-5, rtol=1e-5)
