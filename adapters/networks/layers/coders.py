"""Between what networks predict and metres: boxes, lines and the logits of positions."""

from collections.abc import Sequence

import torch
from torch import Tensor


def logit(shares: Tensor, closest: float = 1e-5) -> Tensor:
    """Inverse of the sigmoid, finite at both ends: neither a number nor its complement counts as less than `closest`.

    Numbers outside 0 to 1 are moved to the nearer end.
    """
    shares = shares.clamp(0, 1)
    return torch.log(shares.clamp(min=closest) / (1 - shares).clamp(min=closest))


def metres(shares: Tensor, lower: Sequence[float], upper: Sequence[float]) -> Tensor:
    """Positions in metres from shares, (..., D) of 0 to 1, of a range between two corners of D coordinates."""
    axes = [shares[..., axis] * (high - low) + low for axis, (low, high) in enumerate(zip(lower, upper, strict=True))]
    return torch.stack(axes, -1)


def box_codes(centres: Tensor, corrections: Tensor) -> Tensor:
    """Codes of boxes from (..., 3) centres in metres and the (..., 10) corrections of a branch: all but 0, 1 and 4.

    (..., 10) x, y, log width, log length, z, log height, sin yaw, cos yaw, velocity x, y.
    """
    x_y, z = centres[..., :2], centres[..., 2:3]
    return torch.cat([x_y, corrections[..., 2:4], z, corrections[..., 5:]], -1)


def decode_boxes(codes: Tensor) -> Tensor:
    """Boxes from their codes, (..., 10) as `box_codes` gives them.

    (..., 9) centre x, y, z, width, length, height, yaw, velocity x, y; sine and cosine need not be of one circle.
    """
    x_y, z = codes[..., 0:2], codes[..., 4:5]
    sizes = torch.cat([codes[..., 2:4], codes[..., 5:6]], -1).exp()
    yaw = torch.atan2(codes[..., 6:7], codes[..., 7:8])
    return torch.cat([x_y, z, sizes, yaw, codes[..., 8:10]], -1)


def strongest(logits: Tensor, limit: int) -> tuple[Tensor, Tensor, Tensor]:
    """The most certain pairs of query and class; a query may appear with several classes.

    Scores 0 to 1, falling; classes; queries; from (Q, classes) logits.
    """
    scores, pairs = logits.float().sigmoid().flatten().topk(min(limit, logits.numel()))
    classes = logits.shape[-1]
    return scores, pairs % classes, pairs // classes


def line_extent(points: Tensor) -> Tensor:
    """Smallest upright rectangle, (..., 4) centre x, y, width, height, around a line of (..., P, 2)."""
    low, high = points.amin(-2), points.amax(-2)
    return torch.cat([(low + high) / 2, high - low], -1)


def extent_corners(extents: Tensor) -> Tensor:
    """(..., 4) centre x, y, width, height to (..., 4) lower x, y, upper x, y."""
    centre, size = extents[..., :2], extents[..., 2:]
    return torch.cat([centre - size / 2, centre + size / 2], -1)


def within(coordinates: Tensor, lower: Sequence[float], upper: Sequence[float]) -> Tensor:
    """Whether all of (..., D) coordinates lie in a closed range: (...) booleans."""
    inside = [
        (coordinates[..., axis] >= low) & (coordinates[..., axis] <= high)
        for axis, (low, high) in enumerate(zip(lower, upper, strict=True))
    ]
    return torch.stack(inside).all(0)
