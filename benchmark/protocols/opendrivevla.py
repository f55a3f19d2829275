"""The protocols ``opendrivevla`` and ``opendrivevla-stp3``: the two tables of OpenDriveVLA's evaluation.

Both are UniAD's metric fed from stored rasters; those were never published, so the label rasters of UniAD and of VAD in
their own orientation stand in for them.

* ``opendrivevla``: UniAD's rasters mirrored left to right, UniAD's block and point test with x negated once.
  ``collision`` is the value at the step ("UniAD" in its table); ``collision_mean`` is the mean of the same flags over
  the steps up to there ("ST-P3"), a column of its own.
* ``opendrivevla-stp3``: the same with VAD's rasters, which its text asks for in the "ST-P3" rows, and means. It is
  equal to ``agent-driver-stp3`` verdict by verdict (`benchmark.protocols.agent_driver`).

Every sample counts in both: steps after the end of a recording add nothing and stay in the denominator.

Known faults: those of ``uniad``, but mirrored the shift to the left is gone and that to the rear stays: the same plans
get other verdicts. Two averages of one set of flags stand in one table under the names of two metrics.
"""

from benchmark.geometry import Floats
from benchmark.protocols.agent_driver import AgentDriverSTP3Protocol, compute_mirrored_block, compute_mirrored_point
from benchmark.protocols.contract import ProtocolOutcomes, average_up_to
from benchmark.protocols.raster import CELLS, Cells
from benchmark.protocols.uniad import UniADProtocol


class OpenDriveVLAProtocol(UniADProtocol):
    """UniAD on mirrored rasters; the module's docstring says all."""

    name = "opendrivevla"
    version = 1

    def ego_block(self, waypoints_lidar: Floats) -> Cells:
        """The block on the mirrored raster, as cells of the raster that is drawn, (..., 32, 2)."""
        cells = compute_mirrored_block(waypoints_lidar)
        cells[..., 1] = CELLS - 1 - cells[..., 1]
        return cells

    def point_cells(self, waypoints_lidar: Floats) -> Floats:
        """The cell below each waypoint, as a cell of the raster that is drawn, (S, 6, 2)."""
        cells = compute_mirrored_point(waypoints_lidar)
        cells[..., 1] = CELLS - 1 - cells[..., 1]
        return cells

    def sample_values(self, outcomes: ProtocolOutcomes) -> dict[str, Floats]:
        """Values at each horizon, and as means up to it ``collision_mean`` and ``l2_mean``.

        The former are ``collision``, ``collision_before_mask``, ``obj_col`` and ``l2``.
        """
        means = {"collision_mean": average_up_to(outcomes.collision), "l2_mean": average_up_to(outcomes.l2)}
        return super().sample_values(outcomes) | means


class OpenDriveVLASTP3Protocol(AgentDriverSTP3Protocol):
    """``agent-driver-stp3`` under another name."""

    def __init__(self) -> None:
        super().__init__("opendrivevla-stp3")
