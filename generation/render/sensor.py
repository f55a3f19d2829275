"""The schematic renderer as a sensor of driven worlds (`benchmark.closed_loop.observation_builder`)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import transform_matrix
from benchmark.planning import CameraView
from benchmark.scene import Camera, Scene
from generation.render.schematic import FIRST, SECOND, SchematicRenderer
from generation.render.schematic.renderer import PreparedScene

SCHEMATIC: Final = "schematic"
DEFAULT_SIZE: Final = (448, 256)
"""Of images for scenes without cameras."""
_STYLES: Final = {"first": FIRST, "second": SECOND}


@dataclass(frozen=True, slots=True)
class SchematicSensor:
    """Draws from the ego's true pose, for the scene's own rig, in the data set's ``first`` or ``second`` style."""

    style: str = "second"
    name: str = SCHEMATIC

    @property
    def facts(self) -> Mapping[str, Any]:
        """Style and version of the pictures."""
        return {"style": self.style, "version": SchematicRenderer.version}

    def look(self, scene: Scene) -> "SchematicCameraViews":
        """Make ready for a scene."""
        width, height = (scene.cameras[0].width, scene.cameras[0].height) if scene.cameras else DEFAULT_SIZE
        renderer = SchematicRenderer(width, height, style=_STYLES[self.style])
        return SchematicCameraViews(renderer.cameras(scene), renderer.stage(scene))


@dataclass(frozen=True, slots=True)
class SchematicCameraViews:
    """A rig at the drawn size in a scene whose road, houses and trees do not change from picture to picture."""

    cameras: tuple[Camera, ...]
    stage: PreparedScene

    def views(self, driven: Scene) -> dict[str, CameraView]:
        """Pictures of now, the driven world's last frame, as bytes in memory: nothing else can be reached from them."""
        self.stage.go_on(driven)
        now = len(driven.timestamps_us) - 1
        pictures = self.stage.pictures(now)
        pose = transform_matrix(driven.ego.rotation[now], driven.ego.position[now])
        return {
            camera.name: CameraView(
                camera=camera,
                path=Path(driven.name) / f"{int(driven.timestamps_us[now])}" / f"{camera.name}.png",
                timestamp_us=int(driven.timestamps_us[now]),
                global_T_ego=pose.copy(),
                load=partial(_copy_writable, pictures[camera.name]),
            )
            for camera in self.cameras
        }


def _copy_writable(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return picture.copy()
