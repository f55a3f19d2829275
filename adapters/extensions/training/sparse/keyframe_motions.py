"""How the ego moved between key frames that are seen side by side, one of each clip.

A network plans one key frame at a time. In training most of the time would go by between its small operations, so
the same layers see B key frames at once: all tensors have a leading axis that those of the network do not have.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from adapters.networks.sparse.keyframe_pose import KeyframeMotion, KeyframePose, RigidMotion


@dataclass(frozen=True, slots=True)
class KeyframeMotions(RigidMotion):
    """Motions from the key frames before to the present ones, with (B, 1, 4, 4) matrices.

    `seconds` are (B, 1, 1), all of them fresh; the usual interval in the place of none (`KeyframeMotion.interval_s`).
    """

    seconds: Tensor

    @classmethod
    def between(cls, then: Sequence[KeyframePose], now: Sequence[KeyframePose], device: torch.device) -> Self:
        """What lies between pairs of poses."""
        found = [KeyframeMotion.between(*pair, device) for pair in zip(then, now, strict=True)]
        seconds = torch.tensor([each.interval_s for each in found], device=device)
        return cls(torch.stack([each.now_T_then for each in found])[:, None], seconds[:, None, None])

    @property
    def ego_velocity(self) -> Tensor:
        """(B, 1, 2) m/s, how the origins of the lidar frames have moved, seen from the present ones."""
        return -self.now_T_then[..., :2, 3] / self.seconds
