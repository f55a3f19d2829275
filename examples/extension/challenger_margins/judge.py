"""``margin``: as ``exact``, and a step also counts if the ego comes within 0.3 m of anything."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmark.geometry import Floats
from benchmark.protocols.contract import ProtocolOutcomes
from benchmark.protocols.exact import ExactProtocol
from benchmark.truth import SampleTruth

MARGIN_M = 0.3


class MarginProtocol(ExactProtocol):
    """The protocol ``exact`` with every object larger by the margin on each side."""

    name = "margin"
    # Raised whenever a verdict may change, also if that of `ExactProtocol` does.
    version = 1

    def evaluate(self, truths: Sequence[SampleTruth], plans_lidar: Floats) -> ProtocolOutcomes:
        """Judge plans beside the larger objects."""
        wider = 2.0 * MARGIN_M * np.array([0.0, 0.0, 1.0, 1.0, 0.0])
        around = [replace(truth, boxes=truth.boxes + wider) for truth in (each.by_clock for each in truths)]
        return super().evaluate(around, plans_lidar)
