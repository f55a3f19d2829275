"""``constant-velocity``: straight ahead at the present speed. What no planning at all achieves."""

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo


class ConstantVelocity:
    """Keeps the present velocity and heading for three seconds."""

    name = "constant-velocity"

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """Waypoints of the rear axle straight ahead, ego frame; only the ego's velocity is looked at."""
        seconds = PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        # The velocity's sideways part is measurement noise and slip; a car moves along its heading.
        ahead = seconds * float(observation.ego.velocity[0])
        return Plan(np.column_stack([ahead, np.zeros(PLAN_STEPS)]), PlanFrame.EGO)
