"""Which key frames were labelled: labels that stop do so for all objects at once, traffic thins out one by one."""

import numpy as np
import pytest

from benchmark.datasets.annotated_objects import find_labelled_keyframes


@pytest.mark.parametrize(
    ("boxes", "labelled"),
    [
        ((0, 0, 0), "..."),
        ((4, 5, 3), "xxx"),
        ((4, 3, 0, 0), "xx.."),
        ((0, 0, 3, 4), "..xx"),
        ((4, 0, 0, 5), "x..x"),
        ((4, 2, 0, 0), "xxxx"),
        ((4, 2, 0, 1, 0), "xxxxx"),
        ((1, 0, 0, 3), "x..x"),
        ((), ""),
    ],
)
def test_a_stretch_without_boxes_beside_three_or_more_is_not_labelled(boxes: tuple[int, ...], labelled: str) -> None:
    found = find_labelled_keyframes(np.array(boxes, np.int64))
    assert "".join("x" if one else "." for one in found) == labelled
