"""Which of a network's boxes count as what it expects of others."""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Reporting:
    """What counts as a forecast.

    Attributes:
        least_score: Boxes of a lower score do not: networks always report a hundred or more.
        apart: Of two boxes whose centres are nearer than this share of the shorter one's length the more certain one
            counts alone: two things that long cannot be so near to each other, and small networks say many a thing
            twice. 0: all count, as published.
    """

    least_score: float = 0.3
    apart: float = 0.0


PUBLISHED: Final = Reporting()


def said_once(centres: Tensor, lengths: Tensor, certainty: Tensor, apart: float) -> Tensor:
    """Leave out what says again what a more certain one has said (non-maximum suppression).

    Args:
        centres: (N, 2) metres.
        lengths: (N,) metres.
        certainty: (N,) the greater, the earlier; of equal ones the first is the earlier.
        apart: As in `Reporting`.

    Returns:
        (N,) whether each is left.
    """
    if apart <= 0:
        return torch.ones(len(centres), dtype=torch.bool, device=centres.device)
    offset = centres[:, None] - centres
    near = offset.norm(dim=-1) < apart * torch.minimum(lengths[:, None], lengths)
    same = near.tolist()
    kept: list[int] = []
    for place in certainty.argsort(descending=True, stable=True).tolist():
        if not any(same[place][earlier] for earlier in kept):
            kept.append(place)
    left = torch.zeros(len(centres), dtype=torch.bool)
    left[kept] = True
    return left.to(centres.device)
