"""Small cameras, a sensor and a planner whose pictures and plans depend on all that there is to see."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import transform_matrix
from benchmark.machine.storage import content_seed
from benchmark.planning import CameraView, Observation, Plan, PlanFrame, SceneInfo
from benchmark.scene import Camera, Scene
from generation.sources.rig import build_default_cameras
from tests.hand_made import Car, scene_on_straight_road


def small_cameras() -> tuple[Camera, ...]:
    return tuple(camera.resized(8, 6) for camera in build_default_cameras())


def picture(number: int, shape: tuple[int, int] = (6, 8)) -> NDArray[np.uint8]:
    rows, columns = np.indices(shape)
    return np.asarray(np.stack([10 * number + rows, 100 + columns, np.full(shape, 7)], axis=-1), np.uint8)


def small_scene() -> Scene:
    scene = scene_on_straight_road((Car(95.0, 198.25, 2.0), Car(60.0, 194.75, 10.0)), seconds=6.0)
    return replace(scene, cameras=small_cameras())


class Looking:
    """Answers by everything that the wire carries: speed, command, time and every pixel."""

    name = "looking"

    def __init__(self) -> None:
        self.resets = 0
        self.seen: list[Observation] = []

    def reset(self, scene: SceneInfo) -> None:
        self.resets += 1
        self.seen = []

    def plan(self, observation: Observation) -> Plan:
        self.seen.append(observation)
        seconds = 0.5 * np.arange(1, 7)
        # Whole numbers: cameras come in another order over the wire, and sums of fractions depend on it.
        pixels = [view.load() for view in observation.views.values()]
        light = sum(int(each.sum()) for each in pixels) / max(sum(each.size for each in pixels), 1) / 1e4
        aside = (int(observation.command) - 2) * 0.01 + light + 1e-3 * (observation.timestamp_us % 7)
        speed = float(observation.ego.velocity[0]) + 0.1 * float(observation.ego.yaw_rate) + 0.01 * observation.index
        return Plan(np.column_stack([speed * seconds, aside * seconds]), PlanFrame.EGO)


@dataclass(frozen=True)
class Painted:
    """A sensor whose small pictures depend on where the car is and when, to the last bit."""

    name: str = "painted"

    @property
    def facts(self) -> Mapping[str, Any]:
        return {}

    def look(self, scene: Scene) -> "Painted":
        return self

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return small_cameras()

    def views(self, driven: Scene) -> dict[str, CameraView]:
        pose = transform_matrix(driven.ego.rotation[-1], driven.ego.position[-1])
        time_us = int(driven.timestamps_us[-1])
        found = {}
        for camera in small_cameras():
            seed = content_seed(camera.name, driven.ego.position[-1].tolist(), time_us)
            pixels = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), dtype=np.uint8)
            found[camera.name] = CameraView(camera, Path(camera.name), time_us, pose, pixels.copy)
        return found
