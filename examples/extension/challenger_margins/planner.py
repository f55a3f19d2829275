"""``easing``: straight ahead, braking gently from the present speed."""

import numpy as np

from benchmark import Observation, Plan, PlanFrame, SceneInfo


class Easing:
    """Brakes by a constant deceleration until it stands."""

    name = "easing"

    def __init__(self, easing_m_s2: float = 1.0) -> None:
        # Records keep the settings, and plans made with others are not taken for these.
        self.settings = {"easing_m_s2": easing_m_s2}

    def reset(self, scene: SceneInfo) -> None:
        """Nothing is remembered."""

    def plan(self, observation: Observation) -> Plan:
        """Six points, half a second apart, x forward."""
        braking = self.settings["easing_m_s2"]
        speed = max(float(observation.ego.velocity[0]), 0.0)
        seconds = 0.5 * np.arange(1, 7)
        if braking:
            seconds = np.minimum(seconds, speed / braking)
        ahead = speed * seconds - 0.5 * braking * seconds**2
        return Plan(np.column_stack([ahead, np.zeros(6)]), PlanFrame.EGO)
