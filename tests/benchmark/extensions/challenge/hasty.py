"""A planner that goes faster than anybody should."""

import numpy as np

from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo


class Hasty:
    name = "hasty"
    FACTOR = 1.6

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        ahead = self.FACTOR * float(np.hypot(*observation.ego.velocity)) * 0.5 * np.arange(1, 7)
        return Plan(np.column_stack([ahead, np.zeros(6)]), PlanFrame.EGO)


class Steady(Hasty):
    name = "steady"
    FACTOR = 1.0
