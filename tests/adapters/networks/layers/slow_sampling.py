"""Deformable sampling one number at a time: the oracle of everything that samples."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor


def bilinear(image: Tensor, x: float, y: float) -> Tensor:
    """(rows, columns, c) at pixel coordinates whose whole numbers are centres; zero outside."""
    rows, columns, _ = image.shape
    result = torch.zeros(image.shape[2], dtype=torch.float64)
    left, top = math.floor(x), math.floor(y)
    for column, across in ((left, 1 - (x - left)), (left + 1, x - left)):
        for row, along in ((top, 1 - (y - top)), (top + 1, y - top)):
            if 0 <= column < columns and 0 <= row < rows:
                result += across * along * image[row, column].double()
    return result


def slow_sampling(
    values: Tensor,
    shapes: Sequence[tuple[int, int]],
    references: Tensor,
    offsets: Tensor,
    weights: Tensor,
    source: Tensor | None = None,
) -> Tensor:
    queries, heads, levels, points, _ = offsets.shape
    references = references.expand(offsets.shape)
    result = torch.zeros(queries, heads, values.shape[-1], dtype=torch.float64)
    for query in range(queries):
        maps = values[0 if source is None else int(source[query])]
        for head in range(heads):
            start = 0
            for level in range(levels):
                rows, columns = shapes[level]
                image = maps[start : start + rows * columns, head].reshape(rows, columns, -1)
                start += rows * columns
                for point in range(points):
                    place = (query, head, level, point)
                    x = float(references[place][0]) * columns + float(offsets[place][0]) - 0.5
                    y = float(references[place][1]) * rows + float(offsets[place][1]) - 0.5
                    result[query, head] += float(weights[place]) * bilinear(image, x, y)
    return result.flatten(1)
