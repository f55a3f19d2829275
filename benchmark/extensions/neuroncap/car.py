"""The car that NeuroNCAP drives and the box that it is checked with."""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from benchmark.constants import (
    EGO_BOX_FROM_LIDAR_M,
    EGO_CENTER_FROM_REAR_AXLE_M,
    EGO_LENGTH_M,
    EGO_WHEELBASE_M,
    EGO_WIDTH_M,
)
from benchmark.pdm.definition import COMFORT_CENTER_AHEAD_M, WHEELBASE_M
from benchmark.records.neuroncap_switches import Switches

SLIPPED_LENGTH_M: Final = 4.018
"""Of the ego's box in the published code: a slip of digits."""


@dataclass(frozen=True, slots=True)
class Car:
    """Numbers of the car.

    Attributes:
        wheelbase_m: Of tracker and bicycle.
        centre_ahead_m: Centre ahead of the rear axle, for the motion that is reported.
        box_ahead_m: Centre of the box of contact ahead of the rear axle.
        length_m: Of that box.
        width_m: Of that box.
    """

    wheelbase_m: float
    centre_ahead_m: float
    box_ahead_m: float
    length_m: float
    width_m: float

    @classmethod
    def of(cls, switches: Switches) -> Self:
        """The car of a reading."""
        as_code = switches.vehicle == "code"
        rounded = switches.ego_length == "code"
        return cls(
            wheelbase_m=WHEELBASE_M if as_code else EGO_WHEELBASE_M,
            centre_ahead_m=COMFORT_CENTER_AHEAD_M if as_code else EGO_CENTER_FROM_REAR_AXLE_M,
            box_ahead_m=EGO_BOX_FROM_LIDAR_M if switches.box_centre == "code" else EGO_CENTER_FROM_REAR_AXLE_M,
            length_m=float(np.float32(SLIPPED_LENGTH_M)) if rounded else EGO_LENGTH_M,
            width_m=float(np.float32(EGO_WIDTH_M)) if rounded else EGO_WIDTH_M,
        )
