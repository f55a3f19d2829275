"""When and where a key frame was taken, and what lies between two of them."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

USUAL_INTERVAL_S = 0.5
"""Between key frames; it stands in where there is no past."""
LONGEST_INTERVAL_S = 2.0
"""What is remembered is stale after this."""


@dataclass(frozen=True, slots=True)
class KeyframePose:
    """When and where.

    Attributes:
        global_T_lidar: (4, 4) float64 on the processor, lidar frame to world.
    """

    timestamp_s: float
    global_T_lidar: Tensor
    scene_token: str


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """Motion from remembered frames to present ones, of one clip or of several side by side.

    Attributes:
        now_T_then: (..., 4, 4) float32, lidar frame of the remembered frame to that of the present one.
        seconds: In between; a tensor where there are several.
    """

    now_T_then: Tensor
    seconds: Tensor | float

    @property
    def fresh(self) -> bool:
        """Whether memory is recent enough to be used."""
        return True

    @property
    def interval_s(self) -> Tensor | float:
        """By which predicted changes of speed are divided."""
        return self.seconds

    def move(self, points: Tensor) -> Tensor:
        """(..., D) points with D = 2 or 3 coordinates, seen from the present lidar frame."""
        axes = points.shape[-1]
        return self.turn(points) + self.now_T_then[..., :axes, 3]

    def turn(self, vectors: Tensor) -> Tensor:
        """(..., D) vectors with D = 2 or 3 coordinates, in the present lidar frame."""
        axes = vectors.shape[-1]
        # Written out, because matrix products may run in reduced precision.
        return (vectors[..., None, :] * self.now_T_then[..., :axes, :axes]).sum(-1)


@dataclass(frozen=True, slots=True)
class KeyframeMotion(RigidMotion):
    """Motion from a remembered frame to the present one, with one matrix.

    `seconds` is rounded to single precision, and negative if frames come out of order.
    """

    seconds: float

    @classmethod
    def between(cls, then: KeyframePose, now: KeyframePose, device: torch.device) -> "KeyframeMotion":
        """Motion between two poses; the matrix is put on the device."""
        # World coordinates are large, so the product is in double precision.
        matrix = torch.linalg.inv(now.global_T_lidar) @ then.global_T_lidar
        return cls(matrix.float().to(device), float(np.float32(now.timestamp_s - then.timestamp_s)))

    @property
    def fresh(self) -> bool:
        """Whether memory is recent enough to be used."""
        return abs(self.seconds) <= LONGEST_INTERVAL_S

    @property
    def interval_s(self) -> float:
        """By which predicted changes of speed are divided."""
        return self.seconds if self.fresh and self.seconds != 0 else USUAL_INTERVAL_S

    @property
    def ego_velocity(self) -> Tensor:
        """(2,) m/s, how the origin of the lidar frame has moved, seen from the present frame."""
        return -self.now_T_then[:2, 3] / self.interval_s
