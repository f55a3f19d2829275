"""``overshoot``: the default engine with a car that goes 5 % farther than each plan says."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from benchmark.closed_loop.default_engine import DefaultBackend, DefaultSimulationState
from benchmark.closed_loop.simulation_state import RecordedCan, RejectedPlanError, SimulationState
from benchmark.errors import InputError
from benchmark.planning import Plan
from benchmark.records.drive_schema import RECORDED
from benchmark.scene import Scene


def stretch(plan: Plan) -> Plan:
    """The plan that is really driven."""
    return replace(plan, waypoints=1.05 * plan.waypoints)


class OvershootState(DefaultSimulationState):
    """A drive at a planning instant."""

    def after(self, plan: Plan) -> DefaultSimulationState:
        """Half a second later."""
        return super().after(stretch(plan))


@dataclass(frozen=True)
class OvershootBackend(DefaultBackend):
    """Begins drives; see `benchmark.closed_loop.simulation_state.SimulatorBackend`."""

    def begin(self, scene: Scene, run: int, can: RecordedCan, family: str = "") -> OvershootState:
        """The drive at its first planning instant."""
        state = super().begin(scene, run, can, family)
        return OvershootState(state.scene, state.course, state.world, state.motion)

    def advance_together(
        self, rides: Sequence[SimulationState], plans: Sequence[Plan]
    ) -> list[SimulationState | RejectedPlanError]:
        """Half a second of several drives at once."""
        return super().advance_together(rides, [stretch(plan) for plan in plans])


def make_overshoot(engine: str, scenarios: str) -> OvershootBackend:
    """The engine by its name; ``scenarios`` are NeuroNCAP's."""
    if scenarios != RECORDED:
        raise InputError(f"{engine} has no scenarios; leave --scenarios {scenarios} out")
    return OvershootBackend()
