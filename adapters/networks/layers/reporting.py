"""Reported outputs of a network: boxes that count as its expectation, and headings of short plans."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from torch import Tensor

from benchmark.geometry import Floats


@dataclass(frozen=True, slots=True)
class ReportingRules:
    """Rules of reporting: which boxes count as forecasts, and which way a short plan leads.

    Attributes:
        least_score: Boxes of a lower score do not: networks always report a hundred or more.
        apart: Of two boxes whose centres are nearer than this share of the shorter one's length the more certain one
            counts alone: two things that long cannot be so near to each other, and small networks say many a thing
            twice. 0: all count, as published.
        steered_from_m: A plan that is shorter than this leads the more straight ahead the shorter it is, one of
            `STANDING_M` wholly: an error of decimetres aside, which is small anywhere else, would turn a car that
            crawls by as many degrees. 0: none, as published.
    """

    least_score: float = 0.3
    apart: float = 0.0
    steered_from_m: float = 0.0


PUBLISHED: Final = ReportingRules()
STANDING_M: Final = 1.0
"""A plan of this length has no direction."""


def find_distinct(centres: Tensor, lengths: Tensor, certainty: Tensor, apart: float) -> Tensor:
    """Mask of N centres that non-maximum suppression keeps, (N, 2) metres; of equal certainty the first counts."""
    if apart <= 0:
        return torch.ones(len(centres), dtype=torch.bool, device=centres.device)
    offset = centres[:, None] - centres
    near = offset.norm(dim=-1) < apart * torch.minimum(lengths[:, None], lengths)
    same = near.tolist()
    survivors: list[int] = []
    for place in certainty.argsort(descending=True, stable=True).tolist():
        if not any(same[place][earlier] for earlier in survivors):
            survivors.append(place)
    mask = torch.zeros(len(centres), dtype=torch.bool)
    mask[survivors] = True
    return mask.to(centres.device)


def limit_steering(plans: Floats, steered_from_m: float) -> Floats:
    """Plans, (..., S, 2) to the right and ahead in metres, with a smaller sideways offset where they hardly move.

    `steered_from_m` is 0 or more than `STANDING_M`.
    """
    if steered_from_m <= 0:
        return plans
    steps = np.diff(plans, axis=-2, prepend=np.zeros_like(plans[..., :1, :]))
    length = np.hypot(steps[..., 0], steps[..., 1]).sum(-1)
    share = np.clip((length - STANDING_M) / (steered_from_m - STANDING_M), 0.0, 1.0)
    return np.asarray(np.stack([plans[..., 0] * share[..., None], plans[..., 1]], -1))
