"""Codes of boxes and lines, logits, and positional encodings, by hand."""

import math

import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.networks.layers.attention import LearnedGridEncoding, sine_features, sine_grid_encoding
from adapters.networks.layers.deformable_decoder import (
    are_within,
    box_codes,
    decode_boxes,
    extent_corners,
    line_extent,
    logit,
    select_strongest,
    to_metres,
)


@settings(max_examples=20)
@given(st.floats(1e-4, 1 - 1e-4))
def test_logit_undoes_the_sigmoid_and_is_finite_at_both_ends(share: float) -> None:
    number, bound = torch.tensor(share, dtype=torch.float64), math.log(1 / 1e-5)
    torch.testing.assert_close(torch.sigmoid(logit(number)), number)
    ends = logit(torch.tensor([-1.0, 0.0, 1.0, 2.0], dtype=torch.float64))
    torch.testing.assert_close(ends, torch.tensor([-bound, -bound, bound, bound], dtype=torch.float64))


def test_a_box_comes_back_from_its_code() -> None:
    yaw, size = 2.5, torch.tensor([2.0, 4.5, 1.6])
    corrections = torch.tensor([[9.0, 9.0, math.log(2.0), math.log(4.5), 9.0, math.log(1.6)]])
    corrections = torch.cat([corrections, torch.tensor([[3 * math.sin(yaw), 3 * math.cos(yaw), 0.5, -1.0]])], 1)
    centre = to_metres(torch.tensor([[0.5, 0.25, 1.0]]), (-15, -30, -2), (15, 30, 2))
    box = decode_boxes(box_codes(centre, corrections))[0]
    torch.testing.assert_close(box, torch.tensor([0.0, -15.0, 2.0, *size.tolist(), yaw, 0.5, -1.0]))


def test_strongest_pairs_of_query_and_class() -> None:
    scores, labels, queries = select_strongest(torch.tensor([[0.0, 3.0], [2.0, 1.0]]), 3)
    assert (labels.tolist(), queries.tolist()) == ([1, 0, 1], [0, 1, 1])
    torch.testing.assert_close(scores, torch.tensor([3.0, 2.0, 1.0]).sigmoid())
    assert len(select_strongest(torch.zeros(2, 2), 100)[0]) == 4


def test_lines_and_ranges() -> None:
    extent = line_extent(torch.tensor([[1.0, 5.0], [3.0, 1.0], [2.0, 2.0]]))
    assert extent.tolist() == [2.0, 3.0, 2.0, 4.0]
    assert extent_corners(extent).tolist() == [1.0, 1.0, 3.0, 5.0]
    places = torch.tensor([[0.0, 0.0], [2.0, 0.0], [0.0, -3.1]])
    assert are_within(places, (-2, -3), (2, 3)).tolist() == [True, True, False]


def test_learned_encoding_puts_the_column_first() -> None:
    encoding = LearnedGridEncoding(3, 5, 8)
    assert list(encoding.state_dict()) == ["row_embed.weight", "col_embed.weight"]
    cell = encoding()[2 * 5 + 4]
    assert torch.equal(cell, torch.cat([encoding.col_embed.weight[4], encoding.row_embed.weight[2]]))


def test_sines_by_hand() -> None:
    features = sine_features(torch.tensor([0.7], dtype=torch.float64), 6)[0]
    for pair in range(3):
        angle = 0.7 / 10000 ** (2 * pair / 6)
        expected = torch.tensor([math.sin(angle), math.cos(angle)], dtype=torch.float64)
        torch.testing.assert_close(features[2 * pair : 2 * pair + 2], expected)
    grid = sine_grid_encoding(3, 4, 6)
    row, column = (2 + 1 - 0.5) / 3 * 2 * math.pi, (1 + 1 - 0.5) / 4 * 2 * math.pi
    expected = torch.cat([sine_features(torch.tensor(row), 6), sine_features(torch.tensor(column), 6)])
    torch.testing.assert_close(grid[2 * 4 + 1], expected, rtol=1e-4, atol=1e-4)
