"""A running planner whose plans are right but for their axes; importable, so that another process can build it."""

import numpy as np

from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo


class Sideways:
    """Keeps its speed, x right and y forward, and says that x is forward."""

    name = "sideways"

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        ahead = 0.5 * np.arange(1, 7) * observation.ego.velocity[0]
        return Plan(np.column_stack([0.0 * ahead, ahead]), PlanFrame.EGO)
