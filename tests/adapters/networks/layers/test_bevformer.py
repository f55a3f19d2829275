"""The bird's-eye-view encoder cell by cell, camera by camera."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from adapters.networks.layers.bev_geometry import find_visible_cells
from adapters.networks.layers.bev_network import (
    BEVConfig,
    BEVFormerEncoder,
    BEVFormerLayer,
    ImageFeatures,
    SpatialCrossAttention,
    TemporalSelfAttention,
)
from tests.adapters.networks.layers.slow_sampling import slow_sampling
from tests.adapters.networks.layers.test_attention import perturb
from tests.adapters.networks.layers.test_bev_geometry import cameras

SIZES = BEVConfig(
    bev_rows=5,
    bev_columns=4,
    perception_range_m=(-15.0, -30.0, -2.0, 15.0, 30.0, 2.0),
    encoder_layers=2,
    decoder_layers=1,
    pyramid_levels=2,
    max_boxes=1,
    max_lines=1,
    backbone_blocks=(1, 1, 1, 1),
    channels=8,
    feedforward_channels=16,
    heads=2,
    height_points=2,
    image_points=4,
    bev_points=3,
)
GRID = SIZES.grid
SHAPES = ((3, 5), (2, 3))


def linear(layer: Any, tokens: torch.Tensor) -> torch.Tensor:
    result: torch.Tensor = tokens.double() @ layer.weight.double().T + layer.bias.double()
    return result


def shares(logits: torch.Tensor) -> torch.Tensor:
    return logits.exp() / logits.exp().sum(-1, keepdim=True)


def slow_temporal(
    module: Any, cells: torch.Tensor, positions: torch.Tensor, references: torch.Tensor, pair: list[torch.Tensor]
) -> torch.Tensor:
    """Each view on its own, then the mean."""
    query = torch.cat([pair[0], cells + positions], -1)
    offsets = linear(module.sampling_offsets, query).view(GRID.cells, 2, 2, 3, 2)
    weights = shares(linear(module.attention_weights, query).view(GRID.cells, 2, 2, 3))
    total = torch.zeros(GRID.cells, 8, dtype=torch.float64)
    for number, view in enumerate(pair):
        values = linear(module.value_proj, view).view(1, GRID.cells, 2, 4)
        own = (offsets[:, :, number : number + 1], weights[:, :, number : number + 1])
        total += slow_sampling(values, [GRID.shape], references[:, None, None, None], *own) / 2
    return cells + linear(module.output_proj, total)


def slow_spatial(module: Any, cells: torch.Tensor, features: torch.Tensor, projections: torch.Tensor) -> torch.Tensor:
    """Each camera on its own, over all cells, masked afterwards."""
    pattern = module.deformable_attention
    pillars = GRID.pillars(2)
    offsets = linear(pattern.sampling_offsets, cells).view(GRID.cells, 2, 2, 4, 2)
    weights = shares(linear(pattern.attention_weights, cells).view(GRID.cells, 2, 8)).view(GRID.cells, 2, 2, 4)
    total, count = torch.zeros(GRID.cells, 8, dtype=torch.float64), torch.zeros(GRID.cells)
    for camera, matrix in enumerate(projections):
        places = torch.cat([pillars, torch.ones(GRID.cells, 2, 1)], -1).double() @ matrix.T
        depth = places[..., 2:3].clamp(min=1e-5)
        points = places[..., :2] / depth / torch.tensor([100.0, 60.0])
        seen = ((places[..., 2] > 1e-5) & ((points > 0) & (points < 1)).all(-1)).any(-1)
        values = linear(pattern.value_proj, features[camera]).view(1, -1, 2, 4)
        # Points 0 and 2 are of the lower height, 1 and 3 of the upper.
        references = points[:, [0, 1, 0, 1]][:, None, None]
        sampled = slow_sampling(values, SHAPES, references, offsets, weights)
        total += sampled * seen[:, None]
        count += seen
    return cells + linear(module.output_proj, total / count.clamp(min=1)[:, None])


@pytest.mark.parametrize("past", [False, True])
def test_temporal_attention_is_the_mean_of_two_views(past: bool) -> None:
    torch.manual_seed(0)
    module = TemporalSelfAttention(8, 2, 3)
    perturb(module)
    cells, positions, before, present = (torch.randn(GRID.cells, 8) for _ in range(4))
    references = GRID.centres() + torch.tensor([0.1, -0.05])
    views = (before, present) if past else None
    with torch.no_grad():
        found = module(cells, positions, references, GRID.shape, views)
        expected = slow_temporal(module, cells, positions, references, list(views or (cells, cells)))
    torch.testing.assert_close(found.double(), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_spatial_attention_is_the_mean_of_the_cameras_that_see_a_cell(seed: int) -> None:
    torch.manual_seed(seed)
    module, projections = SpatialCrossAttention(8, 2, len(SHAPES), 4), cameras(seed)
    perturb(module)
    cells, features = torch.randn(GRID.cells, 8), torch.randn(len(projections), 21, 8)
    hits = find_visible_cells(GRID.pillars(2), projections, 60, 100)
    with torch.no_grad():
        found = module(cells, features, SHAPES, hits)
        expected = slow_spatial(module, cells, features, projections)
    # Points near a camera's plane are so far outside that single precision places them a little elsewhere.
    torch.testing.assert_close(found.double(), expected, rtol=1e-3, atol=1e-3)


def test_cells_that_no_camera_sees_stay_as_they_are() -> None:
    module: Any = SpatialCrossAttention(8, 2, len(SHAPES), 4)
    cells, features = torch.randn(GRID.cells, 8), torch.randn(2, 21, 8)
    nothing = find_visible_cells(GRID.pillars(2), torch.zeros(2, 4, 4), 60, 100)
    with torch.no_grad():
        assert torch.equal(module(cells, features, SHAPES, nothing), cells)
    with pytest.raises(ValueError, match="shared evenly"):
        BEVFormerEncoder(replace(SIZES, image_points=3))


@pytest.mark.parametrize("past", [False, True])
def test_an_encoder_keeps_the_first_queries_as_the_present(past: bool) -> None:
    torch.manual_seed(3)
    encoder: Any = BEVFormerEncoder(SIZES)
    perturb(encoder)
    cells, positions, before = (torch.randn(GRID.cells, 8) for _ in range(3))
    projections, features = cameras(5), torch.randn(3, 21, 8)
    images, shift = ImageFeatures(features, SHAPES, 60, 100), torch.tensor([0.03, -0.1])
    with torch.no_grad():
        found = encoder(cells, positions, images, projections, shift, before if past else None)
        tokens = cells
        for layer in encoder.layers:
            pair = [before, cells] if past else [tokens, tokens]
            attended = slow_temporal(layer.attentions[0], tokens, positions, GRID.centres() + shift, pair)
            tokens = layer.norms[0](attended.float())
            tokens = layer.norms[1](slow_spatial(layer.attentions[1], tokens, features, projections).float())
            tokens = layer.norms[2](layer.ffns[0](tokens))
    torch.testing.assert_close(found, tokens, rtol=1e-3, atol=2e-3)


def test_features_know_their_camera_and_level() -> None:
    maps = [torch.randn(2, 4, rows, columns) for rows, columns in SHAPES]
    cameras_embedding, levels_embedding = torch.randn(2, 4), torch.randn(4, 4)
    found = ImageFeatures.of(maps, torch.zeros(2, 3, 24, 40), cameras_embedding, levels_embedding)
    expected = maps[1][1, :, 1, 2] + cameras_embedding[1] + levels_embedding[1]
    torch.testing.assert_close(found.features[1, 15 + 1 * 3 + 2], expected)
    assert (found.shapes, found.height, found.width) == (SHAPES, 24, 40)


def test_a_layer_is_one_graph() -> None:
    """Nothing in it waits for the device or branches on data, which tracing it as a whole would refuse."""
    torch.manual_seed(4)
    layer: Any = BEVFormerLayer(8, 2, 16, levels=2, bev_points=3, image_points=4)
    perturb(layer)
    cells, positions = torch.randn(GRID.cells, 8), torch.randn(GRID.cells, 8)
    images, hits = (
        ImageFeatures(torch.randn(3, 21, 8), SHAPES, 60, 100),
        find_visible_cells(GRID.pillars(2), cameras(1), 60, 100),
    )
    arguments = (cells, positions, GRID.centres(), GRID.shape, None, images, hits)
    with torch.inference_mode():
        expected = layer(*arguments)
        layer.compile(backend="eager", fullgraph=True)
        assert torch.equal(layer(*arguments), expected)
