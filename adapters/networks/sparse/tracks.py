"""Numbers of tracked instances."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class Tracks:
    """Who is who, after a frame.

    Attributes:
        ids: (K,) int64, numbers of the instances that are remembered, the most certain one first.
        next_id: () int64, what the next new instance is called; no number is used twice.
    """

    ids: Tensor
    next_id: Tensor


def number_instances(past: Tracks | None, fresh: bool, rows: Tensor, instances: int) -> tuple[Tensor, Tracks]:
    """Give every instance of a frame a number.

    Args:
        past: What an earlier frame left.
        fresh: Whether the first instances of this frame are those of the earlier one.
        rows: (K,) instances that the next frame gets.
        instances: How many there are in all.

    Returns:
        (instances,) int64 numbers, and what to leave.
    """
    known = past.ids if past and fresh else rows.new_zeros(0)
    first = past.next_id if past else rows.new_zeros(())
    new = instances - len(known)
    ids = torch.cat([known, first + torch.arange(new, device=rows.device)])
    return ids, Tracks(ids[rows], first + new)
