"""Hand-made scenes on stage, and planners that remember what they were shown."""

import numpy as np

from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import EpisodeSpec
from benchmark.closed_loop.observation_builder import NoSensor
from benchmark.closed_loop.simulation_state import RecordedCan, SimulatorBackend
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Scene
from tests.benchmark.fake_data import FakeData


def can_of(scene: Scene) -> RecordedCan:
    return RecordedCan.of(each.ego for each in FakeData({scene.name: scene}).observations(scene.name))


def staged(scene: Scene, maker: SimulatorBackend | None = None, **changes: float) -> EpisodeSpec:
    timeout_s = changes.get("timeout_s", 30.0)
    return EpisodeSpec(scene, can_of(scene), 0, maker or DefaultBackend(), NoSensor(), timeout_s)


class Watching:
    """Drives straight on at a speed, and keeps every observation."""

    name = "watching"

    def __init__(self, speed: float = 8.0, left: float = 0.0) -> None:
        self.seen: list[Observation] = []
        self.resets: list[SceneInfo] = []
        self._waypoints = np.column_stack([0.5 * speed * np.arange(1, 7), left * np.arange(1, 7)])

    def reset(self, scene: SceneInfo) -> None:
        self.resets.append(scene)
        self.seen = []

    def plan(self, observation: Observation) -> Plan:
        self.seen.append(observation)
        return Plan(self._waypoints.copy(), PlanFrame.EGO)


class Peeking(Watching):
    """Also keeps every scene that it is shown."""

    name = "peeking"

    def __init__(self, speed: float = 8.0) -> None:
        super().__init__(speed)
        self.revealed: list[Scene] = []

    def reveal(self, scene: Scene) -> None:
        self.revealed.append(scene)
