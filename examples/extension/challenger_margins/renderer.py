"""``outline``: wire frames of all objects on white."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.box_projection import BOX_EDGES, compute_box_corners, to_camera
from benchmark.cli.generate_options import GenerateOptions
from benchmark.geometry import transform_matrix
from benchmark.machine.workers import Executor
from benchmark.scene import Camera, Scene
from generation.render.contract import Images, require_frames

NEAR_M = 0.5


@dataclass(frozen=True)
class OutlineSource:
    """What ``generate`` makes of its options and ours."""

    options: GenerateOptions
    outline_px: int = 1

    def require(self) -> None:
        """There is nothing that could be missing."""

    def renderer(self, work: Path) -> "OutlineRenderer":
        """The renderer; it keeps nothing."""
        return OutlineRenderer(self.outline_px)

    def executor(self, place: Executor) -> None:
        """Scenes are drawn where they are searched."""


@dataclass(frozen=True)
class OutlineRenderer:
    """Draws the edges of boxes; see `generation.render.contract.Renderer`."""

    outline_px: int
    name = "outline"

    @property
    def version(self) -> str:
        """Changes when the pictures change."""
        return f"1, {self.outline_px} px"

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """Cameras of the recording."""
        return scene.cameras

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        """The images of each frame."""
        require_frames(scene, frames)
        for frame in frames:
            agents, ego = scene.agents, scene.ego
            global_T_ego = transform_matrix(ego.rotation[frame], ego.position[frame])
            corners = [
                compute_box_corners(agents.position[agent, frame], float(agents.yaw[agent, frame]), agents.size[agent])
                for agent in np.flatnonzero(agents.valid[:, frame])
            ]
            yield {
                camera.name: self._draw([to_camera(box, global_T_ego, camera) for box in corners], camera)
                for camera in scene.cameras
            }

    def _draw(self, boxes: list[NDArray[np.float64]], camera: Camera) -> NDArray[np.uint8]:
        image = np.full((camera.height, camera.width, 3), 255, np.uint8)
        for box in boxes:
            if (box[:, 2] < NEAR_M).any():
                continue
            points = box @ camera.intrinsic.T
            pixels = np.clip(points[:, :2] / points[:, 2:], -1e4, 1e4).astype(int).tolist()
            for first, second in BOX_EDGES:
                cv2.line(image, pixels[first], pixels[second], (0, 0, 0), self.outline_px)
        return image
