"""``stop``: stands still from now on; the plan is six times the present position.

It is no braking: protocols put the ego where the plan says, however fast it drives now. `nuscenes-pdm` lets a car
follow the plan: it brakes and rolls on.
"""

import numpy as np

from benchmark.constants import PLAN_STEPS
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo


class Stop:
    """Every waypoint is where the car is."""

    name = "stop"

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle, ego frame: zeros."""
        return Plan(np.zeros((PLAN_STEPS, 2)), PlanFrame.EGO)
