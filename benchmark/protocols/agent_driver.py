"""The protocols ``agent-driver`` and ``agent-driver-stp3``: the two metrics of Agent-Driver's evaluation.

Both are UniAD's metric fed from stored rasters; those were never published, so the label rasters of UniAD and of VAD in
their own orientation stand in for them.

* ``agent-driver`` ("UniAD metric"): UniAD's rasters. x is negated twice, so that every verdict is that of ``uniad``,
  with its values at the step and its faults (`benchmark.protocols.uniad`). Every sample counts.
* ``agent-driver-stp3`` ("ST-P3 metric"): VAD's objects and rasters turned round (first row far behind, columns to the
  left), UniAD's block and point test with x negated once. Values are means over the steps up to the horizon. Every
  sample counts: steps after the end of a recording add nothing and stay in the denominator. It has nothing to do with
  ``stp3``.

Known faults: those of ``uniad`` and of ``vad`` in a new mixture. Turned round, the roundings of VAD's raster and
UniAD's block happen to agree, so that ``agent-driver-stp3`` has no shift to any side, and verdicts that are neither
VAD's nor UniAD's; the end of a scene dilutes its means.
"""

import numpy as np

from benchmark.geometry import Floats
from benchmark.protocols.contract import ProtocolOutcomes, average_masked_columns, average_up_to
from benchmark.protocols.raster import CELL_M, CELLS, EXTENT_M, Cells, compute_ego_cells, truncate_cells
from benchmark.protocols.uniad import UniADProtocol
from benchmark.protocols.vad import COUNTED_32, VADProtocol


class AgentDriverProtocol(UniADProtocol):
    """UniAD under another name; the module's docstring says why."""

    name = "agent-driver"
    version = 1


class AgentDriverSTP3Protocol(VADProtocol):
    """VAD's objects under UniAD's block, x mirrored; every sample counts, with means over the steps."""

    version = 1
    counts_incomplete = True

    def __init__(self, name: str = "agent-driver-stp3") -> None:
        super().__init__(name, COUNTED_32)

    def ego_block(self, waypoints_lidar: Floats) -> Cells:
        """The block on the turned raster, as cells of the raster that is drawn, (..., 32, 2)."""
        return CELLS - 1 - compute_mirrored_block(waypoints_lidar)

    def point_cells(self, waypoints_lidar: Floats) -> Floats:
        """The cell below each waypoint, as a cell of the raster that is drawn, (S, 6, 2)."""
        return CELLS - 1 - compute_mirrored_point(waypoints_lidar)

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Means over steps up to each horizon: ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``."""
        return average_masked_columns(outcomes, average_up_to)


def compute_mirrored_block(waypoints_lidar: Floats) -> Cells:
    """UniAD's block where x is to the left: (..., 32, 2) rows from behind and columns from the right."""
    return truncate_cells(compute_ego_cells(waypoints_lidar * [-1.0, 1.0]))


def compute_mirrored_point(waypoints_lidar: Floats) -> Floats:
    """The cell below each waypoint there, rounded towards zero, (..., 2)."""
    forward_left = waypoints_lidar[..., ::-1] * [1.0, -1.0]
    return np.asarray(np.trunc((forward_left + (EXTENT_M - 0.5 * CELL_M)) / CELL_M))
