"""Occupancy: its grid, the residual blocks on it, and which cells look at which vehicles."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.occupancy import ATTENDED_ABOVE, DownBlock, OccupancyHead
from tests.adapters.networks.uniad.small_uniad import SMALL


def head() -> OccupancyHead:
    torch.manual_seed(0)
    return OccupancyHead(SMALL).eval()


def test_the_published_grid_is_that_of_the_specification() -> None:
    with torch.device("meta"):
        buffer = OccupancyHead(UniADConfig.base()).places
    assert buffer.shape == (1, 200, 200, 2)
    places = OccupancyHead(SMALL).places
    # The outermost centres of a 24 x 16 view of 24 m x 16 m are at 11.5 m and 7.5 m.
    np.testing.assert_allclose(places[0, 0, 0], [-7.75 / 11.5, -7.75 / 7.5], rtol=1e-6)
    np.testing.assert_allclose(places[0, 31, 0], [-7.75 / 11.5, 7.75 / 7.5], rtol=1e-6)


def test_resampling_finds_what_lies_there() -> None:
    """A view whose cells hold their own places gives the places of the occupancy grid."""
    centres = SMALL.grid.centres() * torch.tensor([24.0, 16.0]) - torch.tensor([12.0, 8.0])
    image = centres.T.reshape(1, 2, 16, 24)
    found = F.grid_sample(image, OccupancyHead(SMALL).places, align_corners=True)[0]
    axis = (torch.arange(32) + 0.5) * 0.5 - 8
    torch.testing.assert_close(found[0, 1:-1], axis.expand(30, 32), atol=1e-4, rtol=0)
    torch.testing.assert_close(found[1, 1:-1], axis[1:-1, None].expand(30, 32), atol=1e-4, rtol=0)


@pytest.mark.parametrize(("rows", "columns"), [(8, 6), (25, 25), (5, 4)])
def test_odd_grids_are_filled_with_zeros(rows: int, columns: int) -> None:
    torch.manual_seed(0)
    block = DownBlock(8).eval()
    features = torch.rand(1, 8, rows, columns)
    with torch.inference_mode():
        found = block(features)
        assert found.shape == (1, 8, -(-rows // 2), -(-columns // 2))
        larger = F.pad(features, (0, columns % 2, 0, rows % 2))
        torch.testing.assert_close(found, block.layers(features) + block.projection(F.max_pool2d(larger, 2)))


@pytest.mark.parametrize("count", [0, 1, 3, 40])
def test_occupied_is_where_any_vehicle_is_likely(count: int) -> None:
    torch.manual_seed(1)
    scores, rows = torch.rand(count), [torch.randn(count, 16) for _ in range(2)]
    with torch.inference_mode():
        found = head()(torch.randn(384, 16), torch.randn(count, 6, 16), *rows, scores)
    likely = found.logits.sigmoid().double() * scores[:, None, None, None]
    assert found.logits.shape == (count, 5, 32, 32)
    assert count == 0 or found.mask_logits.shape == (count, 5, 4, 4)
    assert torch.equal(found.occupied, (likely > SMALL.occupied_above).any(0))
    assert torch.equal(found.occupied, found.margin > 0)


def test_cells_that_no_vehicle_claims_look_at_all() -> None:
    """Attention with masks against one cell at a time."""
    torch.manual_seed(2)
    module = head()
    vehicles, present = torch.randn(3, 16), torch.randn(1, 16, 8, 8)
    seen: list[torch.Tensor] = []
    for layer in module.transformer_decoder.layers:
        layer.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[2]))
    with torch.inference_mode():
        _, masks, _ = module._futures(present, vehicles)
    for mask, allowed in zip(masks, seen, strict=True):
        for cell in range(16):
            claims = [bool(logit.sigmoid() >= ATTENDED_ABOVE) for logit in mask.flatten(1)[:, cell]]
            assert allowed[cell].tolist() == (claims if any(claims) else [True] * 3)
