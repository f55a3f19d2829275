"""The map head's attention as its kernel walks through memory, and masks that are pasted on the ground."""

import pytest
import torch

from adapters.networks.layers.deformable_attention import DeformableAttention
from adapters.networks.uniad.map_head import MapHead, PublishedOrderAttention
from adapters.networks.uniad.map_masks import MaskDecoder, paste_masks, rank_masks
from tests.adapters.networks.layers.slow_sampling import slow_sampling
from tests.adapters.networks.uniad.small_uniad import SMALL

SHAPE = (3, 5)


def attention(levels: int, points: int = 3) -> PublishedOrderAttention:
    torch.manual_seed(levels)
    module = PublishedOrderAttention(8, 2, levels, points).double().eval()
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.normal_(0, 0.4)
    return module.requires_grad_(False)


@pytest.mark.parametrize(("count", "size"), [(8, 2), (11, 2), (7, 4), (1, 4)])
def test_the_walk_through_the_buffers(count: int, size: int) -> None:
    """The buffers of all queries, heads, levels and points in a row; the kernel takes heads * points for each query."""
    module = attention(4)
    tokens, positions, cells = torch.randn(count, 8), torch.randn(count, 8), torch.randn(15, 8)
    tokens, positions, cells = tokens.double(), positions.double(), cells.double()
    references = torch.rand(count, size).double()
    query = tokens + positions
    offsets = module.sampling_offsets(query).view(count, 2, 4, 3, 2)
    weights = module.attention_weights(query).view(count, 2, 12).softmax(-1)
    steps = torch.tensor([5.0, 3.0]).double()
    if size == 2:
        places = references[:, None, None, None] + offsets / steps
    else:
        places = references[:, None, None, None, :2] + offsets / 3 * references[:, None, None, None, 2:] / 2
    walked = places.reshape(-1)[: count * 2 * 3 * 2].view(count, 2, 1, 3, 2)
    shares = weights.reshape(-1)[: count * 2 * 3].view(count, 2, 1, 3)
    values = module.value_proj(cells).view(1, 15, 2, 4)
    nowhere = torch.zeros(count, 1, 1, 1, 2).double()
    sampled = slow_sampling(values, [SHAPE], nowhere, walked * steps, shares)
    expected = tokens + module.output_proj(sampled)
    torch.testing.assert_close(module(tokens, positions, references, cells, (SHAPE,)), expected, rtol=1e-4, atol=1e-5)


def test_with_one_level_it_is_ordinary_attention() -> None:
    module = attention(1)
    plain = DeformableAttention(8, 2, 1, 3).double().eval()
    plain.load_state_dict(module.state_dict())
    rows = [torch.randn(6, 8).double(), torch.randn(6, 8).double(), torch.rand(6, 2).double()]
    cells = torch.randn(15, 8).double()
    torch.testing.assert_close(module(*rows, cells, (SHAPE,)), plain(*rows, cells, (SHAPE,)))


def test_map_elements_and_masks_have_their_shapes() -> None:
    torch.manual_seed(0)
    head = MapHead(SMALL).eval()
    with torch.inference_mode():
        elements = head(torch.randn(SMALL.grid.cells, 16))
        masks = head.masks(elements)
    assert elements.rectangles.shape == (2, 9, 4) and elements.class_logits.shape == (2, 9, 3)
    assert ((elements.rectangles >= 0) & (elements.rectangles <= 1)).all()
    assert masks.values.shape == (5, 16, 24) and masks.drivable_values.shape == (16, 24)
    assert (masks.values >= 0).all() and (masks.scores.diff() <= 0).all()


def test_queries_with_positions_carry_them_along() -> None:
    """The position is added to the running query before every block and at the end."""
    torch.manual_seed(0)
    decoder = MaskDecoder(8, 2, 2, attend_each_other=True).eval()
    tokens, positions, cells = torch.randn(3, 8), torch.randn(3, 8), torch.randn(15, 8)
    with torch.inference_mode():
        running = tokens
        for block in decoder.blocks:
            running = block(running + positions, cells)
        expected = decoder.attnen(running + positions, cells)
        torch.testing.assert_close(decoder(tokens, positions, cells), expected)


def squares() -> torch.Tensor:
    values = torch.zeros(4, 6, 6)
    values[0, :3], values[1, 1:4], values[2, 2:5], values[3, 5:] = 2.0, 3.0, 4.0, 0.4
    return values


def test_masks_of_class_zero_take_no_place_and_those_of_other_classes_do() -> None:
    values, scores = squares(), torch.tensor([0.9, 0.5, 0.3, 0.9])
    final, order = rank_masks(values, scores)
    areas = torch.tensor([18.0, 18.0, 18.0])
    expected = scores[:3] * (torch.tensor([2.0, 3.0, 4.0]) * areas / (areas + 1)) ** 2
    assert order.tolist() == [2, 1, 0, 3]
    torch.testing.assert_close(final, torch.cat([expected[[2, 1, 0]], torch.zeros(1)]))
    road = paste_masks(values, final, order, torch.zeros(4, dtype=torch.int64), values[0], 3)
    assert road.lanes[0].sum() == 30 and not road.lanes[1:].any()
    assert road.lane_values[0, :, 0].tolist() == [2, 2, 2, 3, 4, 0]
    assert road.drivable.sum() == 18
    # The second is covered to two thirds by the third, the first to one third.
    road = paste_masks(values, final, order, torch.tensor([1, 2, 1, 1]), values[0], 3)
    assert not road.lanes[2].any()
    assert road.lane_values[1, :, 0].tolist() == [2, 2, 4, 4, 4, 0]
    # Weak masks are left out.
    road = paste_masks(values, *rank_masks(values, torch.full((4,), 0.004)), torch.ones(4).long(), values[3], 3)
    assert not road.lanes.any() and not road.drivable.any()
