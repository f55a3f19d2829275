"""Operations by formula against those that PyTorch counts, and against the specification."""

from dataclasses import replace

import pytest
import torch
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

from generation.extensions.magicdrive.conditions import TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.estimate import ClipWorkload, count_operations
from generation.extensions.magicdrive.layers import LatentSize
from generation.extensions.magicdrive.model import MagicDriveDiT
from tests.generation.extensions.magicdrive.small_network import CONFIG, noise, random_conditions, small_network


def published(height: int, width: int, rows_multiple: int, map_cells: int) -> ClipWorkload:
    """A scene of the specification: 61 latent frames, some 60 boxes; its prompts have some 30 tokens."""
    return ClipWorkload(241, LatentSize.of(241, height, width, rows_multiple), 32, 60, (map_cells, map_cells))


@pytest.mark.parametrize(
    ("clip", "petaflop"),
    [(published(224, 400, 4, 200), 36.5), (published(224, 400, 1, 200), 32.0), (published(424, 800, 4, 400), 139.0)],
)
def test_the_specification_counts_the_same(clip: ClipWorkload, petaflop: float) -> None:
    count = count_operations(MagicDriveConfig.full(), clip, as_published=True)
    assert count.scene(30, as_published=True) / 1e15 == pytest.approx(petaflop, rel=0.01)


@pytest.mark.parametrize("frames", [1, 8, 9])
@pytest.mark.parametrize("multiple", [1, 4])
def test_the_formula_is_what_the_network_computes(frames: int, multiple: int) -> None:
    config = replace(CONFIG, depth=2, control_depth=1)
    network = small_network(config)
    conditions = random_conditions(config, frames=frames, boxes=3, rows=6, columns=10, words=4)
    size = network.compute_latent_size(conditions, multiple)
    expected = count_operations(config, ClipWorkload(frames, size, 5, 3, (48, 80)))
    # The fast attention of processors is not counted.
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as encoding:
        encoded = network.encode(conditions, rows_multiple=multiple)
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as evaluation:
        network(noise(network, conditions), torch.tensor([500.0]), encoded)
    # The formula leaves out the embeddings of time and frame rate.
    assert evaluation.get_total_flops() == pytest.approx(expected.transformer, rel=0.03)
    assert encoding.get_total_flops() == pytest.approx(expected.encoders, rel=0.03)


@torch.no_grad()
def test_the_published_network_at_its_real_size() -> None:
    """Without memory: every shape is as it will be, and PyTorch counts what the formula says."""
    config = MagicDriveConfig.full()
    with torch.device("meta"):
        network = MagicDriveDiT(config).eval().requires_grad_(False).to(torch.bfloat16)
    clip = random_conditions(config, frames=241, boxes=60, rows=28, columns=50, words=31)
    # Its length must be known; nothing else is.
    words = TextStates(clip.text.hidden.to("meta"), clip.text.mask)
    maps = torch.zeros(241, 8, 200, 200, dtype=torch.bool, device="meta")
    conditions = replace(clip.to("meta"), text=words, maps=maps)
    latent = torch.zeros(1, 96, 61, 28, 50, device="meta")
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as encoding:
        encoded = network.encode(conditions)
    with sdpa_kernel(SDPBackend.MATH), FlopCounterMode(display=False) as evaluation:
        found = network(latent, torch.zeros(1, device="meta"), encoded)
    expected = count_operations(config, published(224, 400, 4, 200))
    assert found.shape == latent.shape and found.dtype == torch.float32
    assert encoded.size.grid == (16, 25)
    assert evaluation.get_total_flops() == pytest.approx(expected.transformer, rel=1e-5)
    assert encoding.get_total_flops() == pytest.approx(expected.encoders, rel=1e-4)
