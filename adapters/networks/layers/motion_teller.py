"""How the ego moves, told to the plan of a small network."""

import torch
from torch import Tensor, nn

from adapters.networks.layers.ego_motion import CAN_BUS

READ = (13, 7, 12)
"""Places in the CAN bus vector: speed, acceleration and yaw rate."""
USUAL = (10.0, 3.0, 0.3)
"""How large they are, m/s, m/s^2 and rad/s."""


class MotionTeller(nn.Module):
    """Message to a plan of speed, acceleration and yaw rate; nothing before it has learned.

    Through the cells of a small bird's-eye view it learns the speed to a few tenths of a metre per second only, and
    such an error comes back with every plan of a drive.
    """

    places: Tensor
    usual: Tensor

    def __init__(self, told: int) -> None:
        super().__init__()
        self.tell = nn.Linear(len(READ), told)
        nn.init.zeros_(self.tell.weight)
        nn.init.zeros_(self.tell.bias)
        self.register_buffer("places", torch.tensor(READ), persistent=False)
        self.register_buffer("usual", torch.tensor(USUAL), persistent=False)

    def forward(self, can_bus: Tensor) -> Tensor:
        """(18,) CAN bus vector to (1, told)."""
        assert can_bus.shape == (CAN_BUS,)
        result: Tensor = self.tell((can_bus[self.places] / self.usual).to(self.tell.weight.dtype)[None])
        return result
