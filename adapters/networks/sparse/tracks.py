"""Numbers of tracked instances."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Tracks:
    """Numbers of the (K,) remembered instances, the most certain one first, and of the next new one.

    No number is used twice.
    """

    ids: Tensor
    next_id: Tensor


def number_instances(past: Tracks | None, fresh: bool, rows: Tensor, instances: int) -> tuple[Tensor, Tracks]:
    """Numbers, (instances,) int64, for every instance of a frame, and the tracks to leave.

    `fresh` says whether the first instances of this frame are those of the earlier one; `rows` are the (K,) instances
    that the next frame gets.
    """
    known = past.ids if past and fresh else rows.new_zeros(0)
    first = past.next_id if past else rows.new_zeros(())
    new = instances - len(known)
    ids = torch.cat([known, first + torch.arange(new, device=rows.device)])
    return ids, Tracks(ids[rows], first + new)
