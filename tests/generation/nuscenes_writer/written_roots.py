"""Small data sets written by the writer, for tests: solid-colour images, hand-made scenes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.machine.storage import file_sha256
from benchmark.scene import Camera, Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.contract import Images
from tests.hand_made import scene_on_straight_road

SIZE = (32, 18)


@dataclass
class SolidRenderer:
    """Images of one colour that depends on scene, frame and camera; ``stop_at`` kills the work at a frame."""

    stop_at: int | None = None
    name: str = "solid"
    version: str = "1"

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        return tuple(camera.resized(*SIZE) for camera in scene.cameras)

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        width, height = SIZE
        for frame in frames:
            if frame == self.stop_at:
                raise KeyboardInterrupt
            shade = int(scene.ego.position[frame, 0]) % 256
            yield {
                camera.name: np.full((height, width, 3), (shade, 40 * index, frame % 256), np.uint8)
                for index, camera in enumerate(scene.cameras)
            }


def short_scene(name: str = "scene-9901", *, seconds: float = 2.5, **kwargs: Any) -> Scene:
    """A hand-made scene with times of its own, so that several fit into one data set."""
    scene = scene_on_straight_road(name=name, seconds=seconds, **kwargs)
    return replace(scene, timestamps_us=scene.timestamps_us + int(name[-4:]) * 60_000_000)


def with_adversary(scene: Scene, agent: int = 0) -> Scene:
    """The scene with one car made an adversary that drifts to the left from its second keyframe on."""
    frames = slice(6, len(scene.timestamps_us))
    poses = np.column_stack([scene.agents.position[agent, frames, :2], scene.agents.yaw[agent, frames]])
    poses[:, 1] += np.linspace(0, 1, len(poses))
    return scene.with_adversary(agent, frames, poses)


def write_root(root: Path, scenes: Sequence[Scene], **kwargs: Any) -> DataSetPlan:
    """Write scenes under their own names as a finished data set."""
    kwargs = {"split": "val", "renderer": SolidRenderer(), **kwargs}
    plan = DataSetPlan(root=root, **kwargs)
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys)
    return plan


def contents(root: Path) -> dict[str, str]:
    """Hash of every file below a folder by its path."""
    return {str(path.relative_to(root)): file_sha256(path) for path in sorted(root.rglob("*")) if path.is_file()}
