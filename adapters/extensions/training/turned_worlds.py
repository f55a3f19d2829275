"""Drives as they are learned from: in a world that is turned, and without a word on how the ego moves.

No image shows where north is, so nothing may be learned from it; and a plan that can be read off the speed is not seen.
"""

import math
from dataclasses import replace

from torch import Tensor

from adapters.networks.layers.ego_motion import EgoMotion


def turned_can_bus(can_bus: Tensor, turn_rad: float) -> Tensor:
    """The same motion, (18,), in a world that is turned counter-clockwise around its origin.

    As `adapters.camera_inputs.can_bus_vector` gives it; motion itself is measured in the frame of the car and stays.
    """
    turned = can_bus.clone()
    cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
    turned[0] = cosine * can_bus[0] - sine * can_bus[1]
    turned[1] = sine * can_bus[0] + cosine * can_bus[1]
    heading_rad = (float(can_bus[16]) + turn_rad) % (2 * math.pi)
    turned[3:7] = abs(math.cos(heading_rad / 2))
    turned[16], turned[17] = heading_rad, math.degrees(heading_rad)
    return turned


def untold(motion: EgoMotion) -> EgoMotion:
    """The same motion, of which a network is not told; its view of before is aligned all the same."""
    silent = motion.can_bus.clone()
    silent[:3], silent[7:16] = 0.0, 0.0
    return replace(motion, can_bus=silent)
