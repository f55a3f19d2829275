"""Planners with faults, for tests; importable so that other processes can build them."""

import time
from dataclasses import dataclass, field

import numpy as np

from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.records.run_schema import PlannerFacts

AHEAD = np.column_stack([4.0 * np.arange(1, 7), np.zeros(6)])


class Straight:
    """8 m/s straight ahead, whatever happens. Counts how often it was asked."""

    name = "straight"

    def __init__(self, pause_s: float = 0.0) -> None:
        self.calls = 0
        self._pause_s = pause_s

    def reset(self, scene: SceneInfo) -> None:
        pass

    def plan(self, observation: Observation) -> Plan:
        self.calls += 1
        time.sleep(self._pause_s)
        return Plan(AHEAD, PlanFrame.EGO)


class Placed(Straight):
    """Knows one device."""

    name = "placed"

    def __init__(self, device: str = "cpu") -> None:
        super().__init__()
        if device != "cpu":
            raise ValueError(device)


class Failing(Straight):
    """Raises on one sample of each scene."""

    name = "failing"

    def __init__(self, index: int = 3) -> None:
        super().__init__()
        self._index = index

    def plan(self, observation: Observation) -> Plan:
        if observation.index == self._index:
            raise RuntimeError(f"no idea {object()}")
        return super().plan(observation)


class Remembering(Straight):
    """Draws from the global generator and drives on from where it is: stateful, as real models are."""

    name = "remembering"

    def reset(self, scene: SceneInfo) -> None:
        self._speed = 4.0

    def plan(self, observation: Observation) -> Plan:
        self._speed += float(np.random.normal(0.0, 0.1))
        return Plan(AHEAD * self._speed / 4.0, PlanFrame.EGO)


class LooksIfItCan(Straight):
    """Opens its front camera where it has one."""

    name = "looks-if-it-can"

    def plan(self, observation: Observation) -> Plan:
        if (view := observation.views.get("CAM_FRONT")) is not None:
            view.load()
        return super().plan(observation)


class LooksAtImages(Straight):
    """Opens its front camera."""

    name = "looks"

    def plan(self, observation: Observation) -> Plan:
        observation.views["CAM_FRONT"].load()
        return super().plan(observation)


@dataclass(frozen=True)
class Factory:
    """Builds one of these in any process."""

    made: type[Straight] = Straight
    arguments: tuple[float, ...] = ()
    facts: PlannerFacts = field(default_factory=lambda: PlannerFacts(name="made", privileged=False))

    def __call__(self) -> Straight:
        return self.made(*self.arguments)


class Poisoned(Straight):
    """Answers plans that somebody wrote NaN into."""

    name = "poisoned"

    def plan(self, observation: Observation) -> Plan:
        plan = Plan(AHEAD.copy(), PlanFrame.EGO)
        if observation.index >= 4:
            plan.waypoints[2:] = np.nan
        return plan


class OnePoint(Straight):
    """Answers six identical points, not where the car is."""

    name = "one-point"

    def plan(self, observation: Observation) -> Plan:
        return Plan(np.full((6, 2), [3.0, 0.0]), PlanFrame.EGO)
