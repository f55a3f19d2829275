"""Planner classes as a stranger might write them, right and wrong, for tests."""

from pathlib import Path

import numpy as np

from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo


class Good:
    name = "good"

    def __init__(self, seed: int = 0, checkpoint: Path | None = None) -> None:
        self.seed = seed
        self.checkpoint = checkpoint

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        return Plan(np.zeros((6, 2)), PlanFrame.EGO)


class NoReset:
    name = "no-reset"

    def plan(self, observation: Observation) -> Plan:
        return Plan(np.zeros((6, 2)), PlanFrame.EGO)


class NoName:
    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        return Plan(np.zeros((6, 2)), PlanFrame.EGO)


class NeedsMore(Good):
    def __init__(self, device: str) -> None:
        super().__init__()


NOT_CALLABLE = 3
