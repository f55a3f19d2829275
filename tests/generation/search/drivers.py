"""Planners that judge generated scenes in tests: importable, so that other processes can build them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.planner_facts import build_planner_facts


class SteadyDriver:
    """Straight ahead at one speed, whatever is there."""

    name = "steady"

    def __init__(self, speed: float = 8.0) -> None:
        self.settings: dict[str, Any] = {"speed": speed}
        self._waypoints = np.column_stack([0.5 * speed * np.arange(1, 7), np.zeros(6)])

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        return Plan(self._waypoints, PlanFrame.EGO)


class LookingDriver(SteadyDriver):
    """Opens its front camera first."""

    name = "looking"

    def plan(self, observation: Observation) -> Plan:
        assert observation.views["CAM_FRONT"].load().any()
        return super().plan(observation)


class RaisingDriver(SteadyDriver):
    """Gives up on the third sample of each scene."""

    name = "raising"

    def plan(self, observation: Observation) -> Plan:
        if observation.index == 2:
            raise RuntimeError("no idea")
        return super().plan(observation)


@dataclass(frozen=True)
class Drivers:
    """Builds one of these in any process."""

    made: type[SteadyDriver] = SteadyDriver
    speed: float = 8.0

    @property
    def facts(self) -> PlannerFacts:
        return build_planner_facts(self())

    def __call__(self) -> SteadyDriver:
        return self.made(self.speed)
