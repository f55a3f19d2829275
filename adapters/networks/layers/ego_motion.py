"""Ego motion since the previous key frame, and the ego status told to the plan of a small network."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.bev_geometry import BEVGrid, previous_cell_matrix

CAN_BUS = 18
"""Numbers of a CAN bus vector: position (0:3), orientation (3:7), acceleration, rotation rate, velocity (7:16), yaw in
radians (16) and in degrees (17)."""


@dataclass(frozen=True, slots=True)
class BEVMotion:
    """Motion since the previous key frame; zero in the first one.

    `can_bus` is (18,) float64, position and yaw in degrees as differences, all else absolute; `shift` (2,) float32 x, y
    in the lidar frame, 1 for the length of the bird's-eye view; `previous_cells` (2, 3) float32 from
    `adapters.networks.layers.bev_geometry.previous_cell_matrix`.
    """

    can_bus: Tensor
    shift: Tensor
    previous_cells: Tensor

    @classmethod
    def between(
        cls, previous: Tensor | None, present: Tensor, grid: BEVGrid, rotation_centre: tuple[float, float]
    ) -> "BEVMotion":
        """Motion between two absolute CAN bus vectors, (18,) float64; on the processor.

        `previous` is ``None`` in the first frame of a scene; `rotation_centre` is column and row in cells.
        """
        motion = present.detach().to("cpu", torch.float64, copy=True)
        # The turn may exceed 360 degrees and is not wrapped: the published weights were trained so.
        if previous is None:
            motion[:3], motion[17] = 0.0, 0.0
        else:
            motion[:3] -= previous[:3]
            motion[17] -= previous[17]
        x, y, turn_deg = float(motion[0]), float(motion[1]), float(motion[17])
        heading = math.radians(math.degrees(float(motion[16])) - math.degrees(math.atan2(y, x)))
        length = math.hypot(x, y)
        x_low, y_low, _, x_high, y_high, _ = grid.range_m
        shift = [length * math.sin(heading) / (x_high - x_low), length * math.cos(heading) / (y_high - y_low)]
        return cls(
            motion,
            torch.tensor(shift, dtype=torch.float32, device="cpu"),
            previous_cell_matrix(grid, turn_deg, rotation_centre),
        )

    def to(self, device: torch.device) -> "BEVMotion":
        """Motion on a device, in single precision, with one transfer."""
        packed = torch.cat([self.can_bus.float(), self.shift, self.previous_cells.flatten()]).to(device)
        return BEVMotion(packed[:CAN_BUS], packed[CAN_BUS : CAN_BUS + 2], packed[CAN_BUS + 2 :].view(2, 3))


CAN_BUS_INDICES = (13, 7, 12)
"""Places in the CAN bus vector: speed, acceleration and yaw rate."""
TYPICAL_VALUES = (10.0, 3.0, 0.3)
"""How large they are, m/s, m/s^2 and rad/s."""


class EgoStatusEncoder(nn.Module):
    """Message to a plan of speed, acceleration and yaw rate; untrained it says nothing.

    Through the cells of a small bird's-eye view the plan learns the speed to a few tenths of a metre per second only,
    and such an error comes back with every plan of a drive.
    """

    places: Tensor
    usual: Tensor

    def __init__(self, told: int) -> None:
        super().__init__()
        self.tell = nn.Linear(len(CAN_BUS_INDICES), told)
        nn.init.zeros_(self.tell.weight)
        nn.init.zeros_(self.tell.bias)
        self.register_buffer("places", torch.tensor(CAN_BUS_INDICES), persistent=False)
        self.register_buffer("usual", torch.tensor(TYPICAL_VALUES), persistent=False)

    def forward(self, can_bus: Tensor) -> Tensor:
        """(18,) CAN bus vector to (1, told)."""
        assert can_bus.shape == (CAN_BUS,)
        result: Tensor = self.tell((can_bus[self.places] / self.usual).to(self.tell.weight.dtype)[None])
        return result
