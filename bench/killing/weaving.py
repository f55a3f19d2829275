"""A planner as one of another package: it runs in a process of its own, which dies with what asked it."""

import numpy as np

from adapters.planners.stop import Stop
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.planning import Observation, Plan, PlanFrame

_SPEED = 8.0
_LANE_M = 3.5


class Weaving(Stop):
    """Drives from lane to lane at each step, so that it hits whoever is near."""

    name = "weaving"

    def plan(self, observation: Observation) -> Plan:
        """Left and right in turn."""
        steps = np.arange(1, PLAN_STEPS + 1)
        return Plan(np.column_stack([_SPEED * PLAN_STEP_S * steps, _LANE_M * np.cos(np.pi * steps)]), PlanFrame.EGO)
