"""Courses of one line, and planners of three."""

from functools import cache
from typing import Any

import numpy as np

from benchmark.closed_loop.idm_policy import IdmPolicy
from benchmark.closed_loop.simulation_config import build_log_replay, build_simulation_config
from benchmark.closed_loop.stepping import begin_simulation, step
from benchmark.closed_loop.world_state import SimulationConfig, WorldState
from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.sources.town import build_town_scene
from tests.hand_made import Car, scene_on_straight_road


def course(
    *cars: Car, ego_speed: float = 8.0, seconds: float = 8.0, idm: bool = False, **changes: Any
) -> SimulationConfig:
    """The hand-made road; the ego is the recorded one at first."""
    scene = scene_on_straight_road(cars, ego_speed=ego_speed, seconds=seconds)
    made = build_simulation_config(scene, **changes)
    return build_simulation_config(scene, policy=idm_of(scene, made), **changes) if idm else made


def idm_of(scene: Scene, made: SimulationConfig) -> IdmPolicy:
    replay = build_log_replay(scene, made.start_us, made.end_us)
    return IdmPolicy.of(replay, scene.agents.categories, scene.road_map)


def straight(speed: float, count: int = PLAN_STEPS) -> Floats:
    return np.column_stack([0.5 * speed * np.arange(1, count + 1), np.zeros(count)])


@cache
def town_scene(index: int) -> Scene:
    """A scene of the town, built once for all tests, which leave it as it is."""
    return build_town_scene("val", index)


def bend(speed: float, radius: float, count: int = PLAN_STEPS) -> Floats:
    turned = 0.5 * speed / radius * np.arange(1, count + 1)
    return radius * np.column_stack([np.sin(turned), 1 - np.cos(turned)])


def driven(made: SimulationConfig, plan: Floats, steps: int) -> list[WorldState]:
    worlds = [begin_simulation(made)]
    for _ in range(steps):
        worlds.append(step(made, worlds[-1], plan))
    return worlds


def same(first: WorldState, second: WorldState) -> bool:
    """Whether two worlds are equal to the last bit."""
    found = [
        (
            world.contact is None, world.step, world.ego, world.time_us, world.others.boxes.tobytes(),
            None if world.trace is None else world.trace.egos.tobytes(),
        )
        for world in (first, second)
    ]  # fmt: skip
    return found[0] == found[1]
